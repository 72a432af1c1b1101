//! The thread's side of a line: sends commands one at a time, stops at once, and collects the replies.

use std::collections::BTreeMap;
use std::io;
use std::mem;
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
/// Longest single wait for bytes, after which a stop is sent and a line that is being closed ends.
const READ_WAIT_MAX: Duration = Duration::from_millis(10);
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
    /// The commands that wait for their replies, in the order in which they were sent: at most one, and the stops that
    /// were sent since then.
    pub waiting: Vec<Exchange>,
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
        loop {
            let request = if self.waiting.is_empty() {
                match futures::executor::block_on(next(&mut requests, &mut urgent)) {
                    Some(request) => Some(request),
                    None => return,
                }
            } else {
                urgent.try_recv().ok()
            };
            let sent = request.map_or(Ok(()), |request| self.send(request));
            if let Err(error) = sent.and_then(|()| self.receive()) {
                if !self.shared.closing.is_cancelled() {
                    warn!(port = %self.shared.port, "the connection is lost: {error}");
                    // Set once, before the line closes.
                    self.shared.lost.set(error.to_string()).ok();
                    // Closed at once, so that the port can be opened again when the device is back.
                    self.shared.closing.cancel();
                }
                // Their callers get the error of a closed line.
                self.waiting.clear();
            }
        }
    }

    /// Sends a command, unless a stop or its caller has cancelled it.
    fn send(&mut self, request: LineRequest) -> io::Result<()> {
        // A motion is not started if its caller has stopped waiting.
        if request.stops.is_some() && request.answer.is_closed() {
            return Ok(());
        }
        let refuse = |request: LineRequest, failure| {
            // Fails if the caller dropped its future.
            let _ = request.answer.send(Err(failure));
            Ok(())
        };
        let stops = *self.shared.stops.borrow();
        if request.stops.is_some_and(|then| then != stops) {
            return refuse(request, ExchangeFailure::Final(LineError::CancelledByStop));
        }
        let Some(id) = self.free_id() else {
            // The replies to all hundred ids may still arrive: the device has been silent for long.
            return refuse(request, ExchangeFailure::Silence(Vec::new()));
        };
        let command = DeviceCommand {
            id: Some(id),
            ..request.command.clone()
        };
        let packets = match command.encode(true) {
            Ok(packets) => packets,
            Err(error) => return refuse(request, ExchangeFailure::Final(error.into())),
        };
        add(&self.shared.counters.exchanges, "exchange");
        for _ in 0..DISCARDED_READS_MAX {
            if self.take_in(Duration::ZERO)? == 0 {
                break;
            }
        }
        if self.waiting.is_empty() {
            self.lines.clear();
        }
        self.shared.history().sent(&command);
        self.write(&packets)?;
        let now = self.port.now();
        self.waiting.push(Exchange {
            deadline: now + request.wait,
            again_at: request.again_after.map(|wait| now + wait),
            packets,
            request,
            command,
            whole: Vec::new(),
            open: None,
        });
        Ok(())
    }

    fn write(&mut self, packets: &[Vec<u8>]) -> io::Result<()> {
        for packet in packets {
            trace!(port = %self.shared.port, "> {}", packet.escape_ascii());
            self.port.write(packet)?;
        }
        Ok(())
    }

    /// Sends the commands again that are due, under their ids: every reply to them counts.
    fn send_again(&mut self, now: Duration) -> io::Result<()> {
        let mut due = Vec::new();
        for exchange in &mut self.waiting {
            if let (Some(at), Some(wait)) = (exchange.again_at, exchange.request.again_after)
                && at <= now
                && !exchange.is_done()
            {
                exchange.again_at = Some(now + wait);
                due.extend(exchange.packets.iter().cloned());
            }
        }
        self.write(&due)
    }

    /// Waits a moment for replies and ends the exchanges that have theirs, or that can no longer get them.
    fn receive(&mut self) -> io::Result<()> {
        let Some(first) = self.waiting.iter().map(|exchange| exchange.deadline).min() else {
            return Ok(());
        };
        if self.shared.closing.is_cancelled() {
            return Err(io::ErrorKind::NotConnected.into());
        }
        let now = self.port.now();
        // At the deadline too: a reply that came while this thread did not run is here.
        self.take_in(first.saturating_sub(now).min(READ_WAIT_MAX))?;
        self.send_again(now)?;
        let mut sent = mem::take(&mut self.waiting);
        while let Some(exchange) = (!sent.is_empty()).then(|| sent.remove(0)) {
            let outcome = if exchange.is_done() {
                Ok(exchange.whole)
            } else if exchange.deadline <= now || exchange.is_overtaken(&sent) {
                let until = self.port.now() + REPLY_LATE_MAX;
                self.in_doubt
                    .extend(exchange.command.id.map(|id| (id, until)));
                add(&self.shared.counters.timeouts, "timeout");
                Err(ExchangeFailure::Silence(exchange.whole))
            } else {
                self.waiting.push(exchange);
                continue;
            };
            // Fails if the caller dropped its future.
            let _ = exchange.request.answer.send(outcome);
        }
        Ok(())
    }

    /// Waits at most `wait` for bytes and hands the lines in them to the commands that they answer. Returns the number of bytes.
    fn take_in(&mut self, wait: Duration) -> io::Result<usize> {
        let mut buffer = [0; 512];
        let n = self.port.read(&mut buffer, wait)?;
        for line in self.lines.push(&buffer[..n]) {
            trace!(port = %self.shared.port, "< {}", line.escape_ascii());
            let mut waiting = self.waiting.iter_mut();
            if !waiting.any(|exchange| exchange.take(&line, &self.shared)) {
                self.shared.put_aside(&line);
            }
        }
        Ok(n)
    }

    /// Returns the next id whose last reply has arrived or can no longer arrive.
    fn free_id(&mut self) -> Option<u8> {
        let now = self.port.now();
        self.in_doubt.retain(|_, until| *until > now);
        for _ in 0..=ID_MAX {
            let id = self.next_id;
            self.next_id = if id == ID_MAX { 0 } else { id + 1 };
            let is_awaited = |exchange: &Exchange| exchange.command.id == Some(id);
            if !self.in_doubt.contains_key(&id) && !self.waiting.iter().any(is_awaited) {
                return Some(id);
            }
        }
        None
    }
}

/// A command that waits for its replies.
pub(super) struct Exchange {
    request: LineRequest,
    /// As it was sent, with its id.
    command: DeviceCommand,
    packets: Vec<Vec<u8>>,
    deadline: Duration,
    /// When to send it again.
    again_at: Option<Duration>,
    whole: Vec<Reply>,
    /// A reply that continues in info messages.
    open: Option<Reply>,
}

impl Exchange {
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
        match &self.request.expected {
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
        match &self.request.expected {
            ExpectedReplies::One => !self.whole.is_empty(),
            ExpectedReplies::Each(addresses) => self.whole.len() == addresses.len(),
            ExpectedReplies::Anyone => false,
        }
    }

    /// Returns whether its reply is lost: a device answers in order, and this one has answered one of `later`.
    fn is_overtaken(&self, later: &[Exchange]) -> bool {
        let address = self.command.address;
        let mut replies = later.iter().flat_map(|exchange| &exchange.whole);
        matches!(self.request.expected, ExpectedReplies::One)
            && replies.any(|reply| reply.address == address)
    }
}
