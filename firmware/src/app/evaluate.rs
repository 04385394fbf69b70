//! Evaluation task: one record per passage into the journal.

use core::cell::Cell;

use cpcm_shared::evaluate::{Kernel, Scratch, blank, evaluate as evaluate_passage};
use cpcm_shared::message::Activity;
use cpcm_shared::operator::{KernelRead, ReadFailed};
use cpcm_shared::record::Record;
use cpcm_shared::sampler::Event;
use cpcm_shared::storage::{InForce, Payload};
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::Node;

/// Reads the kernel; the flash is free for others between two reads.
struct Reader<'a, F> {
    node: &'a Node<F>,
    payload: Payload,
}

impl<F: MultiwriteNorFlash> KernelRead for Reader<'_, F> {
    async fn read(&mut self, payload_offset: u32, buf: &mut [u8]) -> Result<(), ReadFailed> {
        self.node.storage.lock().await.payload(self.payload, payload_offset, buf).await
    }
}

/// Evaluates passages for ever.
pub async fn evaluate<F: MultiwriteNorFlash>(
    node: &Node<F>,
    kernel: &mut InForce,
    scratch: &mut Scratch,
) -> ! {
    loop {
        let event = node.events.receive().await;
        let _busy = Busy::new(&node.evaluating);
        let record = match event {
            Event::Recorded(passage) => {
                let mut buffer = node.buffer.lock().await;
                node.storage.lock().await.refresh(kernel).await;
                let mut reader = kernel.get().map(|(_, _, payload)| Reader { node, payload });
                let kernel = kernel.get().zip(reader.as_mut());
                let kernel = kernel.map(|((header, id, _), payload)| Kernel { header, id, payload });
                let record = evaluate_passage(&passage, buffer.samples(), kernel, scratch).await;
                // Free for the next train before the flash is written.
                buffer.clear();
                record
            }
            Event::Missed(passage) => blank(&passage, &[]),
        };
        if event.is_lost(store(node, &record).await) {
            node.passage_lost();
        }
        drop(_busy);
        if node.live.get().activity == Activity::Ended && node.events.is_empty() {
            node.ended.signal(());
        }
    }
}

/// Returns whether the flash took it.
async fn store<F: MultiwriteNorFlash>(node: &Node<F>, record: &Record) -> bool {
    let stored = node.storage.lock().await.append(record).await.is_ok();
    if stored {
        let (sequence, flags, axles) = (record.sequence, record.flags, record.wheelsets.len());
        defmt::info!(
            "record {=u32}: flags {=u16:#x}, {=usize} wheelsets, {=f32} m/s",
            sequence,
            flags,
            axles,
            record.speed_m_s
        );
    } else {
        defmt::error!("record {=u32} is lost: the flash did not take it", record.sequence);
    }
    stored
}

/// Says "evaluating" while it lives.
struct Busy<'a>(&'a Cell<bool>);

impl<'a> Busy<'a> {
    fn new(flag: &'a Cell<bool>) -> Self {
        flag.set(true);
        Busy(flag)
    }
}

impl Drop for Busy<'_> {
    fn drop(&mut self) {
        self.0.set(false);
    }
}
