//! The node: binds `cpcm-shared` to pins. It holds no decision worth a unit test.
//!
//! [`app`] is the application, generic over the sensor's bus, the flash and the serial port. Each board is a module
//! that makes these and runs the application's three tasks:
//!
//! | board | |
//! |---|---|
//! | `board_stm32` | STM32L476, ADXL357 on SPI1 with DMA, SPI NOR on SPI2, USART2 |
//! | `board_qemu` | QEMU `mps2-an386`; the sensor is `cpcm_shared`'s register model, fed from memory |
#![no_std]

#[cfg(target_os = "none")]
pub mod app;
#[cfg(all(target_os = "none", feature = "board-qemu"))]
pub mod board_qemu;
#[cfg(all(target_os = "none", feature = "board-stm32"))]
pub mod board_stm32;
