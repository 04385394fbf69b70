//! Lines that misbehave, around one that works.

use std::io::{self, ErrorKind};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use cpcm::node_client::Transport;

/// What a line does to what passes through it.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// The line is cut after this many bytes in both directions together.
    pub cut_after: Option<usize>,
    /// Whether it can be opened again after the cut; it then stays whole.
    pub can_reopen: bool,
    /// One bit is flipped in about one of this many bytes.
    pub flip_one_in: Option<u32>,
    /// Frames longer than this do not arrive.
    pub longest_frame: Option<usize>,
}

/// A line with faults. Bytes that pass are counted in `passed`.
pub struct FlakyLine {
    inner: Box<dyn Transport>,
    faults: Faults,
    random: u32,
    cut: bool,
    passed: Arc<Mutex<usize>>,
}

impl FlakyLine {
    /// Around `inner`.
    pub fn new(inner: Box<dyn Transport>, faults: Faults) -> Self {
        FlakyLine { inner, faults, random: 7, cut: false, passed: Arc::default() }
    }

    /// Bytes that have passed in both directions.
    pub fn passed(&self) -> Arc<Mutex<usize>> {
        self.passed.clone()
    }

    /// How many of `count` bytes pass before the cut.
    fn pass(&mut self, count: usize) -> usize {
        let room = self
            .faults
            .cut_after
            .map_or(usize::MAX, |limit| limit.saturating_sub(*self.passed.lock().unwrap()));
        self.cut = count > room;
        let passing = count.min(room);
        *self.passed.lock().unwrap() += passing;
        passing
    }

    fn damage(&mut self, bytes: &mut [u8]) {
        let Some(rate) = self.faults.flip_one_in else { return };
        for byte in bytes {
            self.random = self.random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            if (self.random >> 8).is_multiple_of(rate) {
                *byte ^= 1 << (self.random >> 29);
            }
        }
    }

    fn check(&self) -> io::Result<()> {
        if self.cut { Err(ErrorKind::BrokenPipe.into()) } else { Ok(()) }
    }
}

impl Transport for FlakyLine {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.check()?;
        if self.faults.longest_frame.is_some_and(|longest| bytes.len() > longest) {
            return Ok(());
        }
        let passing = self.pass(bytes.len());
        let mut bytes = bytes[..passing].to_vec();
        self.damage(&mut bytes);
        self.inner.send(&bytes)?;
        self.check()
    }

    fn receive(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.check()?;
        let count = self.inner.receive(buffer, wait)?;
        if self.faults.longest_frame.is_some_and(|longest| count > longest) {
            return Ok(0);
        }
        let count = self.pass(count);
        self.damage(&mut buffer[..count]);
        if count == 0 { self.check().map(|()| 0) } else { Ok(count) }
    }

    fn reopen(&mut self) -> io::Result<()> {
        if !self.faults.can_reopen {
            return Err(ErrorKind::NotConnected.into());
        }
        (self.cut, self.faults.cut_after) = (false, None);
        self.inner.reopen()
    }

    fn name(&self) -> String {
        "flaky line".into()
    }
}
