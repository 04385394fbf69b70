//! Lines to a simulated node: inside the program, over TCP, and as a pseudo-terminal.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use super::SimulatedNode;
use crate::node_client::Transport;

/// A simulated node that several may use.
pub type SharedNode = Arc<Mutex<SimulatedNode>>;

/// A line to a node in this program.
pub fn in_process(node: SharedNode) -> Box<dyn Transport> {
    Box::new(InProcess { node, answers: Vec::new() })
}

struct InProcess {
    node: SharedNode,
    answers: Vec<u8>,
}

impl Transport for InProcess {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.answers.extend(answer(&self.node, bytes));
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        let count = self.answers.len().min(buffer.len());
        if count == 0 {
            // The node answers at once or never.
            thread::sleep(wait.min(Duration::from_millis(1)));
        }
        buffer[..count].copy_from_slice(&self.answers[..count]);
        self.answers.drain(..count);
        Ok(count)
    }

    fn reopen(&mut self) -> io::Result<()> {
        self.answers.clear();
        Ok(())
    }

    fn name(&self) -> String {
        "simulated node".into()
    }
}

/// A simulated node that answers on a line of its own, until the program ends.
pub struct Listener {
    /// For the field tool.
    pub address: String,
}

impl Listener {
    /// On TCP; port 0 takes a free one. One client after another.
    pub fn tcp(address: SocketAddr, node: SharedNode) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let address = format!("tcp:{}", listener.local_addr()?);
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                // A client that goes away ends its line, not the listener.
                let _ = stream.set_nodelay(true).and_then(|()| serve(stream, &node));
            }
        });
        Ok(Listener { address })
    }

    /// As a pseudo-terminal.
    #[cfg(unix)]
    pub fn pseudo_terminal(node: SharedNode) -> io::Result<Self> {
        use serialport::SerialPort;
        let (mut near, far) = serialport::TTYPort::pair()?;
        let address = far.name().ok_or(ErrorKind::NotFound)?;
        near.set_timeout(Duration::from_secs(3600))?;
        thread::spawn(move || {
            // Kept open: without it the near end fails whenever no client is there.
            let _far = far;
            loop {
                let since = Instant::now();
                let _ = serve(&mut near, &node);
                thread::sleep(Duration::from_millis(100).saturating_sub(since.elapsed()));
            }
        });
        Ok(Listener { address })
    }
}

fn serve(mut line: impl Read + Write, node: &SharedNode) -> io::Result<()> {
    let mut bytes = [0; 1024];
    loop {
        match line.read(&mut bytes) {
            Ok(0) => return Ok(()),
            Ok(count) => line.write_all(&answer(node, &bytes[..count]))?,
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
            Err(error) => return Err(error),
        }
    }
}

fn answer(node: &SharedNode, bytes: &[u8]) -> Vec<u8> {
    node.lock().unwrap_or_else(PoisonError::into_inner).receive(bytes)
}
