//! QEMU `mps2-an386` (Cortex-M4F at 25 MHz): the node with a simulated sensor and flash.
//!
//! | part | stands for |
//! |---|---|
//! | PSRAM 0x2100_0000, backed by a file of the host | NOR flash and samples: see `cpcm_shared::image` |
//! | `cpcm_shared::adxl357::model` behind [`sensor`] | the accelerometer, in virtual time |
//! | CMSDK UART 0 | the link |
//! | CMSDK timers 0 and 1 | clock and alarm |
//! | semihosting | logs (defmt, on QEMU's stdout), a summary on stderr, and the end of the run |
//!
//! Killing QEMU is a power cut: what is in the flash is in the host's file.

mod executor;
mod nor;
mod registers;
mod sensor;
mod stack;
mod time;
mod uart;

use core::panic::PanicInfo;

use cortex_m_semihosting::{debug, heprintln};
use cpcm_shared::evaluate::Scratch;
use cpcm_shared::frame::Decoder;
use cpcm_shared::image::EXIT_WHEN_DONE;
use cpcm_shared::passage::Buffer;
use cpcm_shared::server::{Identity, Server};
use cpcm_shared::storage::InForce;
use defmt_semihosting as _;
use embassy_executor::Spawner;
use static_cell::{ConstStaticCell, StaticCell};

use crate::app::{self, Node};
use nor::Nor;
use sensor::Sensor;
use uart::Uart;

const IDENTITY: Identity =
    Identity { serial: 0, firmware: env!("CARGO_PKG_VERSION"), board: "qemu mps2-an386" };

static BUFFER: ConstStaticCell<Buffer> = ConstStaticCell::new(Buffer::new());
static SCRATCH: ConstStaticCell<Scratch> = ConstStaticCell::new(Scratch::new());
static KERNEL: ConstStaticCell<InForce> = ConstStaticCell::new(InForce::new());
static DECODER: ConstStaticCell<Decoder> = ConstStaticCell::new(Decoder::new());
static SERVER: ConstStaticCell<Server> = ConstStaticCell::new(Server::new(IDENTITY));
static NODE: StaticCell<Node<Nor>> = StaticCell::new();
static SENSOR: StaticCell<Sensor> = StaticCell::new();

#[cortex_m_rt::entry]
fn main() -> ! {
    stack::paint();
    time::init();
    executor::run(start)
}

fn start(spawner: Spawner) {
    let node = node();
    // Each task is spawned once, so its one place is free.
    sample(node).map(|task| spawner.spawn(task)).unwrap_or_default();
    evaluate(node).map(|task| spawner.spawn(task)).unwrap_or_default();
    link(node).map(|task| spawner.spawn(task)).unwrap_or_default();
}

/// On its own, because the stack that it takes while it makes the node would stay taken in `start`.
#[inline(never)]
fn node() -> &'static Node<Nor> {
    NODE.init(Node::new(Nor::open(sensor::header().is_some()), BUFFER.take()))
}

#[embassy_executor::task]
async fn sample(node: &'static Node<Nor>) {
    let sequence = node.mount().await;
    let header = sensor::header().unwrap_or_default();
    let sensor: &'static Sensor = SENSOR.init(Sensor::new(header.count));
    app::sample(node, sensor, sensor, sequence, || {}).await;
    node.ended().await;
    time::stop();
    let counters = node.live().counters;
    heprintln!(
        "node: {} samples, {} lost, FIFO up to {}; {} passages, {} lost; stack {} of {} bytes",
        counters.samples,
        counters.lost_samples,
        counters.fifo_deepest,
        counters.passages,
        counters.lost_passages,
        stack::used(),
        stack::size()
    );
    if header.count == 0 || header.flags & EXIT_WHEN_DONE != 0 {
        debug::exit(debug::EXIT_SUCCESS);
    }
}

#[embassy_executor::task]
async fn evaluate(node: &'static Node<Nor>) {
    app::evaluate(node, KERNEL.take(), SCRATCH.take()).await;
}

#[embassy_executor::task]
async fn link(node: &'static Node<Nor>) {
    let uart = Uart::init();
    app::link(node, uart, uart, DECODER.take(), SERVER.take()).await;
}

#[cortex_m_rt::exception]
unsafe fn DefaultHandler(irqn: i16) {
    match u16::try_from(irqn) {
        Ok(uart::RX_IRQ) => uart::on_receive(),
        Ok(time::OVERFLOW_IRQ) => time::on_overflow(),
        Ok(time::ALARM_IRQ) => time::on_alarm(),
        _ => panic!("unexpected interrupt {irqn}"),
    }
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    heprintln!("node: {}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::nop();
    }
}

#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &cortex_m_rt::ExceptionFrame) -> ! {
    panic!("hard fault at {:#x}", frame.pc());
}
