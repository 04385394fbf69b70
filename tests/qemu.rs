//! The firmware's ELF in QEMU against the simulated node, byte for byte.
//!
//! Needs `qemu-system-arm`; without it these tests fail and say how to install it.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use cpcm::node_client::{ClientError, NodeClient, parse_records};
use cpcm::node_sim::{MemoryNor, Qemu, SharedNode, SimulatedNode, codes_of_site, in_process, with_kernel};
use cpcm::recording::read_site;
use cpcm_shared::image::EXIT_WHEN_DONE;
use cpcm_shared::message::{Activity, Live};
use cpcm_shared::sample::SensorCode;
use cpcm_tests::flaky_line::{Faults, FlakyLine};
use cpcm_tests::sample::field;
use cpcm_tests::{elf, synthetic_kernel};
use tempfile::TempDir;

/// For a run that takes some 4 s.
const PATIENCE: Duration = Duration::from_secs(120);

fn node_elf() -> &'static PathBuf {
    static ELF: OnceLock<PathBuf> = OnceLock::new();
    ELF.get_or_init(|| elf::build("fw-qemu", "node-qemu"))
}

fn codes() -> Vec<SensorCode> {
    codes_of_site(&read_site(&field("reference-1")).unwrap()).unwrap()
}

/// A flash with a kernel in force and no records.
fn flash_with_kernel() -> MemoryNor {
    let node = with_kernel(&synthetic_kernel::package("GN 648")).unwrap();
    Arc::into_inner(node).unwrap().into_inner().unwrap().into_flash()
}

fn shared(flash: MemoryNor) -> SharedNode {
    Arc::new(Mutex::new(SimulatedNode::start(flash)))
}

/// Records of the simulated node, as downloaded.
fn simulated(flash: MemoryNor) -> Vec<u8> {
    let node = shared(flash);
    node.lock().unwrap().sense(codes(), |_| {});
    records_of(&node)
}

fn records_of(node: &SharedNode) -> Vec<u8> {
    downloaded(&mut NodeClient::over(in_process(node.clone())))
}

fn downloaded(client: &mut NodeClient) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("records.bin");
    client.download(&file, 0, &mut |_| {}).unwrap();
    fs::read(file).unwrap()
}

fn start(dir: &Path) -> Qemu {
    Qemu::start(node_elf(), dir).unwrap_or_else(|error| panic!("{error}"))
}

/// An image with these samples and this flash.
fn image(flash: &MemoryNor, flags: u32) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    Qemu::write_image(dir.path(), flash, &codes(), flags).unwrap();
    dir
}

fn wait_until(client: &mut NodeClient, qemu: &mut Qemu, done: impl Fn(&Live) -> bool) -> Live {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let live = client.watch().unwrap_or_else(|error| panic!("{error}: {}", qemu.log()));
        if done(&live) {
            return live;
        }
        assert!(Instant::now() < deadline, "still {live:?}: {}", qemu.log());
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn reference_elf_and_simulated_node_give_the_same_bytes() {
    let flash = flash_with_kernel();
    let expected = simulated(flash.clone());
    let dir = image(&flash, 0);
    let mut qemu = start(dir.path());
    let mut client = NodeClient::open(&qemu.address()).unwrap();
    let live = wait_until(&mut client, &mut qemu, |live| live.activity == Activity::Ended);
    assert_eq!((live.counters.samples, live.counters.lost_samples), (codes().len() as u64, 0));
    assert!(live.counters.fifo_deepest <= 28, "{:?}: 1 ms of the FIFO stays free", live.counters);
    assert_eq!((live.counters.passages, live.counters.lost_passages), (24, 0));
    assert_eq!(downloaded(&mut client), expected);
    let (records, _, fault) = parse_records(&expected);
    assert_eq!(fault, None);
    assert!(records.iter().all(|record| record.wheelsets.len() == 12), "forces were computed");
    // The line is cut in the middle of a download for good; another client goes on.
    let (out, faults) = (tempfile::tempdir().unwrap(), Faults { cut_after: Some(4000), ..Faults::default() });
    let file = out.path().join("records.bin");
    drop(client); // QEMU's socket takes one client at a time
    let line = FlakyLine::new(qemu.address().open().unwrap(), faults);
    let cut = NodeClient::over(Box::new(line)).download(&file, 0, &mut |_| {});
    assert!(matches!(cut, Err(ClientError::Line { .. })), "{cut:?}");
    let resumed = NodeClient::open(&qemu.address()).unwrap().download(&file, 0, &mut |_| {}).unwrap();
    assert!(resumed.resumed > 1000, "{resumed:?}");
    assert_eq!(fs::read(file).unwrap(), expected);
    println!("{}", qemu.log());
}

/// A killed QEMU is a power cut: what was acknowledged is there, and the next run goes on from it.
#[test]
fn property_killed_node_keeps_its_records() {
    let flash = flash_with_kernel();
    let expected = simulated(flash.clone());
    let dir = image(&flash, 0);
    let mut qemu = start(dir.path());
    let mut client = NodeClient::open(&qemu.address()).unwrap();
    wait_until(&mut client, &mut qemu, |live| live.last_sequence >= Some(7));
    drop(qemu);
    let kept = records_of(&shared(Qemu::read_flash(dir.path()).unwrap()));
    let (records, _, _) = parse_records(&kept);
    assert!(records.len() >= 8, "{}", records.len());
    assert!(expected.starts_with(&kept), "what is kept is what the simulated node records");

    let mut qemu = start(dir.path());
    let mut client = NodeClient::open(&qemu.address()).unwrap();
    wait_until(&mut client, &mut qemu, |live| live.activity == Activity::Ended);
    let all = downloaded(&mut client);
    assert!(all.starts_with(&kept));
    let (all, _, _) = parse_records(&all);
    assert!(all.iter().map(|record| record.sequence).eq(0..records.len() as u32 + 24));
    assert_eq!(client.info().unwrap().clock.boots, 3, "one on the host, two in QEMU");
}

/// The run ends by itself when the image says so, and tells how much stack it took.
#[test]
fn property_run_ends_by_itself_within_its_stack() {
    let dir = image(&flash_with_kernel(), EXIT_WHEN_DONE);
    let mut qemu = start(dir.path());
    let deadline = Instant::now() + PATIENCE;
    while qemu.ended().is_none() {
        assert!(Instant::now() < deadline, "{}", qemu.log());
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(qemu.ended(), Some(true), "{}", qemu.log());
    let log = qemu.log();
    println!("{log}");
    let stack = log.split("stack ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
    assert!(stack.parse::<u32>().unwrap() < 24 * 1024, "a quarter of the stack stays free: {log}");
}

/// Uploading to the firmware itself, and what it says of itself.
#[test]
fn property_kernel_upload_to_the_elf() {
    let dir = tempfile::tempdir().unwrap();
    Qemu::write_image(dir.path(), &MemoryNor::blank(), &codes()[..40_000], 0).unwrap();
    let mut qemu = start(dir.path());
    let mut client = NodeClient::open(&qemu.address()).unwrap();
    assert_eq!(client.info().unwrap().kernel, None);
    let package = synthetic_kernel::package("over the link");
    client.upload_kernel(&package, &mut |_| {}).unwrap();
    let info = client.info().unwrap();
    assert_eq!(info.kernel.unwrap().site.as_str(), "over the link");
    assert_eq!(info.board.as_str(), "qemu mps2-an386");
    let live = wait_until(&mut client, &mut qemu, |live| live.activity == Activity::Ended);
    assert_eq!(live.counters.lost_samples, 0, "the upload kept the FIFO waiting");
}
