//! A controller whose line has the faults of a plan: what a client on the other side of a port meets.

use std::sync::Arc;

use super::{FaultSource, FaultyLine};
use crate::bench::wire::zaber_stream::LineSplitter;
use crate::sim::controller::{Controller, LineDevice};

/// A controller behind a faulty line.
#[derive(Debug)]
pub struct FaultyController {
    controller: Controller,
    line: FaultyLine,
    commands: LineSplitter,
}

impl FaultyController {
    /// Adds the faults of `source` to a controller's line.
    #[must_use]
    pub fn new(controller: Controller, source: Arc<dyn FaultSource>) -> Self {
        FaultyController {
            controller,
            line: FaultyLine::new(source),
            commands: LineSplitter::of_commands(),
        }
    }
}

impl LineDevice for FaultyController {
    fn receive(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for mut command in self.commands.push(bytes) {
            command.push(b'\n');
            let (to_device, early) = self.line.command(&command);
            out.extend(early);
            let reply = self.controller.receive(&to_device);
            out.extend(self.line.reply(&reply));
        }
        out
    }

    fn poll(&mut self) -> Vec<u8> {
        self.controller.poll()
    }

    fn may_alert(&self) -> bool {
        self.controller.may_alert()
    }

    fn new_client(&mut self) {
        self.commands.clear();
        self.controller.new_client();
    }
}
