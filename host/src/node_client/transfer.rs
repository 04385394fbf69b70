//! Transfers of many requests: kernel upload and record download, both resumable.

use std::collections::HashSet;
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use cpcm_shared::bank;
use cpcm_shared::checksum::{crc32, verified};
use cpcm_shared::message::{Entry, MAX_CHUNK, Refusal};
use cpcm_shared::operator::block_crc;
use cpcm_shared::package::check::header_len;
use cpcm_shared::package::{Block, Header, Operator, PREFIX_LEN};
use cpcm_shared::record::Record;

use super::records::{parse_records, whole_records};
use super::{ClientError, NodeClient};

/// Shortest piece on a bad line, bytes.
const SHORTEST_PIECE: usize = 64;
/// How often a transfer starts again after the node forgot it.
const RESTARTS: u32 = 3;

/// How far a transfer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Bytes that are across, those of an earlier run included.
    pub done: u64,
    /// Bytes in all.
    pub total: u64,
}

/// Outcome of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Uploaded {
    /// Id of the package, now in force.
    pub kernel_id: u32,
    /// Bytes that had to be sent.
    pub sent: u64,
    /// Bytes that were on the node from an upload that had been cut.
    pub resumed: u64,
    /// The package was in force already; nothing was sent.
    pub already: bool,
}

/// Outcome of a download.
#[derive(Clone, Debug, PartialEq)]
pub struct Downloaded {
    /// The records, in the order of the file.
    pub records: Vec<Record>,
    /// Length of the file, bytes.
    pub bytes: u64,
    /// Bytes that were there from a download that had been cut.
    pub resumed: u64,
    /// Records that the node overwrote while others were being read.
    pub overwritten: u32,
    /// Records of a download that had been cut which the list does not hold any more; they are in the file, before the others.
    pub kept: usize,
    /// Where the beginning of a download that has nothing in common with the node's list went.
    pub set_aside: Option<PathBuf>,
}

/// Length of pieces: half after a failure, double again after many that went well.
struct PieceLength {
    bytes: usize,
    went_well: u32,
}

impl PieceLength {
    /// A try of a longer piece costs seconds when it fails.
    const BEFORE_LONGER: u32 = 256;

    fn new() -> Self {
        PieceLength { bytes: MAX_CHUNK, went_well: 0 }
    }

    fn can_be_shorter(&self) -> bool {
        self.bytes > SHORTEST_PIECE
    }

    /// Whether a piece shorter than the one that failed can be tried.
    fn failed(&mut self, asked: usize) -> bool {
        let more = self.can_be_shorter();
        *self = PieceLength { bytes: (self.bytes.min(asked) / 2).max(SHORTEST_PIECE), went_well: 0 };
        more
    }

    fn went_well(&mut self) {
        self.went_well += 1;
        if self.went_well == Self::BEFORE_LONGER {
            *self = PieceLength { bytes: (2 * self.bytes).min(MAX_CHUNK), went_well: 0 };
        }
    }
}

impl NodeClient {
    /// Uploads a kernel package and has it put in force. A package that no node would take is refused before a byte is
    /// sent; one that is in force already is not sent. An upload that was cut goes on where it was.
    pub fn upload_kernel(
        &mut self,
        package: &[u8],
        progress: &mut dyn FnMut(Piece),
    ) -> Result<Uploaded, ClientError> {
        self.upload(package, false, progress)
    }

    /// The same of a package that may be in force already (`again`): its copy on the node may have been damaged since.
    pub fn upload(
        &mut self,
        package: &[u8],
        again: bool,
        progress: &mut dyn FnMut(Piece),
    ) -> Result<Uploaded, ClientError> {
        let kernel_id = check_package(package)?;
        let (crc, total) = (crc32(package), package.len() as u64);
        if !again && self.info()?.kernel.is_some_and(|kernel| (kernel.crc, kernel.id) == (crc, kernel_id)) {
            return Ok(Uploaded { kernel_id, sent: 0, resumed: 0, already: true });
        }
        let (mut sent, mut resumed, mut restarts) = (0, None, 0);
        loop {
            let mut received = self.upload_begin(package.len() as u32, crc)?.received;
            resumed.get_or_insert(u64::from(received));
            let outcome = self.send_rest(package, &mut received, &mut sent, progress);
            match outcome.and_then(|()| self.upload_commit(crc)) {
                Ok(kernel_id) => {
                    progress(Piece { done: total, total });
                    return Ok(Uploaded { kernel_id, sent, resumed: resumed.unwrap_or(0), already: false });
                }
                Err(ClientError::Refused(Refusal::Package(bank::Refusal::NotBegun)))
                    if restarts < RESTARTS =>
                {
                    restarts += 1;
                }
                Err(ClientError::Refused(Refusal::Package(bank::Refusal::NotBegun))) => {
                    return Err(ClientError::Restarts { restarts });
                }
                Err(other) => return Err(other),
            }
        }
    }

    fn send_rest(
        &mut self,
        package: &[u8],
        received: &mut u32,
        sent: &mut u64,
        progress: &mut dyn FnMut(Piece),
    ) -> Result<(), ClientError> {
        let (mut length, total) = (PieceLength::new(), package.len() as u64);
        while let Some(rest) = package.get(*received as usize..).filter(|rest| !rest.is_empty()) {
            progress(Piece { done: u64::from(*received), total });
            let piece = &rest[..rest.len().min(length.bytes)];
            match self.impatient(length.can_be_shorter(), |client| client.upload_chunk(*received, piece)) {
                Ok(now) => {
                    *sent += u64::from(now.received.saturating_sub(*received));
                    *received = now.received;
                    length.went_well();
                }
                Err(ClientError::Refused(Refusal::Package(bank::Refusal::Gap {
                    received: there, ..
                }))) => {
                    *received = there;
                }
                Err(ClientError::NoAnswer { .. }) if length.failed(piece.len()) => {}
                Err(other) => return Err(other),
            }
        }
        Ok(())
    }

    /// How many records of a file the node does not list from sequence `first` on: a download into that file would lose them. What cannot be
    /// read as records counts as one.
    pub fn not_listed(&mut self, file: &Path, first: u32) -> Result<usize, ClientError> {
        let bytes = read_if_there(file)?;
        if bytes.is_empty() {
            return Ok(0);
        }
        let listed: HashSet<u32> = self.list(first)?.iter().map(|entry| entry.crc).collect();
        let records = whole_records(&bytes);
        let unread = records.iter().map(|record| record.len()).sum::<usize>() < bytes.len();
        let lost = records.into_iter().filter(|record| !listed.contains(&crc_of(record))).count();
        Ok(lost + usize::from(unread))
    }

    /// Downloads the records from sequence `first` on into `file`, which appears when it is complete. What is there
    /// until then stands in `file` with `.part` added, and a later call goes on from it.
    pub fn download(
        &mut self,
        file: &Path,
        first: u32,
        progress: &mut dyn FnMut(Piece),
    ) -> Result<Downloaded, ClientError> {
        let entries = self.list(first)?;
        let mut part = Part::open(file, &entries)?;
        let listed: u64 = entries.iter().map(|entry| u64::from(entry.length)).sum();
        let total = part.kept_bytes as u64 + listed;
        let (resumed, mut overwritten, mut pieces) = (part.length, 0, PieceLength::new());
        for entry in &entries[part.complete..] {
            let mut on_bytes = |done| progress(Piece { done, total });
            match self.download_record(entry, &mut part, &mut pieces, &mut on_bytes) {
                Err(ClientError::Refused(Refusal::NoRecord { .. })) => {
                    // The ring has come round to it in the meantime.
                    part.truncate_record()?;
                    overwritten += 1;
                }
                other => other?,
            }
        }
        progress(Piece { done: total, total });
        let (kept, set_aside) = (part.kept, part.set_aside.clone());
        let bytes = part.finish(file)?;
        let (records, _, fault) = parse_records(&bytes);
        match fault {
            Some(fault) => Err(fault.into()),
            None => {
                Ok(Downloaded { records, bytes: bytes.len() as u64, resumed, overwritten, kept, set_aside })
            }
        }
    }

    /// Reads one record, from where the part file ends. A beginning that an earlier run left and that turns out wrong
    /// costs a second reading.
    fn download_record(
        &mut self,
        entry: &Entry,
        part: &mut Part,
        pieces: &mut PieceLength,
        progress: &mut dyn FnMut(u64),
    ) -> Result<(), ClientError> {
        let mut begun_before = !part.tail.is_empty();
        loop {
            self.read_rest(entry, part, pieces, progress)?;
            let found = crc_of(&part.tail);
            if found == entry.crc && verified(&part.tail).is_some() {
                part.complete_record();
                return Ok(());
            }
            part.truncate_record()?;
            if !begun_before {
                return Err(ClientError::RecordCrc { sequence: entry.sequence, listed: entry.crc, found });
            }
            begun_before = false;
        }
    }

    fn read_rest(
        &mut self,
        entry: &Entry,
        part: &mut Part,
        pieces: &mut PieceLength,
        progress: &mut dyn FnMut(u64),
    ) -> Result<(), ClientError> {
        while part.tail.len() < usize::from(entry.length) {
            progress(part.length);
            let wanted = (usize::from(entry.length) - part.tail.len()).min(pieces.bytes);
            let offset = part.tail.len() as u32;
            let read = |client: &mut Self| client.read(entry.sequence, offset, wanted as u16);
            match self.impatient(pieces.can_be_shorter(), read) {
                Ok(bytes) if bytes.is_empty() => return Err(ClientError::WrongAnswer),
                Ok(bytes) => {
                    part.append(&bytes)?;
                    pieces.went_well();
                }
                Err(ClientError::NoAnswer { .. }) if pieces.failed(wanted) => {}
                Err(other) => return Err(other),
            }
        }
        Ok(())
    }
}

/// Id of the package, when it is one that fits and is whole: the node checks a block when it applies it, and then has no other.
fn check_package(package: &[u8]) -> Result<u32, ClientError> {
    let (header, id) = Header::decode(package).map_err(ClientError::Package)?;
    let payload_at = PREFIX_LEN + header_len(package).map_err(ClientError::Package)?;
    let expected = payload_at as u64 + u64::from(header.payload_len);
    let found = package.len() as u64;
    if found != expected {
        return Err(ClientError::PackageLength { found, expected });
    }
    let whole = |block: &Block| {
        let from = payload_at + block.offset as usize;
        let bytes = package.get(from..from + 4 * usize::from(block.rows) * usize::from(block.cols));
        bytes.is_some_and(|bytes| block_crc(bytes) == block.crc)
    };
    for bin in &header.bins {
        let blocks = |o: &Operator| [o.project, o.expand, o.offset_n, o.half_width_n, o.template_m_s2];
        if !bin.operators.iter().flat_map(blocks).all(|block| whole(&block)) {
            return Err(ClientError::PackageDamaged { speed_m_s: bin.speed_m_s });
        }
    }
    Ok(id)
}

/// The file of a download that goes on.
struct Part {
    path: PathBuf,
    file: File,
    /// Bytes in the file.
    length: u64,
    /// Records in the file that the node does not list any more, before the others, and their bytes.
    kept: usize,
    kept_bytes: usize,
    /// Records of the list that are complete in the file.
    complete: usize,
    /// Bytes of the record that is being read, in the file too.
    tail: Vec<u8>,
    /// Where a file went that has nothing in common with the list.
    set_aside: Option<PathBuf>,
}

impl Part {
    /// Opens what an earlier run has left, if it agrees with the list; if not, puts it aside.
    fn open(target: &Path, entries: &[Entry]) -> Result<Self, ClientError> {
        let path = part_path(target);
        let bytes = read_if_there(&path)?;
        let begun = Begun::of(&bytes, entries);
        let set_aside = match begun {
            Some(_) => None,
            None => Some(put_aside(&path)?),
        };
        let Begun { kept, kept_bytes, complete, end } = begun.unwrap_or_default();
        let tail = if set_aside.is_some() { Vec::new() } else { bytes[end..].to_vec() };
        let mut options = OpenOptions::new();
        let file = options
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(|source| ClientError::File { doing: "create", path: path.clone(), source })?;
        let length = (end + tail.len()) as u64;
        let mut part = Part { path, file, length, kept, kept_bytes, complete, tail, set_aside };
        part.set_length(length)?;
        Ok(part)
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), ClientError> {
        self.file.write_all(bytes).map_err(|source| self.failed("write", source))?;
        self.length += bytes.len() as u64;
        self.tail.extend_from_slice(bytes);
        Ok(())
    }

    fn complete_record(&mut self) {
        self.complete += 1;
        self.tail.clear();
    }

    fn truncate_record(&mut self) -> Result<(), ClientError> {
        let length = self.length - self.tail.len() as u64;
        self.tail.clear();
        self.set_length(length)
    }

    /// Gives the file its name and returns what is in it.
    fn finish(self, target: &Path) -> Result<Vec<u8>, ClientError> {
        self.file.sync_all().map_err(|source| self.failed("write", source))?;
        let bytes = std::fs::read(&self.path).map_err(|source| self.failed("read", source))?;
        std::fs::rename(&self.path, target).map_err(|source| self.failed("rename", source))?;
        Ok(bytes)
    }

    fn set_length(&mut self, length: u64) -> Result<(), ClientError> {
        let cut = |file: &mut File| file.set_len(length).and_then(|()| file.seek(SeekFrom::Start(length)));
        cut(&mut self.file).map_err(|source| self.failed("write", source))?;
        self.length = length;
        Ok(())
    }

    fn failed(&self, doing: &'static str, source: std::io::Error) -> ClientError {
        ClientError::File { doing, path: self.path.clone(), source }
    }
}

fn part_path(target: &Path) -> PathBuf {
    let mut name = target.as_os_str().to_owned();
    name.push(".part");
    name.into()
}

/// How far a file has got with a list.
#[derive(Default)]
struct Begun {
    kept: usize,
    kept_bytes: usize,
    complete: usize,
    /// Bytes of all whole records; less than the next one follows.
    end: usize,
}

impl Begun {
    /// Nothing for a file with which the list does not go on: of another node, or from so long ago that the node has overwritten all
    /// of it.
    fn of(bytes: &[u8], entries: &[Entry]) -> Option<Self> {
        let records = whole_records(bytes);
        let first = entries.first().map(|entry| entry.crc);
        let kept = records.iter().position(|record| Some(crc_of(record)) == first).unwrap_or(0);
        let listed = &records[kept..];
        let agrees = listed.len() <= entries.len()
            && listed.iter().zip(entries).all(|(record, entry)| crc_of(record) == entry.crc);
        let end = records.iter().map(|record| record.len()).sum();
        let room = entries.get(listed.len()).map_or(0, |entry| usize::from(entry.length));
        let kept_bytes = records[..kept].iter().map(|record| record.len()).sum();
        (agrees && bytes.len() - end <= room).then_some(Self {
            kept,
            kept_bytes,
            complete: listed.len(),
            end,
        })
    }
}

fn crc_of(record: &[u8]) -> u32 {
    record.last_chunk().map_or(0, |crc| u32::from_le_bytes(*crc))
}

/// Content of a file; nothing where there is none.
fn read_if_there(path: &Path) -> Result<Vec<u8>, ClientError> {
    match std::fs::read(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Vec::new()),
        other => other.map_err(|source| ClientError::File { doing: "read", path: path.into(), source }),
    }
}

/// Gives a file the first free name behind its own, and says which.
fn put_aside(path: &Path) -> Result<PathBuf, ClientError> {
    let name = |k: u32| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!(".{k}"));
        PathBuf::from(name)
    };
    let free = (1..).map(name).find(|name| !name.exists()).unwrap_or_else(|| name(0));
    std::fs::rename(path, &free).map_err(|source| ClientError::File {
        doing: "put aside",
        path: path.into(),
        source,
    })?;
    Ok(free)
}
