//! The field tool's end of the link: talks to a node over whatever carries bytes.
//!
//! ```text
//! NodeClient ── Request ─► frame ─► Transport ─► node
//!      ▲───────── Reply ◄─ frame ◄─────┘
//! ```
//!
//! One method per request, and two transfers made of many: [`NodeClient::upload_kernel`] and
//! [`NodeClient::download`]. A request whose answer does not come is repeated with growing patience; the line is
//! opened again when it breaks; transfers use shorter pieces on a bad line and go on where they were.

mod error;
mod records;
mod refusal;
mod transfer;
mod transport;

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use cpcm_shared::bank::Progress as UploadProgress;
use cpcm_shared::clock;
use cpcm_shared::frame::{self, Decoder, MAX_FRAME, MAX_PAYLOAD};
use cpcm_shared::message::{Entry, Envelope, Info, Live, PROTOCOL_VERSION, Refusal, Reply, Request};

pub use error::ClientError;
pub use records::{RecordsError, flag_names, parse_records, recorded_since_start, write_records_parquet};
pub use refusal::explain;
pub use transfer::{Downloaded, Piece, Uploaded};
pub use transport::{Address, Transport, serial_ports};

/// How long a client tries.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// Wait for the first answer; each repetition waits twice as long, up to [`Patience::longest`].
    pub first: Duration,
    /// Longest wait for one answer.
    pub longest: Duration,
    /// How often a request is sent without answer before it counts as failed.
    pub attempts: u32,
    /// How often a broken line is opened again, after as many waits.
    pub reopenings: u32,
}

impl Patience {
    /// Wait for an answer after `failed` attempts without one: twice as long each time, whatever the reason.
    fn wait(&self, failed: u32) -> Duration {
        (self.first * 2_u32.saturating_pow(failed.min(16))).min(self.longest)
    }
}

impl Default for Patience {
    fn default() -> Self {
        // The longest answer takes 0.1 s at 115200 baud; erasing a sector of flash up to 0.4 s.
        Patience {
            first: Duration::from_millis(700),
            longest: Duration::from_secs(4),
            attempts: 6,
            reopenings: 8,
        }
    }
}

/// A node at the other end of a line.
pub struct NodeClient {
    transport: Box<dyn Transport>,
    patience: Patience,
    decoder: Decoder,
    next_id: u16,
}

impl NodeClient {
    /// Opens the line. Nothing is sent: the node is neither reset nor asked anything.
    pub fn open(address: &Address) -> Result<Self, ClientError> {
        Ok(Self::over(address.open()?))
    }

    /// Over a line that is open.
    pub fn over(transport: Box<dyn Transport>) -> Self {
        // A client that is started again must not take an answer to its predecessor for its own.
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let next_id = now.subsec_micros() as u16;
        NodeClient { transport, patience: Patience::default(), decoder: Decoder::new(), next_id }
    }

    /// The same with other patience.
    pub fn with_patience(self, patience: Patience) -> Self {
        NodeClient { patience, ..self }
    }

    /// Who the node is, what it holds and what it has lost.
    pub fn info(&mut self) -> Result<Info, ClientError> {
        self.ask(Request::Info, |reply| if let Reply::Info(info) = reply { Some(info) } else { None })
    }

    /// Binds the host's time to the node's sample count.
    pub fn set_clock(&mut self) -> Result<clock::Set, ClientError> {
        let mut last = Err(ClientError::NoAnswer { attempts: 0, line: self.transport.name() });
        for attempt in 0..self.patience.attempts {
            // The time is that of sending, so each attempt has its own.
            let unix_us = now_us();
            let once = Patience { attempts: 1, first: self.patience.wait(attempt), ..self.patience };
            last = self.ask_with(once, Request::SetClock { unix_us }, |reply| {
                if let Reply::ClockSet(set) = reply { Some(set) } else { None }
            });
            let again =
                matches!(last, Err(ClientError::NoAnswer { .. } | ClientError::Refused(Refusal::Starting)));
            if !again {
                break;
            }
        }
        last
    }

    /// All records from sequence `first` on.
    pub fn list(&mut self, first: u32) -> Result<Vec<Entry>, ClientError> {
        let (mut entries, mut next) = (Vec::new(), Some(first));
        while let Some(first) = next {
            let listing = self.ask(Request::List { first }, |reply| {
                if let Reply::List(listing) = reply { Some(listing) } else { None }
            })?;
            entries.extend(listing.entries);
            // A node that does not advance would keep us here for ever.
            next = listing.next.filter(|&next| next > first);
        }
        Ok(entries)
    }

    /// Up to `length` bytes of an encoded record from `offset` on.
    pub fn read(&mut self, sequence: u32, offset: u32, length: u16) -> Result<Vec<u8>, ClientError> {
        let request = Request::Read { sequence, offset, length };
        self.ask(request, |reply| match reply {
            Reply::Record { sequence: s, offset: o, bytes, .. } if (s, o) == (sequence, offset) => {
                Some(bytes.to_vec())
            }
            _ => None,
        })
    }

    /// Begins an upload, or goes on with the one of the same length and CRC.
    pub fn upload_begin(&mut self, length: u32, crc: u32) -> Result<UploadProgress, ClientError> {
        self.ask(Request::UploadBegin { length, crc }, upload_progress)
    }

    /// Sends a piece of a package.
    pub fn upload_chunk(&mut self, offset: u32, bytes: &[u8]) -> Result<UploadProgress, ClientError> {
        self.ask(Request::UploadChunk { offset, bytes }, upload_progress)
    }

    /// How far the upload is.
    pub fn upload_status(&mut self) -> Result<UploadProgress, ClientError> {
        self.ask(Request::UploadStatus, upload_progress)
    }

    /// Has the package checked and put in force; returns the kernel id.
    pub fn upload_commit(&mut self, crc: u32) -> Result<u32, ClientError> {
        // The node reads the whole package back: 3 MiB take some 3 s.
        let patience =
            Patience { first: Duration::from_secs(20), longest: Duration::from_secs(20), ..self.patience };
        self.ask_with(patience, Request::UploadCommit { crc }, |reply| {
            if let Reply::Committed { kernel_id } = reply { Some(kernel_id) } else { None }
        })
    }

    /// The patience of a single piece: on a bad line a shorter piece is better than many repetitions.
    fn impatient<T>(
        &mut self,
        shorter_is_possible: bool,
        request: impl FnOnce(&mut Self) -> Result<T, ClientError>,
    ) -> Result<T, ClientError> {
        let patience = self.patience;
        if shorter_is_possible {
            self.patience.attempts = 2.min(patience.attempts);
        }
        let outcome = request(self);
        self.patience = patience;
        outcome
    }

    /// Gives the upload up.
    pub fn upload_abort(&mut self) -> Result<(), ClientError> {
        self.ask(Request::UploadAbort, |reply| matches!(reply, Reply::Aborted).then_some(()))
    }

    /// What the sensor sees.
    pub fn watch(&mut self) -> Result<Live, ClientError> {
        self.ask(Request::Watch, |reply| if let Reply::Live(live) = reply { Some(live) } else { None })
    }

    fn ask<T>(&mut self, request: Request, pick: impl FnMut(Reply) -> Option<T>) -> Result<T, ClientError> {
        self.ask_with(self.patience, request, pick)
    }

    fn ask_with<T>(
        &mut self,
        patience: Patience,
        request: Request,
        mut pick: impl FnMut(Reply) -> Option<T>,
    ) -> Result<T, ClientError> {
        self.next_id = self.next_id.wrapping_add(1);
        let frame = framed(self.next_id, request)?;
        let (mut unanswered, mut reopened) = (0, 0);
        loop {
            let wait = patience.wait(unanswered + reopened);
            match self.exchange(&frame, wait, &mut pick) {
                Ok(Some(answer)) => return Ok(answer),
                Ok(None) => unanswered += 1,
                Err(ClientError::Refused(Refusal::Starting)) if unanswered + 1 < patience.attempts => {
                    unanswered += 1;
                }
                Err(ClientError::Line { .. }) if reopened < patience.reopenings => {
                    reopened += 1;
                    // A line that is away is often back soon; a node that starts needs a second or two.
                    std::thread::sleep(wait.min(Duration::from_secs(1)));
                    self.reopen();
                }
                Err(other) => return Err(other),
            }
            if unanswered == patience.attempts {
                return Err(ClientError::NoAnswer { attempts: unanswered, line: self.transport.name() });
            }
        }
    }

    /// Sends once and waits; `None` when no answer came.
    fn exchange<T>(
        &mut self,
        frame: &[u8],
        wait: Duration,
        pick: &mut impl FnMut(Reply) -> Option<T>,
    ) -> Result<Option<T>, ClientError> {
        let line = self.transport.name();
        let broken = |source| ClientError::Line { line: line.clone(), source };
        self.transport.send(frame).map_err(broken)?;
        let deadline = Instant::now() + wait;
        let mut bytes = [0; 4096];
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            let count = self.transport.receive(&mut bytes, left).map_err(broken)?;
            for &byte in &bytes[..count] {
                let Some(payload) = self.decoder.push(byte) else { continue };
                match interpret(self.next_id, payload, pick)? {
                    Answer::Picked(answer) => return Ok(Some(answer)),
                    Answer::NotYet => {
                        std::thread::sleep(left.min(Duration::from_secs(1)));
                        return Err(ClientError::Refused(Refusal::Starting));
                    }
                    Answer::Stale => {}
                }
            }
        }
    }

    fn reopen(&mut self) {
        self.decoder = Decoder::new();
        // When it fails, the next attempt to send says so.
        let _ = self.transport.reopen();
    }
}

enum Answer<T> {
    Picked(T),
    /// The node is starting.
    NotYet,
    /// Of an earlier request.
    Stale,
}

fn interpret<T>(
    id: u16,
    payload: &[u8],
    pick: &mut impl FnMut(Reply) -> Option<T>,
) -> Result<Answer<T>, ClientError> {
    let Ok(((node, found), body)) = postcard::take_from_bytes::<(u8, u16)>(payload) else {
        return Ok(Answer::Stale);
    };
    if found != id {
        return Ok(Answer::Stale);
    }
    match postcard::from_bytes::<Reply>(body) {
        Ok(Reply::Refused(Refusal::Starting)) => Ok(Answer::NotYet),
        Ok(Reply::Refused(refusal)) => Err(ClientError::Refused(refusal)),
        Ok(reply) => pick(reply).map(Answer::Picked).ok_or(ClientError::WrongAnswer),
        Err(_) if node != PROTOCOL_VERSION => {
            Err(ClientError::Refused(Refusal::Version { node, tool: PROTOCOL_VERSION }))
        }
        Err(_) => Err(ClientError::WrongAnswer),
    }
}

fn framed(id: u16, body: Request) -> Result<Vec<u8>, ClientError> {
    let envelope = Envelope { version: PROTOCOL_VERSION, id, body };
    let (mut payload, mut out) = ([0; MAX_PAYLOAD], [0; MAX_FRAME]);
    let payload = postcard::to_slice(&envelope, &mut payload).map_err(|_| ClientError::RequestTooLong)?;
    let length = frame::encode(payload, &mut out).map_err(|_| ClientError::RequestTooLong)?;
    Ok(out[..length].to_vec())
}

fn upload_progress(reply: Reply) -> Option<UploadProgress> {
    if let Reply::Upload(progress) = reply { Some(progress) } else { None }
}

fn now_us() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    proptest::proptest! {
        /// Any reply of any node, also of a later version or a broken one, is an answer or an error.
        #[test]
        fn property_arbitrary_replies_never_panic(body in proptest::collection::vec(0u8..12, 0..200)) {
            let payload = [&[PROTOCOL_VERSION, 7], body.as_slice()].concat();
            let _ = interpret(7, &payload, &mut upload_progress);
            let _ = interpret(7, &body, &mut |_| Some(()));
        }
    }
}
