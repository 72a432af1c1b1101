//! The thread's side of a line: sends one command at a time and collects its replies.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tracing::{trace, warn};

use super::request::{ExchangeFailure, ExpectedReplies, LineError, LineRequest, LineState, add};
use crate::bench::port::Port;
use crate::bench::wire::zaber::{
    CONTINUED, DeviceCommand, ID_MAX, MessageBody, Reply, decode_message,
};
use crate::bench::wire::zaber_stream::LineSplitter;

/// After this time a missing reply is taken as lost, and its id is free again.
const REPLY_LATE_MAX: Duration = Duration::from_secs(5);
/// Limit of the reads that discard old input, so that a line that is never quiet cannot block a
/// command.
const DISCARDED_READS_MAX: u32 = 64;
/// Longest single wait for bytes, after which a line that is being closed ends.
const READ_WAIT_MAX: Duration = Duration::from_millis(50);
/// Largest size of a reply with its continuations, in bytes.
const REPLY_BYTES_MAX: usize = 4096;

/// The state that the thread owns.
pub(super) struct Owner {
    pub port: Box<dyn Port>,
    pub shared: Arc<LineState>,
    pub lines: LineSplitter,
    pub next_id: u8,
    /// Ids whose reply may still arrive, each with the port's time until when.
    pub in_doubt: BTreeMap<u8, Duration>,
    /// Dropped after the port: fields are dropped in their order.
    pub _is_open: watch::Sender<()>,
}

impl Owner {
    pub fn run(
        mut self,
        mut requests: mpsc::Receiver<LineRequest>,
        mut urgent: mpsc::UnboundedReceiver<LineRequest>,
    ) {
        let shared = Arc::clone(&self.shared);
        let next = async |requests: &mut mpsc::Receiver<LineRequest>,
                          urgent: &mut mpsc::UnboundedReceiver<LineRequest>| {
            tokio::select! {
                biased;
                () = shared.closing.cancelled() => None,
                Some(request) = urgent.recv() => Some(request),
                request = requests.recv() => request,
            }
        };
        while let Some(request) = futures::executor::block_on(next(&mut requests, &mut urgent)) {
            // A motion is not started if its caller has stopped waiting.
            if request.stops.is_some() && request.answer.is_closed() {
                continue;
            }
            let outcome = self.serve(&request);
            // Fails if the caller dropped its future.
            let _ = request.answer.send(outcome);
        }
    }

    fn serve(&mut self, request: &LineRequest) -> Result<Vec<Reply>, ExchangeFailure> {
        let stops = *self.shared.stops.borrow();
        if request.stops.is_some_and(|then| then != stops) {
            return Err(ExchangeFailure::Final(LineError::CancelledByStop));
        }
        let Some(id) = self.free_id() else {
            // The replies to all hundred ids may still arrive: the device has been silent for long.
            return Err(ExchangeFailure::Silence(Vec::new()));
        };
        let command = DeviceCommand {
            id: Some(id),
            ..request.command.clone()
        };
        let packets = command
            .encode(true)
            .map_err(|e| ExchangeFailure::Final(e.into()))?;
        match self.exchange(&command, &packets, &request.expected, request.wait) {
            Ok(outcome) => {
                if outcome.is_err() {
                    let until = self.port.now() + REPLY_LATE_MAX;
                    self.in_doubt.insert(id, until);
                    add(&self.shared.counters.timeouts, "timeout");
                }
                outcome.map_err(ExchangeFailure::Silence)
            }
            Err(error) => {
                if !self.shared.closing.is_cancelled() {
                    warn!(port = %self.shared.port, "the connection is lost: {error}");
                    // Set once, before the line closes.
                    self.shared.lost.set(error.to_string()).ok();
                    // Closed at once, so that the port can be opened again when the device is back.
                    self.shared.closing.cancel();
                }
                Err(ExchangeFailure::Final(self.shared.gone()))
            }
        }
    }

    /// Returns the next id whose last reply has arrived or can no longer arrive.
    fn free_id(&mut self) -> Option<u8> {
        let now = self.port.now();
        self.in_doubt.retain(|_, until| *until > now);
        for _ in 0..=ID_MAX {
            let id = self.next_id;
            self.next_id = if id == ID_MAX { 0 } else { id + 1 };
            if !self.in_doubt.contains_key(&id) {
                return Some(id);
            }
        }
        None
    }

    /// Sends one command and collects the replies to it. `Ok(Err(replies))`: the time-out passed
    /// and replies are missing.
    fn exchange(
        &mut self,
        command: &DeviceCommand,
        packets: &[Vec<u8>],
        expected: &ExpectedReplies,
        wait: Duration,
    ) -> io::Result<Result<Vec<Reply>, Vec<Reply>>> {
        let mut buffer = [0; 512];
        let port = &mut self.port;
        add(&self.shared.counters.exchanges, "exchange");
        for _ in 0..DISCARDED_READS_MAX {
            let n = port.read(&mut buffer, Duration::ZERO)?;
            if n == 0 {
                break;
            }
            for line in self.lines.push(&buffer[..n]) {
                self.shared.put_aside(&line);
            }
        }
        self.lines.clear();
        self.shared.history().sent(command);
        for packet in packets {
            trace!(port = %self.shared.port, "> {}", packet.escape_ascii());
            port.write(packet)?;
        }
        let deadline = port.now() + wait;
        let mut gathering = Gathering {
            command,
            expected,
            whole: Vec::new(),
            open: None,
        };
        loop {
            let left = deadline.saturating_sub(port.now());
            if left.is_zero() {
                return Ok(Err(gathering.whole));
            }
            if self.shared.closing.is_cancelled() {
                return Err(io::ErrorKind::NotConnected.into());
            }
            let n = port.read(&mut buffer, left.min(READ_WAIT_MAX))?;
            for line in self.lines.push(&buffer[..n]) {
                trace!(port = %self.shared.port, "< {}", line.escape_ascii());
                if !gathering.take(&line, &self.shared) {
                    self.shared.put_aside(&line);
                }
            }
            if gathering.is_done() {
                return Ok(Ok(gathering.whole));
            }
        }
    }
}

/// Collects the replies to one command.
struct Gathering<'a> {
    command: &'a DeviceCommand,
    expected: &'a ExpectedReplies,
    whole: Vec<Reply>,
    /// A reply that continues in info messages.
    open: Option<Reply>,
}

impl Gathering<'_> {
    /// Takes a line if it belongs to the command; returns whether it did.
    fn take(&mut self, line: &[u8], shared: &LineState) -> bool {
        let Ok(message) = decode_message(line) else {
            return false;
        };
        if !message.checked && shared.checksum_required.load(Ordering::Relaxed) {
            add(&shared.counters.garbled, "garbled");
            return true;
        }
        match message.body {
            MessageBody::Reply(reply) => {
                if !self.is_awaited(&reply) {
                    return false;
                }
                shared.history().answered(&reply);
                if message.more {
                    self.open = Some(reply);
                } else {
                    self.whole.push(reply);
                }
                true
            }
            MessageBody::Info(info) => {
                let Some(reply) = &mut self.open else {
                    return false;
                };
                if (info.address, info.axis, info.id) != (reply.address, reply.axis, reply.id) {
                    return false;
                }
                let text = info.text.strip_prefix(CONTINUED).unwrap_or(&info.text);
                if reply.data.len() + text.len() < REPLY_BYTES_MAX {
                    reply.data.push(' ');
                    reply.data.push_str(text);
                }
                if !message.more {
                    self.whole.extend(self.open.take());
                }
                true
            }
            MessageBody::Alert(_) => false,
        }
    }

    fn is_awaited(&self, reply: &Reply) -> bool {
        if reply.id != self.command.id || reply.axis != self.command.axis {
            return false;
        }
        match self.expected {
            ExpectedReplies::One => reply.address == self.command.address && self.whole.is_empty(),
            ExpectedReplies::Each(addresses) => {
                addresses.contains(&reply.address)
                    && self.whole.iter().all(|r| r.address != reply.address)
            }
            // Replies of two devices with one address must both be kept; a repeated reply need not.
            ExpectedReplies::Anyone => !self.whole.contains(reply),
        }
    }

    fn is_done(&self) -> bool {
        match self.expected {
            ExpectedReplies::One => !self.whole.is_empty(),
            ExpectedReplies::Each(addresses) => self.whole.len() == addresses.len(),
            ExpectedReplies::Anyone => false,
        }
    }
}
