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
    use crate::frame::Decoder;
    use crate::journal::Extent;
    use crate::nor_mock::Nor;
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
