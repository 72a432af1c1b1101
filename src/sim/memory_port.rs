//! The simulated controller without a pseudo-terminal: a port in memory whose time is the world's stepped clock.
//!
//! Every wait for a reply advances the clock, so the time-outs of the line cost no real time. One client at a time opens
//! the port, as on a serial line.

use std::collections::VecDeque;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::controller::Controller;
use crate::bench::port::{Port, PortAddress, PortError, PortSeam};
use crate::clock::{Clock, SteppedClock};

/// Time on the line of a command and its reply at 115,200 baud.
const EXCHANGE: Duration = Duration::from_millis(3);

/// Opens ports to a controller in memory.
#[derive(Debug, Clone)]
pub struct MemoryPorts {
    controller: Arc<Mutex<Controller>>,
    clock: Arc<SteppedClock>,
    open: Arc<AtomicBool>,
}

impl MemoryPorts {
    /// Makes the ports of a controller whose world runs on `clock`.
    #[must_use]
    pub fn new(controller: Controller, clock: Arc<SteppedClock>) -> Self {
        MemoryPorts {
            controller: Arc::new(Mutex::new(controller)),
            clock,
            open: Arc::default(),
        }
    }
}

impl PortSeam for MemoryPorts {
    fn open(&self, address: &PortAddress, _baud: u32) -> Result<Box<dyn Port>, PortError> {
        if self.open.swap(true, Ordering::SeqCst) {
            return Err(PortError::InUse {
                address: address.clone(),
            });
        }
        Ok(Box::new(MemoryPort {
            ports: self.clone(),
            ready: VecDeque::new(),
        }))
    }
}

struct MemoryPort {
    ports: MemoryPorts,
    ready: VecDeque<u8>,
}

impl MemoryPort {
    fn with_controller(&mut self, act: impl FnOnce(&mut Controller) -> Vec<u8>) {
        let mut controller = self
            .ports
            .controller
            .lock()
            .expect("no holder of this lock panics");
        self.ready.extend(act(&mut controller));
    }
}

impl Drop for MemoryPort {
    fn drop(&mut self) {
        self.ports.open.store(false, Ordering::SeqCst);
    }
}

impl Port for MemoryPort {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        if self.ready.is_empty() {
            self.ports.clock.advance(wait);
            self.with_controller(Controller::poll);
        }
        let n = buffer.len().min(self.ready.len());
        for (place, byte) in buffer.iter_mut().zip(self.ready.drain(..n)) {
            *place = byte;
        }
        Ok(n)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.ports.clock.advance(EXCHANGE);
        self.with_controller(|controller| controller.receive(bytes));
        Ok(())
    }

    fn now(&self) -> Duration {
        self.ports.clock.now()
    }
}
