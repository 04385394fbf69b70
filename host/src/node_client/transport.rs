//! Lines to a node: serial port, pseudo-terminal, TCP, Unix socket.

use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::str::FromStr;
use std::time::Duration;

use super::ClientError;

/// Baud rate of the node's serial port.
pub const BAUD: u32 = 115_200;
/// For a connection over the network.
const CONNECT_PATIENCE: Duration = Duration::from_secs(5);

/// Something that carries bytes.
pub trait Transport: Send {
    /// Sends all bytes.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Waits up to `wait` for bytes; 0 when none came. An end of the stream is an error.
    fn receive(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize>;
    /// Opens the line again after it broke.
    fn reopen(&mut self) -> io::Result<()>;
    /// What to call it in messages.
    fn name(&self) -> String;
}

/// Where a node is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A serial port or pseudo-terminal.
    Serial {
        /// Name of the port, such as `/dev/ttyUSB0` or `COM3`.
        port: String,
        /// Baud rate.
        baud: u32,
    },
    /// `tcp:host:port`.
    Tcp(String),
    /// `unix:path`.
    Unix(String),
}

impl FromStr for Address {
    type Err = ClientError;

    fn from_str(address: &str) -> Result<Self, ClientError> {
        let wrong = |why| ClientError::Address { address: address.into(), why };
        if let Some(host_port) = address.strip_prefix("tcp:") {
            let (host, port) = host_port.rsplit_once(':').ok_or(wrong("tcp:HOST:PORT has a port"))?;
            if host.is_empty() || port.parse::<u16>().is_err() {
                return Err(wrong("tcp:HOST:PORT has a host and a port from 0 to 65535"));
            }
            return Ok(Address::Tcp(host_port.into()));
        }
        match address.strip_prefix("unix:") {
            Some("") => Err(wrong("unix:PATH has a path")),
            Some(path) => Ok(Address::Unix(path.into())),
            None if address.is_empty() => Err(wrong("it is empty")),
            None => Ok(Address::Serial { port: address.into(), baud: BAUD }),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Address::Serial { port, .. } => write!(f, "{port}"),
            Address::Tcp(host_port) => write!(f, "tcp:{host_port}"),
            Address::Unix(path) => write!(f, "unix:{path}"),
        }
    }
}

impl Address {
    /// Opens the line.
    pub fn open(&self) -> Result<Box<dyn Transport>, ClientError> {
        let port = self.connect().map_err(|source| ClientError::Line { line: self.to_string(), source })?;
        Ok(Box::new(Line { address: self.clone(), port: Some(port) }))
    }

    fn connect(&self) -> io::Result<Box<dyn Port>> {
        match self {
            Address::Serial { port, baud } => {
                // Without exclusive access two tools would take each other's answers.
                Ok(Box::new(serialport::new(port, *baud).timeout(Duration::from_secs(1)).open()?))
            }
            Address::Tcp(host_port) => Ok(Box::new(connect_tcp(host_port)?)),
            #[cfg(unix)]
            Address::Unix(path) => Ok(Box::new(std::os::unix::net::UnixStream::connect(path)?)),
            #[cfg(not(unix))]
            Address::Unix(_) => Err(ErrorKind::Unsupported.into()),
        }
    }
}

fn connect_tcp(host_port: &str) -> io::Result<TcpStream> {
    let mut failed = io::Error::from(ErrorKind::NotFound);
    for address in host_port.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_PATIENCE) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                return Ok(stream);
            }
            Err(error) => failed = error,
        }
    }
    Err(failed)
}

trait Port: Read + Write + Send {
    fn set_wait(&mut self, wait: Duration) -> io::Result<()>;
}

impl Port for Box<dyn serialport::SerialPort> {
    fn set_wait(&mut self, wait: Duration) -> io::Result<()> {
        Ok(self.set_timeout(wait)?)
    }
}

impl Port for TcpStream {
    fn set_wait(&mut self, wait: Duration) -> io::Result<()> {
        self.set_write_timeout(Some(CONNECT_PATIENCE))?;
        self.set_read_timeout(Some(wait))
    }
}

#[cfg(unix)]
impl Port for std::os::unix::net::UnixStream {
    fn set_wait(&mut self, wait: Duration) -> io::Result<()> {
        self.set_write_timeout(Some(CONNECT_PATIENCE))?;
        self.set_read_timeout(Some(wait))
    }
}

struct Line {
    address: Address,
    port: Option<Box<dyn Port>>,
}

impl Line {
    fn port(&mut self) -> io::Result<&mut Box<dyn Port>> {
        self.port.as_mut().ok_or_else(|| ErrorKind::NotConnected.into())
    }
}

impl Transport for Line {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let port = self.port()?;
        port.write_all(bytes)?;
        port.flush()
    }

    fn receive(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        let serial = matches!(self.address, Address::Serial { .. });
        let port = self.port()?;
        // Zero would mean to wait for ever.
        port.set_wait(wait.max(Duration::from_millis(1)))?;
        match port.read(buffer) {
            Ok(0) if !serial => Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => Ok(count),
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => Ok(0),
            Err(error) if error.kind() == ErrorKind::Interrupted => Ok(0),
            Err(error) => Err(error),
        }
    }

    fn reopen(&mut self) -> io::Result<()> {
        self.port = None; // first, because a port may be open once only
        self.port = Some(self.address.connect()?);
        Ok(())
    }

    fn name(&self) -> String {
        self.address.to_string()
    }
}

/// Serial ports of this computer: name, and what the system knows of the device.
pub fn serial_ports() -> Result<Vec<(String, String)>, ClientError> {
    let listed = serialport::available_ports()
        .map_err(|error| ClientError::Line { line: "list of serial ports".into(), source: error.into() })?;
    Ok(listed.into_iter().map(|port| (port.port_name, describe(&port.port_type))).collect())
}

fn describe(kind: &serialport::SerialPortType) -> String {
    match kind {
        serialport::SerialPortType::UsbPort(usb) => {
            let text = |part: &Option<String>| part.clone().unwrap_or_default();
            let words = [text(&usb.manufacturer), text(&usb.product), text(&usb.serial_number)];
            let words: Vec<_> = words.into_iter().filter(|word| !word.is_empty()).collect();
            format!("USB {:04x}:{:04x} {}", usb.vid, usb.pid, words.join(" ")).trim_end().into()
        }
        serialport::SerialPortType::BluetoothPort => "Bluetooth".into(),
        serialport::SerialPortType::PciPort => "built in".into(),
        serialport::SerialPortType::Unknown => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_addresses_are_told_apart() {
        let parsed = |text: &str| text.parse::<Address>().ok();
        assert_eq!(parsed("/dev/ttyUSB0"), Some(Address::Serial { port: "/dev/ttyUSB0".into(), baud: BAUD }));
        assert_eq!(parsed("COM3"), Some(Address::Serial { port: "COM3".into(), baud: BAUD }));
        assert_eq!(parsed("tcp:localhost:7000"), Some(Address::Tcp("localhost:7000".into())));
        assert_eq!(parsed("tcp:[::1]:7000"), Some(Address::Tcp("[::1]:7000".into())));
        assert_eq!(parsed("unix:/run/node"), Some(Address::Unix("/run/node".into())));
        for wrong in ["", "tcp:localhost", "tcp::7000", "tcp:x:70000", "unix:"] {
            assert_eq!(parsed(wrong), None, "{wrong}");
        }
        for text in ["/dev/ttyUSB0", "tcp:localhost:7000", "unix:/run/node"] {
            assert_eq!(parsed(text).unwrap().to_string(), text);
        }
    }
}
