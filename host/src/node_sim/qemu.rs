//! The firmware's ELF in QEMU: the same node, on the processor it is built for.
//!
//! The board's memory is a file (see `cpcm_shared::image`): flash, then samples. The link is a Unix socket.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use cpcm_shared::image::{HEADER_LEN, Header, LEN, MAX_SAMPLES, SAMPLES, encode_sample};
use cpcm_shared::sample::SensorCode;
use cpcm_shared::storage::FLASH_LEN;

use super::{FeedError, MemoryNor};
use crate::node_client::Address;

/// The emulator.
const PROGRAM: &str = "qemu-system-arm";
/// The firmware below a cargo target directory.
const ELF: &str = "thumbv7em-none-eabihf/firmware/node-qemu";
/// For QEMU to open its socket.
const START_PATIENCE: Duration = Duration::from_secs(20);

/// QEMU cannot run the node.
#[derive(Debug, thiserror::Error)]
pub enum QemuError {
    /// Not installed.
    #[error(
        "{PROGRAM} does not start: {source}. Install it (Debian, Ubuntu: `apt-get install qemu-system-arm`; \
         Fedora: `dnf install qemu-system-arm`; macOS: `brew install qemu`)"
    )]
    NotInstalled {
        /// What the system says.
        source: std::io::Error,
    },
    /// The firmware is not there.
    #[error("no firmware at {}; build it with `cargo fw-qemu`, or name it with --elf", path.display())]
    NoElf {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// It ended, or did not open its socket.
    #[error("QEMU {what}: {log}")]
    Failed {
        /// What it did.
        what: &'static str,
        /// What it said.
        log: String,
    },
    /// A file of the simulation cannot be used.
    #[error("cannot {doing} {}", path.display())]
    File {
        /// `read`, `write`, …
        doing: &'static str,
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The samples do not fit.
    #[error(transparent)]
    Feed(#[from] FeedError),
}

/// Path of the firmware: `given`, or where cargo puts it beside this program, or below the current directory.
pub fn find_elf(given: Option<&Path>) -> Result<PathBuf, QemuError> {
    let beside = std::env::current_exe().ok().into_iter();
    let beside =
        beside.flat_map(|exe| exe.ancestors().skip(1).take(3).map(|dir| dir.join(ELF)).collect::<Vec<_>>());
    let usual = Path::new("target").join(ELF);
    let mut candidates = match given {
        Some(path) => vec![path.to_path_buf()],
        None => beside.chain([usual]).collect(),
    };
    match candidates.iter().position(|path| path.is_file()) {
        Some(index) => Ok(candidates.swap_remove(index)),
        None => Err(QemuError::NoElf { path: candidates.pop().unwrap_or_default() }),
    }
}

/// A running QEMU. Dropping it is a power cut: QEMU is killed, the image file remains.
pub struct Qemu {
    child: Child,
    dir: PathBuf,
}

impl Qemu {
    /// Writes the image into `dir`: flash and samples. The run goes on after the samples have ended.
    pub fn write_image(
        dir: &Path,
        flash: &MemoryNor,
        codes: &[SensorCode],
        flags: u32,
    ) -> Result<(), QemuError> {
        if codes.len() > MAX_SAMPLES {
            return Err(FeedError::TooLong { samples: codes.len(), max: MAX_SAMPLES }.into());
        }
        let header = Header { count: codes.len() as u32, flags }.encode();
        let mut image = Vec::with_capacity(LEN);
        image.extend_from_slice(flash.bytes());
        debug_assert_eq!(image.len(), SAMPLES);
        image.extend_from_slice(&header);
        image.extend(codes.iter().flat_map(|&code| encode_sample(code)));
        image.resize(LEN, 0);
        write(&image_path(dir), &image)
    }

    /// Reads the flash back from the image in `dir`.
    pub fn read_flash(dir: &Path) -> Result<MemoryNor, QemuError> {
        let path = image_path(dir);
        let mut bytes = vec![0; FLASH_LEN as usize];
        let read = File::open(&path).and_then(|mut file| file.read_exact(&mut bytes));
        read.map_err(|source| QemuError::File { doing: "read", path, source })?;
        Ok(MemoryNor::with_content(bytes))
    }

    /// Removes the samples from the image in `dir`, so that the next run only answers.
    pub fn clear_samples(dir: &Path) -> Result<(), QemuError> {
        let path = image_path(dir);
        let header = Header::default().encode();
        let rewrite = || {
            let mut file = File::options().write(true).open(&path)?;
            file.seek(SeekFrom::Start(SAMPLES as u64))?;
            file.write_all(&header[..HEADER_LEN])
        };
        rewrite().map_err(|source| QemuError::File { doing: "write", path: path.clone(), source })
    }

    /// Starts the firmware on the image in `dir`.
    pub fn start(elf: &Path, dir: &Path) -> Result<Self, QemuError> {
        let log = |name: &str| {
            let path = dir.join(name);
            File::create(&path).map_err(|source| QemuError::File { doing: "create", path, source })
        };
        let socket = socket_path(dir);
        // Left by a run that was killed; QEMU would not replace it.
        let _ = std::fs::remove_file(&socket);
        let memory = "memory-backend-file,id=psram,size=16M,share=on,mem-path=";
        let child = Command::new(PROGRAM)
            .args(["-M", "mps2-an386,memory-backend=psram", "-display", "none", "-monitor", "none"])
            .args(["-semihosting-config", "enable=on,target=native", "-icount", "shift=5,sleep=off"])
            .arg("-object")
            .arg(format!("{memory}{}", image_path(dir).display()))
            .arg("-serial")
            .arg(format!("unix:{},server=on,wait=off", socket.display()))
            .arg("-kernel")
            .arg(elf)
            .stdin(Stdio::null())
            .stdout(log("defmt.bin")?)
            .stderr(log("qemu.log")?)
            .spawn()
            .map_err(|source| QemuError::NotInstalled { source })?;
        let mut qemu = Qemu { child, dir: dir.into() };
        qemu.wait_for_socket()?;
        Ok(qemu)
    }

    /// Where its link is.
    pub fn address(&self) -> Address {
        Address::Unix(socket_path(&self.dir).display().to_string())
    }

    /// What the node and QEMU said.
    pub fn log(&self) -> String {
        std::fs::read_to_string(self.dir.join("qemu.log")).unwrap_or_default().trim().into()
    }

    /// Whether it has ended, and how.
    pub fn ended(&mut self) -> Option<bool> {
        self.child.try_wait().ok().flatten().map(|status| status.success())
    }

    /// A connection, closed at once: the socket is there a moment before QEMU listens, and who connects in between is refused.
    fn wait_for_socket(&mut self) -> Result<(), QemuError> {
        let deadline = Instant::now() + START_PATIENCE;
        while self.address().open().is_err() {
            if self.ended().is_some() {
                return Err(QemuError::Failed { what: "ended at once", log: self.log() });
            }
            if Instant::now() > deadline {
                return Err(QemuError::Failed { what: "does not open its socket", log: self.log() });
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn image_path(dir: &Path) -> PathBuf {
    dir.join("psram.img")
}

fn socket_path(dir: &Path) -> PathBuf {
    dir.join("uart.sock")
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), QemuError> {
    std::fs::write(path, bytes).map_err(|source| QemuError::File {
        doing: "write",
        path: path.into(),
        source,
    })
}
