//! Field tool and simulated node over lines that work and lines that do not.

use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use cpcm::node_client::{ClientError, Downloaded, NodeClient, Patience, Piece, recorded_since_start};
use cpcm::node_sim::{
    Listener, MemoryNor, SharedNode, SimulatedNode, codes_of_site, in_process, with_kernel,
};
use cpcm::recording::read_site;
use cpcm_shared::bank;
use cpcm_shared::checksum::crc32;
use cpcm_shared::frame::{Decoder, MAX_FRAME, encode};
use cpcm_shared::message::{Envelope, PROTOCOL_VERSION, Refusal, Reply, Request};
use cpcm_shared::package::Header;
use cpcm_tests::flaky_line::{Faults, FlakyLine};
use cpcm_tests::sample::field;
use cpcm_tests::synthetic_kernel;

const QUICK: Patience = Patience {
    first: Duration::from_millis(4),
    longest: Duration::from_millis(20),
    attempts: 6,
    reopenings: 3,
};

/// Flash of a node with a kernel and the records of a site, and these records as downloaded.
fn measured() -> &'static (Vec<u8>, Vec<u8>) {
    static FLASH: OnceLock<(Vec<u8>, Vec<u8>)> = OnceLock::new();
    FLASH.get_or_init(|| {
        let node = with_kernel(&synthetic_kernel::package("GN 648")).unwrap();
        let site = read_site(&field("reference-1")).unwrap();
        node.lock().unwrap().sense(codes_of_site(&site).unwrap(), |_| {});
        let dir = tempfile::tempdir().unwrap();
        download(&mut client(&node), dir.path()).unwrap();
        let records = fs::read(dir.path().join("records.bin")).unwrap();
        let node = Arc::into_inner(node).unwrap().into_inner().unwrap();
        (node.into_flash().bytes().to_vec(), records)
    })
}

fn measured_node() -> SharedNode {
    shared(MemoryNor::with_content(measured().0.clone()))
}

fn shared(flash: MemoryNor) -> SharedNode {
    Arc::new(Mutex::new(SimulatedNode::start(flash)))
}

fn client(node: &SharedNode) -> NodeClient {
    NodeClient::over(in_process(node.clone())).with_patience(QUICK)
}

fn flaky_client(node: &SharedNode, faults: Faults) -> NodeClient {
    NodeClient::over(Box::new(FlakyLine::new(in_process(node.clone()), faults))).with_patience(QUICK)
}

fn download(client: &mut NodeClient, dir: &Path) -> Result<Downloaded, ClientError> {
    client.download(&dir.join("records.bin"), 0, &mut |_| {})
}

/// A node that starts again on its flash, as after a power cut.
fn restart(node: &SharedNode) {
    let mut node = node.lock().unwrap();
    let off = std::mem::replace(&mut *node, SimulatedNode::start(MemoryNor::blank()));
    *node = SimulatedNode::start(off.into_flash());
}

#[test]
fn property_upload_and_download_over_tcp() {
    let node = measured_node();
    let listener = Listener::tcp("127.0.0.1:0".parse().unwrap(), node).unwrap();
    let mut client = NodeClient::open(&listener.address.parse().unwrap()).unwrap();
    let package = synthetic_kernel::package("another");
    let uploaded = client.upload_kernel(&package, &mut |_| {}).unwrap();
    assert_eq!((uploaded.sent, uploaded.already), (package.len() as u64, false));
    assert!(client.upload_kernel(&package, &mut |_| {}).unwrap().already);
    let info = client.info().unwrap();
    assert_eq!(info.kernel.unwrap().site.as_str(), "another");
    let dir = tempfile::tempdir().unwrap();
    let downloaded = download(&mut client, dir.path()).unwrap();
    assert_eq!(fs::read(dir.path().join("records.bin")).unwrap(), measured().1);
    assert_eq!(downloaded.records.len(), 24);
    assert!(downloaded.records.iter().all(|record| record.wheelsets.len() == 12), "kernel was applied");
}

#[cfg(unix)]
#[test]
fn property_download_over_a_pseudo_terminal() {
    let listener = Listener::pseudo_terminal(measured_node()).unwrap();
    let mut client = NodeClient::open(&listener.address.parse().unwrap()).unwrap();
    let dir = tempfile::tempdir().unwrap();
    download(&mut client, dir.path()).unwrap();
    assert_eq!(fs::read(dir.path().join("records.bin")).unwrap(), measured().1);
}

/// The line is cut for good at many places; the next client goes on and reads nothing twice.
#[test]
fn property_download_resumes_where_the_line_was_cut() {
    let whole = &measured().1;
    for cut_after in (300..whole.len()).step_by(611) {
        let (node, dir) = (measured_node(), tempfile::tempdir().unwrap());
        let faults = Faults { cut_after: Some(cut_after), ..Faults::default() };
        let cut = download(&mut flaky_client(&node, faults), dir.path());
        assert!(matches!(cut, Err(ClientError::Line { .. })), "{cut:?}");
        assert!(!dir.path().join("records.bin").exists(), "half a file under the final name");
        let resumed = download(&mut client(&node), dir.path()).unwrap();
        assert_eq!(&fs::read(dir.path().join("records.bin")).unwrap(), whole, "cut after {cut_after}");
        assert!(!dir.path().join("records.bin.part").exists());
        // The list takes some 700 bytes and each record some 60 besides its own.
        assert!(
            resumed.resumed as usize >= (cut_after.saturating_sub(900)) * 2 / 3,
            "{cut_after}: {resumed:?}"
        );
    }
}

#[test]
fn property_a_part_file_of_another_node_is_not_used() {
    let dir = tempfile::tempdir().unwrap();
    let mut other = measured().1[..2000].to_vec();
    other[5] ^= 1;
    fs::write(dir.path().join("records.bin.part"), other).unwrap();
    let downloaded = download(&mut client(&measured_node()), dir.path()).unwrap();
    assert_eq!(fs::read(dir.path().join("records.bin")).unwrap(), measured().1);
    assert_eq!(downloaded.records.len(), 24);
}

/// What had come of a download was cut away when the node had overwritten its first records meanwhile, or had nothing in common with it.
#[test]
fn regress_records_that_the_node_has_overwritten_stay_in_the_file() {
    let (whole, dir) = (&measured().1, tempfile::tempdir().unwrap());
    let (file, part) = (dir.path().join("records.bin"), dir.path().join("records.bin.part"));
    // As if the ring had come round to the first ten.
    let entries = client(&measured_node()).list(0).unwrap();
    let later = entries[10].sequence;
    fs::write(&part, &whole[..whole.len() / 2]).unwrap();
    let downloaded = client(&measured_node()).download(&file, later, &mut |_| {}).unwrap();
    assert_eq!(&fs::read(&file).unwrap(), whole);
    assert_eq!((downloaded.kept, downloaded.records.len(), &downloaded.set_aside), (10, 24, &None));
    // And to all that had come.
    let early: usize = entries[..5].iter().map(|entry| usize::from(entry.length)).sum();
    fs::write(&part, &whole[..early]).unwrap();
    let downloaded = client(&measured_node()).download(&file, later, &mut |_| {}).unwrap();
    assert_eq!((downloaded.kept, downloaded.records.len()), (0, 14));
    assert_eq!(fs::read(downloaded.set_aside.unwrap()).unwrap(), whole[..early]);
}

/// A second download replaced a file of records that the node had overwritten since.
#[test]
fn regress_records_that_a_download_would_lose_are_counted() {
    let (whole, dir) = (&measured().1, tempfile::tempdir().unwrap());
    let file = dir.path().join("records.bin");
    let mut client = client(&measured_node());
    assert_eq!(client.not_listed(&file, 0).unwrap(), 0, "no file yet");
    fs::write(&file, whole).unwrap();
    assert_eq!(client.not_listed(&file, 0).unwrap(), 0);
    let later = client.list(0).unwrap()[10].sequence;
    assert_eq!(client.not_listed(&file, later).unwrap(), 10);
    // Sound records behind a damaged one were replaced as well.
    let mut damaged = whole.clone();
    damaged[40] ^= 1;
    fs::write(&file, damaged).unwrap();
    assert_eq!(client.not_listed(&file, 0).unwrap(), 1);
}

/// A node whose sensor gives no samples refuses the clock; it was said to be silent.
#[test]
fn regress_a_clock_that_cannot_be_set_yet_is_no_silence() {
    let error = client(&measured_node()).set_clock().unwrap_err();
    assert_eq!(refusal(&error), Refusal::Starting);
    assert!(error.to_string().contains("sensor"), "{error}");
}

/// Records from before the last start-up had the dates of samples that were taken as long after it.
#[test]
fn regress_records_of_an_earlier_start_have_no_date() {
    let node = measured_node();
    let of_this_start = || {
        let mut client = client(&node);
        let info = client.info().unwrap();
        let entries = client.list(0).unwrap();
        entries.iter().filter(|entry| recorded_since_start(&info, entry)).count()
    };
    assert_eq!(of_this_start(), 0);
    let mut site = read_site(&field("reference-1")).unwrap();
    site.passages.truncate(1);
    node.lock().unwrap().sense(codes_of_site(&site).unwrap(), |_| {});
    assert_eq!(of_this_start(), 1);
}

#[test]
fn property_upload_resumes_where_the_line_was_cut() {
    let package = synthetic_kernel::package("after the cut");
    for cut_after in [5_000, 200_000, 630_000] {
        let node = measured_node();
        let faults = Faults { cut_after: Some(cut_after), ..Faults::default() };
        let cut = flaky_client(&node, faults).upload_kernel(&package, &mut |_| {});
        assert!(matches!(cut, Err(ClientError::Line { .. })), "{cut:?}");
        assert_eq!(client(&node).info().unwrap().kernel.unwrap().site.as_str(), "GN 648", "old one in force");
        let uploaded = client(&node).upload_kernel(&package, &mut |_| {}).unwrap();
        assert_eq!(uploaded.sent + uploaded.resumed, package.len() as u64);
        // Besides the pieces, the line carried frames, acknowledgements and two answers before them.
        assert!(uploaded.resumed + 1500 > cut_after as u64 * 9 / 10, "{uploaded:?}");
        assert_eq!(client(&node).info().unwrap().kernel.unwrap().crc, crc32(&package));
    }
}

#[test]
fn property_a_line_that_comes_back_is_not_noticed() {
    let (node, dir) = (measured_node(), tempfile::tempdir().unwrap());
    let faults = Faults { cut_after: Some(3_000), can_reopen: true, ..Faults::default() };
    download(&mut flaky_client(&node, faults), dir.path()).unwrap();
    assert_eq!(fs::read(dir.path().join("records.bin")).unwrap(), measured().1);
}

/// A kernel that rots in the node's flash could not be sent again: the node said that it was in force already.
#[test]
fn regress_a_damaged_kernel_can_be_uploaded_again() {
    let (node, package) = (measured_node(), synthetic_kernel::package("GN 648"));
    let mut client = client(&node);
    assert!(client.upload_kernel(&package, &mut |_| {}).unwrap().already);
    let again = client.upload(&package, true, &mut |_| {}).unwrap();
    assert_eq!((again.sent, again.already), (package.len() as u64, false));
    assert_eq!(client.info().unwrap().kernel.unwrap().site.as_str(), "GN 648");
}

/// One bit in 2000 bytes is wrong: every second full frame is damaged.
#[test]
fn property_corrupted_bytes_cost_time_only() {
    let (node, dir) = (measured_node(), tempfile::tempdir().unwrap());
    let faults = Faults { flip_one_in: Some(2000), ..Faults::default() };
    let mut client = flaky_client(&node, faults);
    let package = synthetic_kernel::package("noisy");
    client.upload_kernel(&package, &mut |_| {}).unwrap();
    download(&mut client, dir.path()).unwrap();
    assert_eq!(fs::read(dir.path().join("records.bin")).unwrap(), measured().1);
    let info = client.info().unwrap();
    assert_eq!(info.kernel.unwrap().crc, crc32(&package));
    assert!(info.counters.link_errors > 50, "{:?}", info.counters);
}

#[test]
fn property_a_line_that_loses_long_frames_gets_short_ones() {
    let (node, dir) = (measured_node(), tempfile::tempdir().unwrap());
    let listed = Faults { longest_frame: Some(900), ..Faults::default() };
    download(&mut flaky_client(&node, listed), dir.path()).unwrap();
    let faults = Faults { longest_frame: Some(200), ..Faults::default() };
    let package = &synthetic_kernel::package("short")[..];
    let mut pieces = 0;
    let mut client = flaky_client(&node, faults);
    let result = client.upload_kernel(package, &mut |_: Piece| pieces += 1);
    assert!(result.is_ok(), "{result:?}");
    assert!(pieces > package.len() / 200);
}

#[test]
fn property_node_restarts_during_upload_and_download() {
    let node = measured_node();
    let package = synthetic_kernel::package("restarted");
    let mut restarted = false;
    let during = node.clone();
    let uploaded = client(&node).upload_kernel(&package, &mut |piece| {
        if piece.done > 300_000 && !restarted {
            restarted = true;
            assert_eq!(client(&during).info().unwrap().kernel.unwrap().site.as_str(), "GN 648");
            restart(&during);
        }
    });
    // The first part had to be sent again.
    assert!(uploaded.unwrap().sent > package.len() as u64 + 250_000);
    let dir = tempfile::tempdir().unwrap();
    let mut restarted = false;
    let path = dir.path().join("records.bin");
    let downloaded = client(&node).download(&path, 0, &mut |piece| {
        if piece.done > 3_000 && !restarted {
            restarted = true;
            restart(&during);
        }
    });
    assert_eq!(downloaded.unwrap().records.len(), 24);
    assert_eq!(fs::read(path).unwrap(), measured().1);
    let info = client(&node).info().unwrap();
    assert_eq!(info.kernel.unwrap().site.as_str(), "restarted");
    assert_eq!(info.clock.boots, 4, "one for measuring, one for this test, two restarts");
}

#[test]
fn property_packages_that_do_not_fit_are_refused() {
    let node = measured_node();
    let refused = |package: &[u8]| client(&node).upload_kernel(package, &mut |_| {}).unwrap_err();
    let good = synthetic_kernel::package("too long");
    let (mut header, _) = Header::decode(&good).unwrap();
    let payload = good[good.len() - header.payload_len as usize..].to_vec();
    header.payload_len = 6 << 20;
    let mut long = vec![0; 5000];
    let length = header.encode(&mut long).unwrap();
    long.resize(length + header.payload_len as usize, 0);
    long[length..length + payload.len()].copy_from_slice(&payload);
    let error = refused(&long);
    let Refusal::Package(bank::Refusal::TooLong { length, max }) = refusal(&error) else { panic!("{error}") };
    assert_eq!((length, max), (long.len() as u32, 5 << 20));
    assert!(matches!(refused(b"no package"), ClientError::Package(_)));
    assert!(matches!(refused(&good[..good.len() - 1]), ClientError::PackageLength { .. }));
    let mut damaged = good.clone();
    let last = damaged.len() - 1;
    damaged[last] ^= 1;
    assert!(matches!(refused(&damaged), ClientError::PackageDamaged { .. }));
    // A tool that does not look first is refused by the node itself, with the chunk that completes the header.
    let mut client = client(&node);
    client.upload_begin(20, 0).unwrap();
    let error = client.upload_chunk(0, b"no package at all---").unwrap_err();
    assert!(matches!(refusal(&error), Refusal::Package(bank::Refusal::Header(_))), "{error}");
    assert_eq!(client.info().unwrap().kernel.unwrap().site.as_str(), "GN 648", "old one in force");
}

fn refusal(error: &ClientError) -> Refusal {
    match error {
        ClientError::Refused(refusal) => *refusal,
        other => panic!("{other:?}"),
    }
}

/// Sends one envelope as it is and returns the node's reply.
fn ask_raw(node: &SharedNode, payload: &[u8]) -> Envelope<Reply<'static>> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(payload, &mut frame).unwrap();
    let answer = node.lock().unwrap().receive(&frame[..length]);
    let mut decoder = Decoder::new();
    let payload = answer.iter().find_map(|&byte| decoder.push(byte).map(<[u8]>::to_vec)).unwrap();
    postcard::from_bytes(payload.leak()).unwrap()
}

#[test]
fn property_another_protocol_version_is_named() {
    let node = measured_node();
    let mut payload = [0; 16];
    let newer = Envelope { version: PROTOCOL_VERSION + 1, id: 5, body: Request::Info };
    let reply = ask_raw(&node, postcard::to_slice(&newer, &mut payload).unwrap());
    let refused = Refusal::Version { node: PROTOCOL_VERSION, tool: PROTOCOL_VERSION + 1 };
    assert_eq!((reply.id, reply.body), (5, Reply::Refused(refused)));
    // A request that this firmware does not know: of the same version, because requests are only appended.
    let reply = ask_raw(&node, &[PROTOCOL_VERSION, 6, 99]);
    assert_eq!((reply.id, reply.body), (6, Reply::Refused(Refusal::Unknown)));
}

#[test]
fn property_endless_frame_is_dropped_and_the_next_one_answered() {
    let node = measured_node();
    let noise = vec![0x55; 20_000];
    assert!(node.lock().unwrap().receive(&noise).is_empty());
    assert_eq!(client(&node).info().unwrap().counters.link_errors, 1);
}

#[test]
fn property_silence_is_an_error_with_what_to_check() {
    let node = measured_node();
    let faults = Faults { longest_frame: Some(0), ..Faults::default() };
    let error = flaky_client(&node, faults).info().unwrap_err();
    assert!(matches!(error, ClientError::NoAnswer { attempts: 6, .. }));
    assert!(error.to_string().contains("powered"), "{error}");
}
