//! Ports: a serial line or a TCP connection, used by one owner. A simulation injects faults here.
//!
//! [`open`] opens the operating system's ports; [`super::line`] reaches it through a [`PortSeam`]. Knows bytes, no protocol.

use std::fmt;
use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde::{Deserialize, Serialize};

use crate::clock;

/// Time limit for opening a TCP connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// A port that accepts no bytes for this long counts as broken.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);

/// Address of the controller's port: `/dev/ttyUSB0`, or `tcp://host:55550`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum PortAddress {
    /// A serial device or a pseudo-terminal.
    Serial {
        /// Its path.
        path: PathBuf,
    },
    /// A TCP connection that carries the same bytes.
    Tcp {
        /// Host and port number.
        address: String,
    },
}

/// A text that is not a port address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a port: expected a path like /dev/ttyUSB0, or tcp://host:55550")]
pub struct NotAnAddress(pub String);

impl FromStr for PortAddress {
    type Err = NotAnAddress;

    fn from_str(text: &str) -> Result<Self, NotAnAddress> {
        if let Some(address) = text.strip_prefix("tcp://") {
            let (host, port) = address
                .rsplit_once(':')
                .ok_or_else(|| NotAnAddress(text.to_owned()))?;
            if host.is_empty() || port.parse::<u16>().is_err() {
                return Err(NotAnAddress(text.to_owned()));
            }
            return Ok(PortAddress::Tcp {
                address: address.to_owned(),
            });
        }
        if text.is_empty() || text.contains("://") {
            return Err(NotAnAddress(text.to_owned()));
        }
        Ok(PortAddress::Serial {
            path: PathBuf::from(text),
        })
    }
}

impl TryFrom<String> for PortAddress {
    type Error = NotAnAddress;

    fn try_from(text: String) -> Result<Self, NotAnAddress> {
        text.parse()
    }
}

impl From<PortAddress> for String {
    fn from(address: PortAddress) -> String {
        address.to_string()
    }
}

impl fmt::Display for PortAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PortAddress::Serial { path } => write!(f, "{}", path.display()),
            PortAddress::Tcp { address } => write!(f, "tcp://{address}"),
        }
    }
}

/// Bytes to and from a controller.
pub trait Port: Send {
    /// Waits at most `wait` for bytes and returns how many arrived; 0 means none.
    ///
    /// # Errors
    /// The connection is lost; every later call fails too.
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize>;

    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// The connection is lost, or the port accepts no bytes.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Monotonic time by which the time-outs of this port run. A port in memory has its own.
    fn now(&self) -> Duration {
        clock::monotonic()
    }
}

/// The place at which a simulation replaces ports or injects faults: every port is opened through it.
pub trait PortSeam: Send + Sync {
    /// Opens a port for exclusive use, as [`open`] does.
    ///
    /// # Errors
    /// [`PortError`] names the cause and the remedy.
    fn open(&self, address: &PortAddress, baud: u32) -> Result<Box<dyn Port>, PortError>;
}

/// The ports of the operating system, without faults.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoFaults;

impl PortSeam for NoFaults {
    fn open(&self, address: &PortAddress, baud: u32) -> Result<Box<dyn Port>, PortError> {
        open(address, baud)
    }
}

/// Why a port cannot be opened, with the remedy.
#[derive(Debug, thiserror::Error)]
pub enum PortError {
    /// The port does not exist.
    #[error(
        "the port {address} does not exist ({present}): connect the controller and switch it on"
    )]
    Missing {
        /// The port asked for.
        address: PortAddress,
        /// The ports that exist, as text.
        present: String,
    },
    /// Another program has the port open.
    #[error(
        "the port {address} is in use by another program: close that program first ('fuser {address}' names it)"
    )]
    InUse {
        /// The port asked for.
        address: PortAddress,
    },
    /// The user lacks the permission.
    #[error(
        "no permission to open {address}: run 'sudo usermod -aG dialout $USER', then log out and in again"
    )]
    Permission {
        /// The port asked for.
        address: PortAddress,
    },
    /// A file that is not a serial line, or a line that refuses its settings.
    #[error("{address} cannot be used as a serial line ({reason})")]
    NotASerialLine {
        /// The port asked for.
        address: PortAddress,
        /// Message of the operating system.
        reason: String,
    },
    /// The TCP connection could not be opened.
    #[error(
        "cannot connect to {address}: check the address, and that the controller is switched on and reachable"
    )]
    Unreachable {
        /// The port asked for.
        address: PortAddress,
        /// Error of the operating system.
        #[source]
        source: io::Error,
    },
    /// The port's thread could not be started.
    #[error("the thread for the port {address} could not be started")]
    NoThread {
        /// The port asked for.
        address: PortAddress,
        /// Error of the operating system.
        #[source]
        source: io::Error,
    },
}

/// Opens a port for exclusive use. Serial lines are set to `baud`, 8 data bits, no parity, one stop
/// bit, no flow control.
///
/// # Errors
/// [`PortError`] names the cause and the remedy.
pub fn open(address: &PortAddress, baud: u32) -> Result<Box<dyn Port>, PortError> {
    match address {
        PortAddress::Serial { path } => serialport::new(path.to_string_lossy(), baud)
            .timeout(WRITE_TIMEOUT)
            .open_native()
            .map(|port| Box::new(SerialLine(port)) as Box<dyn Port>)
            .map_err(|error| serial_error(address, &error)),
        PortAddress::Tcp { address: host } => connect(host)
            .map(|stream| Box::new(TcpLine(stream)) as Box<dyn Port>)
            .map_err(|source| PortError::Unreachable {
                address: address.clone(),
                source,
            }),
    }
}

fn serial_error(address: &PortAddress, error: &serialport::Error) -> PortError {
    use serialport::ErrorKind;
    let address = address.clone();
    match error.kind() {
        ErrorKind::Io(io::ErrorKind::NotFound) => PortError::Missing {
            address,
            present: ports_present(),
        },
        // The serialport crate reports a lock held by another process this way.
        ErrorKind::NoDevice => PortError::InUse { address },
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => PortError::Permission { address },
        _ => PortError::NotASerialLine {
            address,
            reason: error.to_string(),
        },
    }
}

fn ports_present() -> String {
    let names: Vec<String> = serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        .map(|port| port.port_name)
        .collect();
    if names.is_empty() {
        "no serial port is present".to_owned()
    } else {
        format!("present: {}", names.join(", "))
    }
}

struct SerialLine(serialport::TTYPort);

impl Port for SerialLine {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        use serialport::SerialPort;
        self.0.set_timeout(wait)?;
        match self.0.read(buffer) {
            Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
            Err(e) if is_timeout(&e) => Ok(0),
            other => other,
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        use serialport::SerialPort;
        self.0.set_timeout(WRITE_TIMEOUT)?;
        self.0.write_all(bytes)
    }
}

struct TcpLine(TcpStream);

fn connect(host: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the host name has no address");
    for address in host.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
                return Ok(stream);
            }
            Err(error) => last = error,
        }
    }
    Err(last)
}

impl Port for TcpLine {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        let mut fds = [PollFd::from_borrowed_fd(self.0.as_fd(), PollFlags::IN)];
        let wait = Timespec {
            tv_sec: i64::try_from(wait.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: wait.subsec_nanos().into(),
        };
        match poll(&mut fds, Some(&wait)) {
            Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(0),
            Ok(_) => {}
            Err(error) => return Err(error.into()),
        }
        match self.0.read(buffer) {
            Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
            Err(e) if is_timeout(&e) => Ok(0),
            other => other,
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_a_path_or_a_tcp_url() {
        for text in ["/dev/ttyUSB0", "tcp://10.0.0.7:55550", "COM3"] {
            assert_eq!(text.parse::<PortAddress>().unwrap().to_string(), text);
        }
        for text in [
            "",
            "tcp://host",
            "tcp://:1",
            "udp://host:1",
            "tcp://h:99999",
        ] {
            assert!(text.parse::<PortAddress>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn a_missing_port_and_a_file_give_different_errors() {
        let missing = "/dev/there-is-no-such-port".parse().unwrap();
        assert!(matches!(
            open(&missing, 115_200),
            Err(PortError::Missing { .. })
        ));
        let file = tempfile::NamedTempFile::new().unwrap();
        let address = PortAddress::Serial {
            path: file.path().to_owned(),
        };
        assert!(matches!(
            open(&address, 115_200),
            Err(PortError::NotASerialLine { .. })
        ));
    }

    #[test]
    fn a_forbidden_port_names_the_command_that_helps() {
        let address = "/dev/ttyUSB0".parse().unwrap();
        let kind = serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied);
        let error = serial_error(&address, &serialport::Error::new(kind, "EACCES"));
        let text = error.to_string();
        assert!(
            text.contains("usermod -aG dialout") && text.contains("/dev/ttyUSB0"),
            "{text}"
        );
    }

    #[test]
    fn a_tcp_port_without_a_server_is_unreachable() {
        // Bound and dropped, so the port is free and has no listener.
        let free = std::net::TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap();
        let address = format!("tcp://{free}").parse().unwrap();
        assert!(matches!(
            open(&address, 0),
            Err(PortError::Unreachable { .. })
        ));
    }
}
