//! Answers requests: the node's end of the link, whatever carries the bytes.

use embedded_storage_async::nor_flash::MultiwriteNorFlash;
use heapless::{String, Vec};

use crate::checksum;
use crate::frame::{self, MAX_FRAME, MAX_PAYLOAD};
use crate::message::{
    Counters, Entry, Envelope, Info, Listing, Live, MAX_CHUNK, PROTOCOL_VERSION, Refusal, Reply, Request,
};
use crate::record::Record;
use crate::storage::Storage;

/// Who the node is.
#[derive(Clone, Copy, Debug)]
pub struct Identity {
    /// Serial number.
    pub serial: u64,
    /// Firmware version; the first 16 bytes are told.
    pub firmware: &'static str,
    /// Board; the first 16 bytes are told.
    pub board: &'static str,
}

/// Turns requests into replies.
pub struct Server {
    identity: Identity,
    payload: [u8; MAX_PAYLOAD],
    out: [u8; MAX_FRAME],
}

impl Server {
    /// Has answered nothing yet.
    pub const fn new(identity: Identity) -> Self {
        Server { identity, payload: [0; MAX_PAYLOAD], out: [0; MAX_FRAME] }
    }

    /// Answers the payload of one good frame with the frame to send back; an empty one when the request does not even
    /// tell its version and id.
    pub async fn answer<F: MultiwriteNorFlash>(
        &mut self,
        request: &[u8],
        storage: &mut Storage<F>,
        live: &Live,
    ) -> &[u8] {
        let Ok(((version, id), body)) = postcard::take_from_bytes::<(u8, u16)>(request) else { return &[] };
        let reply = match (version, postcard::take_from_bytes::<Request>(body)) {
            (PROTOCOL_VERSION, Ok((request, []))) if storage.is_mounted() => {
                self.identity.reply(request, storage, live).await.unwrap_or_else(Reply::Refused)
            }
            (PROTOCOL_VERSION, Ok((_, []))) => Reply::Refused(Refusal::Starting),
            (PROTOCOL_VERSION, _) => Reply::Refused(Refusal::Unknown),
            (tool, _) => Reply::Refused(Refusal::Version { node: PROTOCOL_VERSION, tool }),
        };
        let length = match encode(id, reply, &mut self.payload) {
            Some(length) => length,
            None => encode(id, Reply::Refused(Refusal::TooLong), &mut self.payload).unwrap_or(0),
        };
        let payload = self.payload.get(..length).unwrap_or_default();
        let framed = frame::encode(payload, &mut self.out).unwrap_or(0);
        self.out.get(..framed).unwrap_or_default()
    }
}

fn encode(id: u16, body: Reply, payload: &mut [u8]) -> Option<usize> {
    let envelope = Envelope { version: PROTOCOL_VERSION, id, body };
    Some(postcard::to_slice(&envelope, payload).ok()?.len())
}

impl Identity {
    async fn reply<'s, F: MultiwriteNorFlash>(
        &self,
        request: Request<'_>,
        storage: &'s mut Storage<F>,
        live: &Live,
    ) -> Result<Reply<'s>, Refusal> {
        let counters = Counters { storage_errors: storage.errors(), ..live.counters };
        Ok(match request {
            Request::Info => Reply::Info(self.info(storage, counters).await),
            // No sample yet to bind the time to: the node reads its flash, or its sensor does not start.
            Request::SetClock { .. } if live.sample == 0 => return Err(Refusal::Starting),
            Request::SetClock { unix_us } => {
                Reply::ClockSet(storage.clock.set(&mut storage.flash, live.sample, unix_us).await)
            }
            Request::List { first } => Reply::List(list(storage, first).await),
            Request::Read { sequence, offset, length } => read(storage, sequence, offset, length).await?,
            Request::Watch => {
                let last_sequence = storage.journal.extent().map(|extent| extent.last);
                Reply::Live(Live { last_sequence, counters, ..*live })
            }
            upload => upload_reply(upload, storage).await.map_err(Refusal::Package)?,
        })
    }

    async fn info<F: MultiwriteNorFlash>(&self, storage: &mut Storage<F>, counters: Counters) -> Info {
        Info {
            protocol: PROTOCOL_VERSION,
            serial: self.serial,
            firmware: shortened(self.firmware),
            board: shortened(self.board),
            kernel: storage.kernel().await,
            kernel_capacity: storage.banks.capacity(),
            records: storage.journal.extent(),
            counters,
            clock: storage.clock.state(),
        }
    }
}

async fn upload_reply<'s, F: MultiwriteNorFlash>(
    request: Request<'_>,
    storage: &mut Storage<F>,
) -> Result<Reply<'s>, crate::bank::Refusal> {
    let Storage { flash, banks, scratch, .. } = storage;
    let outcome = match request {
        Request::UploadBegin { length, crc } => banks.begin(length, crc).map(Reply::Upload),
        Request::UploadChunk { offset, bytes } => {
            banks.chunk(flash, offset, bytes, scratch).await.map(Reply::Upload)
        }
        Request::UploadCommit { crc } => {
            let active = banks.commit(flash, crc, scratch).await;
            active.map(|active| Reply::Committed { kernel_id: active.kernel_id })
        }
        Request::UploadAbort => {
            banks.abort();
            Ok(Reply::Aborted)
        }
        _ => banks.progress().map(Reply::Upload).ok_or(crate::bank::Refusal::NotBegun),
    };
    storage.count(outcome)
}

async fn list<F: MultiwriteNorFlash>(storage: &mut Storage<F>, first: u32) -> Listing {
    let mut listing = Listing { entries: Vec::new(), next: None };
    let Storage { flash, journal, scratch, .. } = storage;
    journal
        .visit(flash, first, scratch, |sequence, bytes| {
            if listing.entries.is_full() {
                listing.next = Some(sequence);
                return false;
            }
            let _ = entry(bytes).map(|entry| listing.entries.push(entry));
            true
        })
        .await;
    listing
}

fn entry(bytes: &[u8]) -> Option<Entry> {
    let record: Record = postcard::from_bytes(checksum::verified(bytes)?).ok()?;
    Some(Entry {
        sequence: record.sequence,
        length: bytes.len() as u16,
        crc: u32::from_le_bytes(*bytes.last_chunk()?),
        first_axle_sample: record.first_axle_sample,
        flags: record.flags,
        speed_m_s: record.speed_m_s,
        wheelsets: record.wheelsets.len() as u8,
    })
}

async fn read<F: MultiwriteNorFlash>(
    storage: &mut Storage<F>,
    sequence: u32,
    offset: u32,
    length: u16,
) -> Result<Reply<'_>, Refusal> {
    let Storage { flash, journal, scratch, .. } = storage;
    let Some(total) = journal.read(flash, sequence, scratch).await else {
        return Err(Refusal::NoRecord { sequence, extent: journal.extent() });
    };
    let total_u32 = total as u32;
    let refused = Refusal::Offset { offset, total: total_u32 };
    let rest = scratch.get(offset as usize..total).ok_or(refused)?;
    let bytes = rest.get(..rest.len().min(usize::from(length)).min(MAX_CHUNK)).unwrap_or_default();
    Ok(Reply::Record { sequence, offset, total: total_u32, bytes })
}

fn shortened(text: &str) -> String<16> {
    let mut short = String::new();
    for c in text.chars() {
        if short.push(c).is_err() {
            break;
        }
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bank;
    use crate::bank::tests::{header, package};
    use crate::checksum::crc32;
    use crate::clock::{self, Binding};
    use crate::frame::Decoder;
    use crate::journal::Extent;
    use crate::message::{Activity, Kernel};
    use crate::nor_mock::Nor;
    use crate::package::check::{BlockField, NumberField, PackageError, SensorField};
    use crate::record::FORMAT;
    use crate::storage::{FLASH_LEN, Map};
    use embassy_futures::block_on;
    use std::boxed::Box;
    use std::vec::Vec as StdVec;

    const IDENTITY: Identity = Identity { serial: 42, firmware: "0.1.0-longer-than-told", board: "test" };

    struct Node {
        server: Server,
        storage: Storage<Nor>,
        live: Live,
    }

    impl Node {
        fn new() -> Box<Self> {
            let nor = Nor::new((FLASH_LEN / 4096) as usize);
            let mut storage = Storage::new(nor, Map::node());
            block_on(storage.mount()).unwrap();
            Box::new(Node { server: Server::new(IDENTITY), storage, live: Live::default() })
        }

        fn ask_raw(&mut self, payload: &[u8]) -> StdVec<u8> {
            let frame = block_on(self.server.answer(payload, &mut self.storage, &self.live));
            let mut decoder = Decoder::new();
            frame.iter().find_map(|&byte| decoder.push(byte).map(|reply| reply.to_vec())).unwrap_or_default()
        }

        fn ask(&mut self, body: Request, check: impl FnOnce(Reply)) {
            let mut payload = [0; MAX_PAYLOAD];
            let envelope = Envelope { version: PROTOCOL_VERSION, id: 7, body };
            let reply = self.ask_raw(postcard::to_slice(&envelope, &mut payload).unwrap());
            let reply: Envelope<Reply> = postcard::from_bytes(&reply).unwrap();
            assert_eq!((reply.version, reply.id), (PROTOCOL_VERSION, 7));
            check(reply.body);
        }

        fn append(&mut self, sequence: u32) {
            let record = Record {
                format: FORMAT,
                sequence,
                first_axle_sample: 5,
                samples: 6,
                kernel_id: 7,
                speed_m_s: 40.0,
                max_acceleration_m_s2: 1.0,
                quiet_rms_m_s2: 0.1,
                flags: 3,
                wheelsets: Vec::new(),
            };
            block_on(self.storage.append(&record)).unwrap();
        }
    }

    /// The encoding that other programs rely on: enum order and field order, worked by hand from postcard's rules.
    #[test]
    fn reference_bytes_of_requests() {
        let bytes = |body: Request| {
            let mut buffer = [0; 64];
            let envelope = Envelope { version: 1, id: 300, body };
            postcard::to_slice(&envelope, &mut buffer).unwrap().to_vec()
        };
        let head = [1, 0xAC, 0x02];
        let cases: [(Request, &[u8]); 10] = [
            (Request::Info, &[0]),
            (Request::SetClock { unix_us: 128 }, &[1, 0x80, 1]),
            (Request::List { first: 5 }, &[2, 5]),
            (Request::Read { sequence: 1, offset: 2, length: 200 }, &[3, 1, 2, 0xC8, 1]),
            (Request::UploadBegin { length: 3, crc: 1 }, &[4, 3, 1]),
            (Request::UploadChunk { offset: 9, bytes: &[7, 8] }, &[5, 9, 2, 7, 8]),
            (Request::UploadStatus, &[6]),
            (Request::UploadCommit { crc: 1 }, &[7, 1]),
            (Request::UploadAbort, &[8]),
            (Request::Watch, &[9]),
        ];
        for (body, expected) in cases {
            assert_eq!(bytes(body), [&head, expected].concat());
        }
    }

    /// Bytes of a reply behind version and id.
    fn body_bytes(body: Reply) -> StdVec<u8> {
        let mut buffer = [0; 256];
        let envelope = Envelope { version: 1, id: 300, body };
        let bytes = postcard::to_slice(&envelope, &mut buffer).unwrap();
        assert_eq!(bytes[..3], [1, 0xAC, 0x02]);
        bytes[3..].to_vec()
    }

    /// By hand as well, every reply of docs/protocol.md.
    #[test]
    fn reference_bytes_of_replies() {
        let binding = Binding { sample: 300, unix_us: 128 };
        let counters = Counters {
            samples: 1,
            lost_samples: 2,
            passages: 3,
            lost_passages: 4,
            sensor_errors: 5,
            storage_errors: 6,
            link_errors: 7,
            fifo_deepest: 200,
        };
        let info = Info {
            protocol: 1,
            serial: 42,
            firmware: "0.1".try_into().unwrap(),
            board: "x".try_into().unwrap(),
            kernel: Some(Kernel {
                id: 1,
                crc: 2,
                length: 128,
                site: "GN".try_into().unwrap(),
                train: String::new(),
            }),
            kernel_capacity: 300,
            records: Some(Extent { first: 3, last: 5, count: 2 }),
            counters,
            clock: clock::State {
                boots: 9,
                binding: Some(binding),
                drift_ppb: Some(-3),
                set_before_us: None,
            },
        };
        let set = clock::Set { binding, ahead_us: Some(-1), span_us: 5, drift_ppb: Some(2), stored: true };
        let entry = Entry {
            sequence: 3,
            length: 200,
            crc: 1,
            first_axle_sample: 128,
            flags: 256,
            speed_m_s: 40.0,
            wheelsets: 12,
        };
        let list = Listing { entries: Vec::from_slice(&[entry]).unwrap(), next: Some(4) };
        let live = Live {
            sample: 300,
            activity: Activity::Evaluating,
            mean_m_s2: 1.0,
            rms_m_s2: 0.5,
            peak_m_s2: -2.0,
            last_sequence: Some(5),
            counters,
        };
        let cases: [(Reply, &[u8]); 9] = [
            (Reply::Refused(Refusal::Starting), &[0, 5]),
            (
                Reply::Info(info),
                &[
                    1, 1, 42, 3, b'0', b'.', b'1', 1, b'x', 1, 1, 2, 0x80, 1, 2, b'G', b'N', 0, 0xAC, 2, 1,
                    3, 5, 2, 1, 2, 3, 4, 5, 6, 7, 0xC8, 1, 9, 1, 0xAC, 2, 0x80, 1, 1, 5, 0,
                ],
            ),
            (Reply::ClockSet(set), &[2, 0xAC, 2, 0x80, 1, 1, 1, 5, 1, 4, 1]),
            (Reply::List(list), &[3, 1, 3, 0xC8, 1, 1, 0x80, 1, 0x80, 2, 0, 0, 32, 66, 12, 1, 4]),
            (
                Reply::Record { sequence: 1, offset: 2, total: 200, bytes: &[7, 8] },
                &[4, 1, 2, 0xC8, 1, 2, 7, 8],
            ),
            (Reply::Upload(bank::Progress { received: 64, length: 128, crc: 1 }), &[5, 64, 0x80, 1, 1]),
            (Reply::Committed { kernel_id: 300 }, &[6, 0xAC, 2]),
            (Reply::Aborted, &[7]),
            (
                Reply::Live(live),
                &[
                    8, 0xAC, 2, 3, 0, 0, 0x80, 63, 0, 0, 0, 63, 0, 0, 0, 0xC0, 1, 5, 1, 2, 3, 4, 5, 6, 7,
                    0xC8, 1,
                ],
            ),
        ];
        for (body, expected) in cases {
            assert_eq!(body_bytes(body), expected);
        }
    }

    #[test]
    fn reference_bytes_of_refusals() {
        let extent = Some(Extent { first: 0, last: 59, count: 54 });
        let cases: [(Refusal, &[u8]); 7] = [
            (Refusal::Version { node: 1, tool: 200 }, &[0, 1, 0xC8]),
            (Refusal::Unknown, &[1]),
            (Refusal::NoRecord { sequence: 14, extent }, &[2, 14, 1, 0, 59, 54]),
            (Refusal::Offset { offset: 300, total: 200 }, &[3, 0xAC, 2, 0xC8, 1]),
            (Refusal::Package(bank::Refusal::NoPackage), &[4, 1]),
            (Refusal::Starting, &[5]),
            (Refusal::TooLong, &[6]),
        ];
        for (refusal, expected) in cases {
            assert_eq!(body_bytes(Reply::Refused(refusal)), [&[0], expected].concat());
        }
        let of_packages: [(bank::Refusal, &[u8]); 10] = [
            (bank::Refusal::TooLong { length: 2, max: 1 }, &[0, 2, 1]),
            (bank::Refusal::NoPackage, &[1]),
            (bank::Refusal::NotBegun, &[2]),
            (bank::Refusal::Gap { offset: 3, received: 4 }, &[3, 3, 4]),
            (bank::Refusal::Overrun { end: 5, length: 4 }, &[4, 5, 4]),
            (bank::Refusal::Incomplete { received: 1, length: 4 }, &[5, 1, 4]),
            (bank::Refusal::Crc { announced: 1, found: 2 }, &[6, 1, 2]),
            (bank::Refusal::Header(PackageError::Magic), &[7, 0]),
            (bank::Refusal::Length { package: 1, parts: 300 }, &[8, 1, 0xAC, 2]),
            (bank::Refusal::Flash { offset: 9 }, &[9, 9]),
        ];
        for (refusal, expected) in of_packages {
            assert_eq!(body_bytes(Reply::Refused(Refusal::Package(refusal))), [&[0, 4], expected].concat());
        }
    }

    #[test]
    fn reference_bytes_of_refused_headers() {
        let cases: [(PackageError, &[u8]); 19] = [
            (PackageError::Magic, &[0]),
            (PackageError::HeaderLength(300), &[1, 0xAC, 2]),
            (PackageError::TooShort { needed: 12, given: 3 }, &[2, 12, 3]),
            (PackageError::HeaderCrc { stored: 1, computed: 2 }, &[3, 1, 2]),
            (PackageError::Encoding, &[4]),
            (PackageError::Format(2), &[5, 2]),
            (PackageError::Direction(-2), &[6, 0xFE]),
            (
                PackageError::Sensor { field: SensorField::Range, package: 1.0, node: 2.0 },
                &[7, 3, 0, 0, 0x80, 63, 0, 0, 0, 64],
            ),
            (PackageError::Number { field: NumberField::BinSpeed, value: 1.0 }, &[8, 4, 0, 0, 0x80, 63]),
            (PackageError::AxleOrder { axle: 3 }, &[9, 3]),
            (PackageError::Axles(1), &[10, 1]),
            (PackageError::Group { group: 1, expected_first: 2 }, &[11, 1, 2]),
            (PackageError::Grid(200), &[12, 0xC8, 1]),
            (PackageError::NoBins, &[13]),
            (PackageError::BinOrder { bin: 1 }, &[14, 1]),
            (PackageError::NoOperator { bin: 1, operator: 2 }, &[15, 1, 2]),
            (
                PackageError::Shape { bin: 1, block: BlockField::Template, found: (2, 3), expected: (4, 5) },
                &[16, 1, 4, 2, 3, 4, 5],
            ),
            (
                PackageError::Bounds {
                    bin: 1,
                    block: BlockField::Expand,
                    offset: 4,
                    end: 300,
                    payload_len: 200,
                },
                &[17, 1, 1, 4, 0xAC, 2, 0xC8, 1],
            ),
            (PackageError::Before { bin: 1, before: 3, window: 2 }, &[18, 1, 3, 2]),
        ];
        for (error, expected) in cases {
            let refusal = Refusal::Package(bank::Refusal::Header(error));
            assert_eq!(body_bytes(Reply::Refused(refusal)), [&[0, 4, 7], expected].concat());
        }
    }

    #[test]
    fn property_info_tells_what_there_is() {
        let mut node = Node::new();
        node.append(3);
        node.append(5);
        node.live.counters.lost_samples = 9;
        node.ask(Request::Info, |reply| {
            let Reply::Info(info) = reply else { panic!("{reply:?}") };
            assert_eq!(
                (info.serial, info.firmware.as_str(), info.board.as_str()),
                (42, "0.1.0-longer-tha", "test")
            );
            assert_eq!(info.records, Some(Extent { first: 3, last: 5, count: 2 }));
            assert_eq!((info.counters.lost_samples, info.clock.boots, info.kernel), (9, 1, None));
        });
    }

    #[test]
    fn property_records_are_listed_and_read_in_pieces() {
        let mut node = Node::new();
        (0..60).filter(|sequence| sequence % 10 != 4).for_each(|sequence| node.append(sequence));
        let (mut next, mut entries) = (Some(10), StdVec::new());
        while let Some(first) = next {
            node.ask(Request::List { first }, |reply| {
                let Reply::List(list) = reply else { panic!("{reply:?}") };
                entries.extend(list.entries);
                next = list.next;
            });
        }
        assert!(entries.iter().map(|e| e.sequence).eq((10..60).filter(|s| s % 10 != 4)));
        let entry = entries[7];
        let mut record = StdVec::new();
        while record.len() < usize::from(entry.length) {
            let request = Request::Read { sequence: entry.sequence, offset: record.len() as u32, length: 7 };
            node.ask(request, |reply| {
                let Reply::Record { sequence, total, bytes, .. } = reply else { panic!("{reply:?}") };
                assert_eq!((sequence, total), (entry.sequence, u32::from(entry.length)));
                assert!(bytes.len() <= 7);
                record.extend(bytes);
            });
        }
        assert!(checksum::verified(&record).is_some());
        node.ask(Request::Read { sequence: 14, offset: 0, length: 9 }, |reply| {
            let extent = Some(Extent { first: 0, last: 59, count: 54 });
            assert_eq!(reply, Reply::Refused(Refusal::NoRecord { sequence: 14, extent }));
        });
        let total = u32::from(entry.length);
        node.ask(Request::Read { sequence: entry.sequence, offset: total + 1, length: 9 }, |reply| {
            assert_eq!(reply, Reply::Refused(Refusal::Offset { offset: total + 1, total }));
        });
    }

    #[test]
    fn property_upload_puts_a_package_in_force() {
        let mut node = Node::new();
        let file = package(&header("GN 648"));
        node.ask(Request::UploadStatus, |reply| {
            assert_eq!(reply, Reply::Refused(Refusal::Package(bank::Refusal::NotBegun)));
        });
        node.ask(Request::UploadBegin { length: file.len() as u32, crc: crc32(&file) }, |_| {});
        for (index, bytes) in file.chunks(64).enumerate() {
            node.ask(Request::UploadChunk { offset: 64 * index as u32, bytes }, |reply| {
                assert!(matches!(reply, Reply::Upload(_)), "{reply:?}");
            });
        }
        node.ask(Request::UploadCommit { crc: crc32(&file) }, |reply| {
            assert!(matches!(reply, Reply::Committed { .. }), "{reply:?}")
        });
        node.ask(Request::Info, |reply| {
            let Reply::Info(info) = reply else { panic!("{reply:?}") };
            let kernel = info.kernel.unwrap();
            assert_eq!(
                (kernel.site.as_str(), kernel.crc, kernel.length),
                ("GN 648", crc32(&file), file.len() as u32)
            );
        });
    }

    #[test]
    fn property_other_version_and_unknown_request_are_refused() {
        let mut node = Node::new();
        let version = node.ask_raw(&[9, 1, 0]);
        let version: Envelope<Reply> = postcard::from_bytes(&version).unwrap();
        assert_eq!(version.body, Reply::Refused(Refusal::Version { node: PROTOCOL_VERSION, tool: 9 }));
        let unknown = node.ask_raw(&[PROTOCOL_VERSION, 1, 200]);
        let unknown: Envelope<Reply> = postcard::from_bytes(&unknown).unwrap();
        assert_eq!(unknown.body, Reply::Refused(Refusal::Unknown));
        assert!(node.ask_raw(&[]).is_empty());
        node.storage = Storage::new(Nor::new(1), Map::node());
        node.ask(Request::Info, |reply| assert_eq!(reply, Reply::Refused(Refusal::Starting)));
    }

    /// A time that came while the node read its flash was bound to sample 0, which was taken seconds later.
    #[test]
    fn regress_the_clock_is_not_set_before_the_first_sample() {
        let mut node = Node::new();
        let request = Request::SetClock { unix_us: 1_760_000_000_000_000 };
        node.ask(request, |reply| assert_eq!(reply, Reply::Refused(Refusal::Starting)));
        assert_eq!(node.storage.clock.state().binding, None);
        node.live.sample = 8;
        node.ask(request, |reply| assert!(matches!(reply, Reply::ClockSet(_)), "{reply:?}"));
    }

    #[test]
    fn property_longest_answers_fit_a_frame() {
        let mut node = Node::new();
        (0..100).map(|k| u32::MAX - 200 + k).for_each(|sequence| node.append(sequence));
        node.ask(Request::List { first: 0 }, |reply| {
            let Reply::List(list) = reply else { panic!("{reply:?}") };
            assert!(list.entries.is_full() && list.next.is_some());
        });
    }

    proptest::proptest! {
        #[test]
        fn property_arbitrary_requests_never_panic(bytes in proptest::collection::vec(0u8..12, 0..40)) {
            let mut node = Node::new();
            let mut request = std::vec![PROTOCOL_VERSION];
            request.extend(bytes);
            node.ask_raw(&request);
        }
    }
}
