//! The application: three cooperative tasks on one executor.
//!
//! ```text
//! sensor FIFO ─► sample ──(recording buffer, events)──► evaluate ─► journal ┐
//!                   └─────────────(live status)──────────► link ◄──────────┘ storage ◄─► UART
//! ```
//!
//! The FIFO holds 8 ms and is served at its 2 ms mark, so no task may hold the processor for more than about 4 ms:
//! the evaluation yields by itself (2.3 ms at most, measured in QEMU), and every access to flash is awaited. Nothing here panics; what fails is counted,
//! logged and tried again.

mod evaluate;
mod link;
mod sample;

use core::cell::Cell;

use cpcm_shared::message::{Activity, Live};
use cpcm_shared::passage::Buffer;
use cpcm_shared::sampler::Event;
use cpcm_shared::storage::{Map, Storage};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::mutex::Mutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Timer};
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

pub use evaluate::evaluate;
pub use link::link;
pub use sample::{Ended, Interrupt, sample};

/// Events that may wait for the evaluation; a train is tens of seconds from the next.
const EVENTS: usize = 4;

/// What the tasks share.
pub struct Node<F> {
    /// What is in the flash. A task holds it for one access or one request at a time.
    storage: Mutex<NoopRawMutex, Storage<F>>,
    buffer: Mutex<NoopRawMutex, &'static mut Buffer>,
    events: Channel<NoopRawMutex, Event, EVENTS>,
    live: Cell<Live>,
    lost_passages: Cell<u32>,
    evaluating: Cell<bool>,
    ended: Signal<NoopRawMutex, ()>,
}

impl<F: MultiwriteNorFlash> Node<F> {
    /// Nothing read, nothing recorded.
    pub const fn new(flash: F, buffer: &'static mut Buffer) -> Self {
        Node {
            storage: Mutex::new(Storage::new(flash, Map::node())),
            buffer: Mutex::new(buffer),
            events: Channel::new(),
            live: Cell::new(Live {
                sample: 0,
                activity: Activity::Starting,
                mean_m_s2: 0.0,
                rms_m_s2: 0.0,
                peak_m_s2: 0.0,
                last_sequence: None,
                counters: cpcm_shared::message::Counters {
                    samples: 0,
                    lost_samples: 0,
                    passages: 0,
                    lost_passages: 0,
                    sensor_errors: 0,
                    storage_errors: 0,
                    link_errors: 0,
                    fifo_deepest: 0,
                },
            }),
            lost_passages: Cell::new(0),
            evaluating: Cell::new(false),
            ended: Signal::new(),
        }
    }

    /// Reads the flash; tries again until it answers. Returns the sequence for the next passage.
    pub async fn mount(&self) -> u32 {
        loop {
            let mut storage = self.storage.lock().await;
            if storage.mount().await.is_ok() {
                let next = storage.journal().next_sequence();
                defmt::info!("flash read: next record {=u32}, kernel {=?}", next, storage.kernel_id());
                return next;
            }
            drop(storage);
            defmt::error!("flash does not answer; trying again in 1 s");
            Timer::after(Duration::from_secs(1)).await;
        }
    }

    /// What the field tool may see of the sampling side.
    pub fn live(&self) -> Live {
        let mut live = self.live.get();
        live.counters.lost_passages = self.lost_passages.get();
        if self.evaluating.get() || !self.events.is_empty() {
            live.activity = Activity::Evaluating;
        }
        live
    }

    /// Waits until the samples have ended and all passages are evaluated (simulated sensor only).
    pub async fn ended(&self) {
        self.ended.wait().await;
    }

    fn passage_lost(&self) {
        self.lost_passages.set(self.lost_passages.get().saturating_add(1));
    }
}
