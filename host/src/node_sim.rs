//! A node in the computer: `cpcm_shared` as the firmware runs it, with sensor model and flash in memory.
//!
//! ```text
//! recordings ─► codes ─► sensor model ─► driver ─► acquisition ─► evaluation ─► journal in memory
//!                                                       field tool ◄─ server ◄──┘
//! ```
//!
//! The samples go through the same register model and driver as in QEMU, batch by batch, so the records are the same
//! bytes. Time does not pass: no sample is lost.

mod feed;
mod listener;
mod memory;
mod qemu;

use std::sync::{Arc, Mutex, PoisonError};

use cpcm_shared::acquire::Acquisition;
use cpcm_shared::adxl357::model::Model;
use cpcm_shared::adxl357::{Adxl357, Batch, WATERMARK_SAMPLES};
use cpcm_shared::evaluate::{Kernel, Scratch, blank, evaluate};
use cpcm_shared::frame::Decoder;
use cpcm_shared::operator::{KernelRead, ReadFailed};
use cpcm_shared::passage::Buffer;
use cpcm_shared::record::Record;
use cpcm_shared::sample::SensorCode;
use cpcm_shared::sampler::Event;
use cpcm_shared::server::{Identity, Server};
use cpcm_shared::storage::{InForce, Map, Payload, Storage};
use embassy_futures::block_on;
use embedded_hal_async::spi::{ErrorType, Operation, SpiDevice};

use crate::node_client::{ClientError, NodeClient};
use crate::progress::Progress;
use crate::recording::Site;

pub use feed::{FeedError, QUIET_S, codes_of_site};
pub use listener::{Listener, SharedNode, in_process};
pub use memory::MemoryNor;
pub use qemu::{Qemu, QemuError, find_elf};

/// A site cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// The recordings.
    #[error(transparent)]
    Feed(#[from] FeedError),
    /// The kernel package.
    #[error("the simulated node does not take the kernel package")]
    Package(#[from] ClientError),
}

/// What a node with this package records of the passages of a site, in their order.
pub fn records(site: &Site, package: &[u8], progress: &dyn Progress) -> Result<Vec<Record>, SimulateError> {
    let codes = codes_of_site(site)?;
    let node = with_kernel(package)?;
    progress.begin("node", site.passages.len() as u64);
    let mut records = Vec::new();
    node.lock().unwrap_or_else(PoisonError::into_inner).sense(codes, |record| {
        progress.step();
        records.push(record.clone());
    });
    Ok(records)
}

/// A node with a blank journal and this package in force.
pub fn with_kernel(package: &[u8]) -> Result<SharedNode, ClientError> {
    let node = Arc::new(Mutex::new(SimulatedNode::start(MemoryNor::blank())));
    NodeClient::over(in_process(node.clone())).upload_kernel(package, &mut |_| {})?;
    Ok(node)
}

/// A simulated node, and what it would keep in flash.
pub struct SimulatedNode {
    storage: Storage<MemoryNor>,
    server: Server,
    decoder: Decoder,
    acquisition: Acquisition,
    buffer: Box<Buffer>,
    kernel: Box<InForce>,
    scratch: Box<Scratch>,
    lost_passages: u32,
}

impl SimulatedNode {
    /// Starts a node on what is in its flash.
    pub fn start(flash: MemoryNor) -> Self {
        let mut storage = Storage::new(flash, Map::node());
        match block_on(storage.mount()) {
            Ok(()) => {}
            Err(never) => match never {},
        }
        let sequence = storage.journal().next_sequence();
        let identity = Identity { serial: 1, firmware: env!("CARGO_PKG_VERSION"), board: "simulated" };
        SimulatedNode {
            storage,
            server: Server::new(identity),
            decoder: Decoder::new(),
            acquisition: Acquisition::new(sequence),
            buffer: Box::new(Buffer::new()),
            kernel: Box::new(InForce::new()),
            scratch: Box::new(Scratch::new()),
            lost_passages: 0,
        }
    }

    /// Cuts the power; the flash remains.
    pub fn into_flash(self) -> MemoryNor {
        self.storage.into_flash()
    }

    /// Lets the sensor take these samples, evaluates what passes and keeps the records. `on_record` sees each.
    pub fn sense(&mut self, codes: impl IntoIterator<Item = SensorCode>, mut on_record: impl FnMut(&Record)) {
        let mut codes = codes.into_iter();
        let bus = Bus(Model::new(move || codes.next()));
        let Ok(mut sensor) = block_on(Adxl357::start(bus, 0)) else { return };
        let mut batch = Batch::default();
        loop {
            sensor.bus().0.elapse(WATERMARK_SAMPLES as u32);
            // The bus cannot fail.
            let _ = block_on(sensor.drain(0, &mut batch));
            for event in self.acquisition.take(&batch, Some(&mut self.buffer)) {
                self.keep(event, &mut on_record);
            }
            if batch.codes.is_empty() {
                break;
            }
        }
        for event in self.acquisition.stop(Some(&mut self.buffer)) {
            self.keep(event, &mut on_record);
        }
    }

    /// Takes bytes from the line and returns what the node sends back.
    pub fn receive(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut answer = Vec::new();
        for &byte in bytes {
            let link_errors = self.decoder.counters().errors();
            let Some(request) = self.decoder.push(byte) else { continue };
            let mut live = self.acquisition.live();
            live.counters.link_errors = link_errors;
            live.counters.lost_passages = self.lost_passages;
            answer.extend_from_slice(block_on(self.server.answer(request, &mut self.storage, &live)));
        }
        answer
    }

    fn keep(&mut self, event: Event, on_record: &mut impl FnMut(&Record)) {
        let record = match event {
            Event::Recorded(passage) => {
                block_on(self.storage.refresh(&mut self.kernel));
                let in_force = self.kernel.get();
                let mut reader =
                    in_force.map(|(_, _, payload)| Reader { storage: &mut self.storage, payload });
                let kernel = in_force.zip(reader.as_mut());
                let kernel = kernel.map(|((header, id, _), payload)| Kernel { header, id, payload });
                let record = block_on(evaluate(&passage, self.buffer.samples(), kernel, &mut self.scratch));
                self.buffer.clear();
                record
            }
            Event::Missed(passage) => blank(&passage, &[]),
        };
        let stored = block_on(self.storage.append(&record)).is_ok();
        self.lost_passages += u32::from(event.is_lost(stored));
        on_record(&record);
    }
}

struct Reader<'a> {
    storage: &'a mut Storage<MemoryNor>,
    payload: Payload,
}

impl KernelRead for Reader<'_> {
    async fn read(&mut self, payload_offset: u32, buf: &mut [u8]) -> Result<(), ReadFailed> {
        self.storage.payload(self.payload, payload_offset, buf).await
    }
}

/// The sensor model as bus device.
struct Bus<S>(Model<S>);

impl<S> ErrorType for Bus<S> {
    type Error = std::convert::Infallible;
}

impl<S: cpcm_shared::adxl357::model::Source> SpiDevice for Bus<S> {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
        match operations {
            [Operation::Write(bytes)] => self.0.transfer(bytes, &mut []),
            [Operation::Write(bytes), Operation::Read(answer)] => self.0.transfer(bytes, answer),
            _ => {}
        }
        Ok(())
    }
}
