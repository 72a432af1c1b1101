//! Serves the simulated controller on a pseudo-terminal or a TCP port.
//!
//! [`serve_pty`] and [`serve_tcp`] each start one named thread that ends when the server is
//! dropped. Start one server per world: two would be two chains of controllers on the same motors.

use std::fs::File;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr};

use super::controller::LineDevice;

/// Interval at which the controller is polled while an alert may become due.
const ALERT_TICK: Timespec = Timespec {
    tv_sec: 0,
    tv_nsec: 2_000_000,
};

/// The controller on a pseudo-terminal. It stops when dropped, and the client then sees a lost
/// connection.
#[derive(Debug)]
pub struct PtyServer {
    path: PathBuf,
    _thread: ServerThread,
}

impl PtyServer {
    /// The path to open as a serial port.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// The controller on a TCP port; stops when dropped.
#[derive(Debug)]
pub struct TcpServer {
    address: SocketAddr,
    _thread: ServerThread,
}

impl TcpServer {
    /// The address on which it listens; the port is never 0.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

/// A thread that ends when this is dropped: the other end of the pipe closes.
#[derive(Debug)]
struct ServerThread {
    alive: Option<OwnedFd>,
    thread: Option<JoinHandle<()>>,
}

impl ServerThread {
    fn start(name: &str, body: impl FnOnce(OwnedFd) + Send + 'static) -> io::Result<Self> {
        let (wake, alive) = rustix::pipe::pipe()?;
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || body(wake))?;
        Ok(ServerThread {
            alive: Some(alive),
            thread: Some(thread),
        })
    }
}

impl Drop for ServerThread {
    fn drop(&mut self) {
        drop(self.alive.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has already been printed.
            let _ = thread.join();
        }
    }
}

/// Serves controllers on a new pseudo-terminal.
///
/// # Errors
/// The system provides no pseudo-terminal or no thread.
pub fn serve_pty(mut controller: impl LineDevice) -> io::Result<PtyServer> {
    let master = rustix::pty::openpt(
        rustix::pty::OpenptFlags::RDWR
            | rustix::pty::OpenptFlags::NOCTTY
            | rustix::pty::OpenptFlags::CLOEXEC,
    )?;
    rustix::pty::grantpt(&master)?;
    rustix::pty::unlockpt(&master)?;
    let name = rustix::pty::ptsname(&master, Vec::new())?;
    let path = PathBuf::from(name.to_string_lossy().into_owned());
    // Held open so that the line and its settings outlive each client.
    let slave = rustix::fs::open(
        &path,
        rustix::fs::OFlags::RDWR | rustix::fs::OFlags::NOCTTY | rustix::fs::OFlags::CLOEXEC,
        rustix::fs::Mode::empty(),
    )?;
    let mut settings = tcgetattr(&slave)?;
    settings.make_raw();
    tcsetattr(&slave, OptionalActions::Now, &settings)?;
    // A client that does not read loses bytes, as on a real line, and does not block the
    // controller.
    rustix::fs::fcntl_setfl(&master, rustix::fs::OFlags::NONBLOCK)?;

    let mut master = File::from(master);
    let thread = ServerThread::start("simulated-rig-pty", move |wake| {
        let mut buffer = [0; 1024];
        loop {
            match wait(&wake, &master, controller.may_alert()) {
                Ready::Stop => return,
                Ready::Tick => send(&mut master, &controller.poll()),
                Ready::Bytes => match master.read(&mut buffer) {
                    Ok(n) => {
                        send(&mut master, &controller.receive(&buffer[..n]));
                        // Clients open the line exclusively, and this flag would outlive a client
                        // that was killed. File locks end with their client and still keep other
                        // programs out.
                        let _ = ioctl_tiocnxcl(&slave);
                    }
                    Err(e) if e.kind() == io::ErrorKind::WouldBlock => {}
                    Err(_) => return,
                },
            }
        }
    })?;
    Ok(PtyServer {
        path,
        _thread: thread,
    })
}

/// Serves controllers on a TCP port, one client after the other.
///
/// # Errors
/// The address cannot be bound, or there is no thread.
pub fn serve_tcp(mut controller: impl LineDevice, address: SocketAddr) -> io::Result<TcpServer> {
    let listener = TcpListener::bind(address)?;
    let address = listener.local_addr()?;
    let thread = ServerThread::start("simulated-rig-tcp", move |wake| {
        loop {
            if let Ready::Stop = wait(&wake, &listener, false) {
                return;
            }
            let Ok((client, _)) = listener.accept() else {
                continue;
            };
            controller.new_client();
            if let Ready::Stop = serve_client(&wake, client, &mut controller) {
                return;
            }
        }
    })?;
    Ok(TcpServer {
        address,
        _thread: thread,
    })
}

enum Ready {
    Stop,
    Bytes,
    Tick,
}

fn wait(wake: &OwnedFd, line: &impl AsFd, ticking: bool) -> Ready {
    let mut fds = [
        PollFd::new(wake, PollFlags::IN),
        PollFd::new(line, PollFlags::IN),
    ];
    match poll(&mut fds, ticking.then_some(&ALERT_TICK)) {
        Err(rustix::io::Errno::INTR) | Ok(0) => return Ready::Tick,
        Err(_) => return Ready::Stop,
        Ok(_) => {}
    }
    if fds[0].revents().is_empty() {
        Ready::Bytes
    } else {
        Ready::Stop
    }
}

fn serve_client(wake: &OwnedFd, mut client: TcpStream, controller: &mut impl LineDevice) -> Ready {
    // If these two fail, the server still works, only slower or with less protection.
    let _ = client.set_nodelay(true);
    let _ = client.set_nonblocking(true);
    let mut buffer = [0; 1024];
    loop {
        match wait(wake, &client, controller.may_alert()) {
            Ready::Stop => return Ready::Stop,
            Ready::Tick => send(&mut client, &controller.poll()),
            Ready::Bytes => match client.read(&mut buffer) {
                Ok(n @ 1..) => send(&mut client, &controller.receive(&buffer[..n])),
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => {}
                Ok(0) | Err(_) => return Ready::Tick,
            },
        }
    }
}

/// Sends as much as the line accepts; the rest is lost if the client has gone or does not read.
fn send(line: &mut impl Write, bytes: &[u8]) {
    if !bytes.is_empty() {
        let _ = line.write_all(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::SteppedClock;
    use crate::sim::controller::Controller;
    use crate::sim::world::{World, WorldSettings};
    use std::sync::Arc;
    use std::time::Duration;

    fn controller() -> Controller {
        let clock = Arc::new(SteppedClock::new());
        Controller::new(&Arc::new(World::new(clock, WorldSettings::default())))
    }

    fn ask(line: &mut (impl Read + Write), command: &str, expected: &str) {
        line.write_all(command.as_bytes()).unwrap();
        let mut answer = vec![0; expected.len()];
        line.read_exact(&mut answer).unwrap();
        assert_eq!(String::from_utf8(answer).unwrap(), expected);
    }

    fn open(path: &Path) -> Box<dyn serialport::SerialPort> {
        serialport::new(path.to_string_lossy(), 115_200)
            .timeout(Duration::from_secs(5))
            .open()
            .unwrap()
    }

    #[test]
    fn the_pty_is_a_serial_port_and_outlives_its_clients() {
        let server = serve_pty(controller()).unwrap();
        for _ in 0..3 {
            let mut port = open(server.path());
            ask(
                &mut port,
                "/1 0 02 get version:77\n",
                "@01 0 02 OK IDLE WR 7.38:1C\r\n",
            );
        }
    }

    #[test]
    fn a_client_loses_its_connection_when_the_server_is_dropped() {
        let server = serve_pty(controller()).unwrap();
        let mut port = open(server.path());
        ask(&mut port, "/1 1\n", "@01 1 OK IDLE WR 0\r\n");
        drop(server);
        let error = port.read(&mut [0; 8]).unwrap_err();
        assert_ne!(error.kind(), io::ErrorKind::TimedOut);
    }

    #[test]
    fn tcp_serves_one_client_after_the_other() {
        let server = serve_tcp(controller(), "127.0.0.1:0".parse().unwrap()).unwrap();
        for _ in 0..3 {
            let mut client = TcpStream::connect(server.address()).unwrap();
            // An unfinished command of one client does not reach the next.
            ask(&mut client, "/2 1\n/1 1 move", "@02 1 OK IDLE WR 0\r\n");
        }
        let waiting = TcpStream::connect(server.address()).unwrap();
        drop(server);
        let ended = (&waiting).read(&mut [0; 8]);
        assert!(matches!(ended, Ok(0) | Err(_)));
    }
}
