//! The node's board: STM32L476RG at 80 MHz.
//!
//! | pins | part |
//! |---|---|
//! | PA5 SCK, PA6 MISO, PA7 MOSI, PA4 CS, PB0 INT1 | ADXL357 on SPI1 (8 MHz, DMA1 channels 2 and 3) |
//! | PB13 SCK, PB14 MISO, PB15 MOSI, PB12 CS, PB10 HOLD, PB11 WP | W25Q128 NOR flash on SPI2 (16 MHz, DMA1 channels 4 and 5) |
//! | PA2 TX, PA3 RX | USART2, 115200 baud 8N1: the link |
//!
//! Not run yet on hardware: it is built and linked only.

mod flash;

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cpcm_shared::evaluate::Scratch;
use cpcm_shared::frame::Decoder;
use cpcm_shared::passage::Buffer;
use cpcm_shared::server::{Identity, Server};
use cpcm_shared::storage::InForce;
use defmt_rtt as _;
use embassy_executor::{Executor, Spawner};
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::gpio::{AnyPin, Level, Output, Pull, Speed};
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::{self, IWDG};
use embassy_stm32::rcc::{Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk};
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::usart::{self, BufferedUart};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, Peripherals, bind_interrupts, dma, interrupt, uid};
use embassy_time::Delay;
use embedded_hal_bus::spi::ExclusiveDevice;
use static_cell::{ConstStaticCell, StaticCell};

use crate::app::{self, Ended, Interrupt, Node};
use flash::Flash;

bind_interrupts!(struct Irqs {
    DMA1_CHANNEL2 => dma::InterruptHandler<peripherals::DMA1_CH2>;
    DMA1_CHANNEL3 => dma::InterruptHandler<peripherals::DMA1_CH3>;
    DMA1_CHANNEL4 => dma::InterruptHandler<peripherals::DMA1_CH4>;
    DMA1_CHANNEL5 => dma::InterruptHandler<peripherals::DMA1_CH5>;
    EXTI0 => exti::InterruptHandler<interrupt::typelevel::EXTI0>;
    USART2 => usart::BufferedInterruptHandler<peripherals::USART2>;
});

type Bus = ExclusiveDevice<Spi<'static, Async, Master>, Output<'static>, Delay>;

/// When the sampling task neither gets samples nor tries to start the sensor for this long, the node starts again.
const WATCHDOG_US: u32 = 20_000_000;

static BUFFER: ConstStaticCell<Buffer> = ConstStaticCell::new(Buffer::new());
static SCRATCH: ConstStaticCell<Scratch> = ConstStaticCell::new(Scratch::new());
static KERNEL: ConstStaticCell<InForce> = ConstStaticCell::new(InForce::new());
static DECODER: ConstStaticCell<Decoder> = ConstStaticCell::new(Decoder::new());
static SERVER: StaticCell<Server> = StaticCell::new();
static NODE: StaticCell<Node<Flash>> = StaticCell::new();
static EXECUTOR: StaticCell<Executor> = StaticCell::new();

#[cortex_m_rt::entry]
fn main() -> ! {
    EXECUTOR.init(Executor::new()).run(start)
}

fn start(spawner: Spawner) {
    let board = Board::take(embassy_stm32::init(clocks()));
    let (flash, acceleration, uart) = (board.flash, board.acceleration, board.uart);
    let Some(node) = node(flash) else { reset("flash pins") };
    // Each task is spawned once, so its one place is free.
    sample(node, acceleration, board.int1, board.watchdog)
        .map(|task| spawner.spawn(task))
        .unwrap_or_default();
    evaluate(node).map(|task| spawner.spawn(task)).unwrap_or_default();
    link(node, uart).map(|task| spawner.spawn(task)).unwrap_or_default();
}

/// 16 MHz internal oscillator · 10 / 2.
fn clocks() -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    config.rcc.hsi = true;
    config.rcc.pll = Some(Pll {
        source: PllSource::HSI,
        prediv: PllPreDiv::DIV1,
        mul: PllMul::MUL10,
        divp: None,
        divq: None,
        divr: Some(PllRDiv::DIV2),
    });
    config.rcc.sys = Sysclk::PLL1_R;
    config
}

/// What is on the board.
struct Board {
    acceleration: Bus,
    int1: ExtiInput<'static, Async>,
    flash: (Bus, Output<'static>, Output<'static>),
    uart: BufferedUart<'static>,
    watchdog: Peri<'static, IWDG>,
}

impl Board {
    fn take(p: Peripherals) -> Self {
        let spi1 = Spi::new(p.SPI1, p.PA5, p.PA7, p.PA6, p.DMA1_CH3, p.DMA1_CH2, Irqs, at(8_000_000));
        let spi2 = Spi::new(p.SPI2, p.PB13, p.PB15, p.PB14, p.DMA1_CH5, p.DMA1_CH4, Irqs, at(16_000_000));
        let high = |pin: Peri<'static, AnyPin>| Output::new(pin, Level::High, Speed::VeryHigh);
        Board {
            acceleration: device(spi1, high(p.PA4.into())),
            int1: ExtiInput::new(p.PB0, p.EXTI0, Pull::Down, Irqs),
            flash: (device(spi2, high(p.PB12.into())), high(p.PB10.into()), high(p.PB11.into())),
            uart: serial(p.USART2, p.PA3, p.PA2),
            watchdog: p.IWDG,
        }
    }
}

fn at(hertz: u32) -> spi::Config {
    let mut config = spi::Config::default();
    config.frequency = Hertz(hertz);
    config
}

fn device(spi: Spi<'static, Async, Master>, select: Output<'static>) -> Bus {
    match ExclusiveDevice::new(spi, select, Delay) {
        Ok(bus) => bus,
        Err(infallible) => match infallible {},
    }
}

fn serial(
    usart: Peri<'static, peripherals::USART2>,
    rx: Peri<'static, peripherals::PA3>,
    tx: Peri<'static, peripherals::PA2>,
) -> BufferedUart<'static> {
    static TX: StaticCell<[u8; 256]> = StaticCell::new();
    // Holds the longest request twice.
    static RX: StaticCell<[u8; 2304]> = StaticCell::new();
    match BufferedUart::new(
        usart,
        rx,
        tx,
        TX.init([0; 256]),
        RX.init([0; 2304]),
        Irqs,
        usart::Config::default(),
    ) {
        Ok(uart) => uart,
        Err(_) => reset("serial port"),
    }
}

/// On its own, because the stack that it takes while it makes the node would stay taken in `start`.
#[inline(never)]
fn node((bus, hold, protect): (Bus, Output<'static>, Output<'static>)) -> Option<&'static Node<Flash>> {
    let flash = Flash::new(bus, hold, protect)?;
    Some(NODE.init(Node::new(flash, BUFFER.take())))
}

#[embassy_executor::task]
async fn sample(
    node: &'static Node<Flash>,
    bus: Bus,
    int1: ExtiInput<'static, Async>,
    watchdog: Peri<'static, IWDG>,
) {
    let sequence = node.mount().await;
    let mut watchdog = IndependentWatchdog::new(watchdog, WATCHDOG_US);
    watchdog.unleash();
    app::sample(node, bus, Int1(int1), sequence, || watchdog.pet()).await;
}

#[embassy_executor::task]
async fn evaluate(node: &'static Node<Flash>) {
    app::evaluate(node, KERNEL.take(), SCRATCH.take()).await;
}

#[embassy_executor::task]
async fn link(node: &'static Node<Flash>, uart: BufferedUart<'static>) {
    let identity =
        Identity { serial: serial_number(), firmware: env!("CARGO_PKG_VERSION"), board: "stm32l476" };
    let (tx, rx) = uart.split();
    app::link(node, rx, tx, DECODER.take(), SERVER.init(Server::new(identity))).await;
}

/// The 96-bit number of the MCU, folded to 64.
fn serial_number() -> u64 {
    let number = uid::uid();
    let (words, _) = number.as_chunks::<4>();
    words.iter().fold(0, |serial: u64, word| serial.rotate_left(24) ^ u64::from(u32::from_le_bytes(*word)))
}

struct Int1(ExtiInput<'static, Async>);

impl Interrupt for Int1 {
    async fn active(&mut self) -> Result<(), Ended> {
        self.0.wait_for_high().await;
        Ok(())
    }
}

fn reset(what: &'static str) -> ! {
    defmt::error!("reset: {=str}", what);
    SCB::sys_reset()
}

#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    reset("panic")
}

#[cortex_m_rt::exception]
unsafe fn HardFault(_: &cortex_m_rt::ExceptionFrame) -> ! {
    SCB::sys_reset()
}
