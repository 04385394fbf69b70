//! Sampling task: empties the sensor's FIFO and feeds the sampler. It never waits for anything but the sensor.

use cpcm_shared::acquire::{Acquisition, Events};
use cpcm_shared::adxl357::{Adxl357, Batch, FIFO_SAMPLES, SAMPLE_PERIOD_US, Silence};
use cpcm_shared::passage::Buffer;
use embassy_time::{Duration, Instant, Timer, with_timeout};
use embedded_hal_async::spi::SpiDevice;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::Node;

/// The sensor's interrupt line.
#[allow(async_fn_in_trait, reason = "one executor, one thread: nobody needs the future to be Send")]
pub trait Interrupt {
    /// Waits until the line is active; `Err` when the samples have ended (simulated sensor only).
    async fn active(&mut self) -> Result<(), Ended>;
}

/// No more samples will come.
pub struct Ended;

/// The FIFO is read after this time even without interrupt: a broken line costs power, not data.
const PATIENCE: Duration = Duration::from_micros(FIFO_SAMPLES as u64 * SAMPLE_PERIOD_US as u64 * 3 / 4);
/// Before a sensor that does not answer is started again.
const RETRY: Duration = Duration::from_millis(500);

/// Samples until the sensor ends, which a real one does not. The next passage gets the number `sequence`; `alive` is
/// called for every batch that holds samples, and for every try to start a sensor that gives none, to feed a watchdog: a
/// broken sensor must not cost uploads and clock.
pub async fn sample<F: MultiwriteNorFlash>(
    node: &Node<F>,
    mut spi: impl SpiDevice,
    mut interrupt: impl Interrupt,
    sequence: u32,
    mut alive: impl FnMut(),
) {
    let mut acquisition = Acquisition::new(sequence);
    let mut batch = Batch::default();
    let mut silence = Silence::new(now_us());
    loop {
        match Adxl357::start(&mut spi, now_us()).await {
            Ok(mut sensor) => {
                defmt::info!("sensor measures");
                lose(node, &mut acquisition, &mut batch, &mut silence);
                silence = Silence::new(now_us());
                let (acquisition, batch) = (&mut acquisition, &mut batch);
                let run =
                    run(node, &mut sensor, &mut interrupt, acquisition, batch, &mut silence, &mut alive);
                if run.await.is_err() {
                    finish(node, acquisition);
                    return;
                }
            }
            Err(_) => {
                defmt::error!("sensor does not start; trying again");
                lose(node, &mut acquisition, &mut batch, &mut silence);
            }
        }
        acquisition.sensor_failed();
        node.live.set(acquisition.live());
        alive();
        Timer::after(RETRY).await;
    }
}

/// Returns `Ok` when the bus fails or the sensor falls silent, `Err` when the samples end.
async fn run<F: MultiwriteNorFlash, S: SpiDevice>(
    node: &Node<F>,
    sensor: &mut Adxl357<S>,
    interrupt: &mut impl Interrupt,
    acquisition: &mut Acquisition,
    batch: &mut Batch,
    silence: &mut Silence,
    alive: &mut impl FnMut(),
) -> Result<(), Ended> {
    loop {
        let ended = matches!(with_timeout(PATIENCE, interrupt.active()).await, Ok(Err(Ended)));
        let visit_us = now_us();
        if sensor.drain(visit_us, batch).await.is_err() {
            defmt::error!("sensor bus failed");
            return Ok(());
        }
        take(node, acquisition, batch);
        if ended && batch.codes.is_empty() {
            return Err(Ended);
        }
        if silence.stalled(visit_us, batch) {
            defmt::error!("sensor has fallen silent");
            return Ok(());
        }
        if !batch.codes.is_empty() {
            alive();
        }
    }
}

fn take<F: MultiwriteNorFlash>(node: &Node<F>, acquisition: &mut Acquisition, batch: &Batch) {
    if batch.lost > 0 {
        defmt::warn!("{=u32} samples lost", batch.lost);
    }
    with_buffer(node, |free| acquisition.take(batch, free));
    node.live.set(acquisition.live());
}

/// Accounts for the time in which the sensor gave nothing.
fn lose<F: MultiwriteNorFlash>(
    node: &Node<F>,
    acquisition: &mut Acquisition,
    batch: &mut Batch,
    silence: &mut Silence,
) {
    batch.codes.clear();
    batch.lost = silence.account(now_us());
    // The first start is no loss.
    if acquisition.live().sample > 0 {
        take(node, acquisition, batch);
    }
}

fn finish<F: MultiwriteNorFlash>(node: &Node<F>, acquisition: &mut Acquisition) {
    with_buffer(node, |free| acquisition.stop(free));
    node.live.set(acquisition.live());
    defmt::info!("samples ended after {=u64}", acquisition.live().sample);
    if node.events.is_empty() && !node.evaluating.get() {
        node.ended.signal(());
    }
}

/// Lends the buffer unless the evaluation has it, and passes on what happened.
fn with_buffer<F: MultiwriteNorFlash>(node: &Node<F>, work: impl FnOnce(Option<&mut Buffer>) -> Events) {
    let mut buffer = node.buffer.try_lock().ok();
    for event in work(buffer.as_deref_mut().map(|buffer| &mut **buffer)) {
        if node.events.try_send(event).is_err() {
            defmt::error!("evaluation does not keep up: a passage is lost");
            event.give_up(buffer.as_deref_mut().map(|buffer| &mut **buffer));
            node.passage_lost();
        }
    }
}

fn now_us() -> u64 {
    Instant::now().as_micros()
}
