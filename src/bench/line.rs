//! The one thread that owns a port: questions in, the answers that belong to them out.
//!
//! [`Line::open`] starts it, [`Line::ask`] is the one function to call. What holds here and nowhere
//! else has to care about: unread input is discarded before each exchange; a reply answers a
//! question only if address, axis and id are those of the question; an id is not used again while
//! its reply could still come; alerts are put aside; a stop goes ahead of all that waits, and what
//! was asked before it is not sent after it. Knows nothing of axes and angles.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, oneshot, watch};
use tracing::{debug, trace, warn};

use super::port::{self, Port, PortAddress, PortError, PortSeam};
use super::wire::zaber::{Body, CONTINUED, Command, EncodeError, ID_MAX, Reply, decode_message};
use super::wire::zaber_stream::Lines;

pub use super::port::NoFaults;

/// Requests that may wait; who asks beyond that waits to ask.
const QUEUE: usize = 32;
/// A reply that has not come by then never will: its id is free again.
const REPLY_LATE_MAX: Duration = Duration::from_secs(5);
/// A line that is never quiet must not keep a question from being sent.
const DISCARDED_READS_MAX: u32 = 64;
/// A reply and its continuations hold at most this many bytes.
const REPLY_BYTES_MAX: usize = 4096;

/// How patient a line is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineSettings {
    /// How long the first attempt waits for its reply; the n-th waits n times as long.
    pub reply_timeout: Duration,
    /// How often a question is asked before the device counts as silent; at least 1.
    pub attempts: u32,
}

impl Default for LineSettings {
    fn default() -> Self {
        LineSettings {
            reply_timeout: Duration::from_millis(300),
            attempts: 3,
        }
    }
}

/// Why a question has no answer.
#[derive(Debug, Clone, thiserror::Error)]
pub enum LineError {
    /// No reply came, however often it was asked.
    #[error(
        "the device with address {address} on {port} does not answer ({attempts} attempts, {discarded} garbled lines): \
         check cable and power, baud rate, and the address"
    )]
    NoReply {
        /// The port.
        port: String,
        /// The device asked.
        address: u8,
        /// How often.
        attempts: u32,
        /// Lines that came on this port so far and were garbled.
        discarded: u64,
    },
    /// The line is gone.
    #[error(
        "the line to {port} is gone ({reason}): look at its cable and at the power of the controller"
    )]
    Disconnected {
        /// The port.
        port: String,
        /// What the system says.
        reason: String,
    },
    /// A stop came after the request was made, so it was not sent.
    #[error("a stop came first; the command was not sent")]
    Overtaken,
    /// The command cannot be put on the line.
    #[error("the command cannot be sent: {0}")]
    Encoding(#[from] EncodeError),
}

/// What has been seen on a line that answers no question.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LineCounts {
    /// Exchanges begun.
    pub exchanges: u64,
    /// Exchanges without a reply in time.
    pub timeouts: u64,
    /// Lines that were garbled, torn or without the checksum that the device should send.
    pub garbled: u64,
    /// Replies that belong to no open question: late, twice, or somebody else's.
    pub strays: u64,
    /// Alerts.
    pub alerts: u64,
}

#[derive(Debug, Default)]
struct Counters {
    exchanges: AtomicU64,
    timeouts: AtomicU64,
    garbled: AtomicU64,
    strays: AtomicU64,
    alerts: AtomicU64,
}

#[derive(Debug)]
struct Shared {
    port: String,
    settings: LineSettings,
    counters: Counters,
    checksum_required: AtomicBool,
    stops: watch::Sender<u64>,
}

/// Which replies end an exchange.
#[derive(Debug, Clone)]
enum Expected {
    /// The one reply of the device and axis asked.
    One,
    /// One reply of each of these devices.
    Each(Vec<u8>),
    /// Whoever answers within the time.
    Anyone,
}

struct Job {
    command: Command,
    expected: Expected,
    wait: Duration,
    /// Number of stops there had been when this was asked; `None` if a stop does not matter.
    stops: Option<u64>,
    answer: oneshot::Sender<Result<Vec<Reply>, Failure>>,
}

enum Failure {
    Silence(Vec<Reply>),
    Final(LineError),
}

/// A handle to the thread that owns a port. Cheap to clone; the thread ends with the last one.
#[derive(Debug, Clone)]
pub struct Line {
    jobs: mpsc::Sender<Job>,
    urgent: mpsc::UnboundedSender<Job>,
    shared: Arc<Shared>,
}

impl Line {
    /// Opens a port and starts its thread.
    ///
    /// # Errors
    /// [`PortError`] names cause and remedy.
    pub fn open(
        address: &PortAddress,
        baud: u32,
        settings: LineSettings,
        seam: &dyn PortSeam,
    ) -> Result<Line, PortError> {
        let port = seam.wrap(port::open(address, baud)?);
        let (jobs, normal) = mpsc::channel(QUEUE);
        let (urgent, ahead) = mpsc::unbounded_channel();
        let shared = Arc::new(Shared {
            port: address.to_string(),
            settings,
            counters: Counters::default(),
            checksum_required: AtomicBool::new(false),
            stops: watch::Sender::new(0),
        });
        let owner = Owner {
            port: Ok(port),
            shared: Arc::clone(&shared),
            lines: Lines::of_messages(),
            next_id: 0,
            in_doubt: BTreeMap::new(),
        };
        std::thread::Builder::new()
            .name(format!("line {address}"))
            .spawn(move || owner.run(normal, ahead))
            .map_err(|source| PortError::NoThread {
                address: address.clone(),
                source,
            })?;
        Ok(Line {
            jobs,
            urgent,
            shared,
        })
    }

    /// Asks something that does no harm when asked twice, as often as the settings say.
    ///
    /// # Errors
    /// [`LineError`]; a refusal by the device is a reply, not an error.
    pub async fn ask(&self, command: &Command) -> Result<Reply, LineError> {
        let attempts = self.shared.settings.attempts.max(1);
        self.ask_up_to(command, None, attempts).await
    }

    /// Sends a command once, and not at all if there has been a stop since [`Line::stops`] gave
    /// `stops`.
    ///
    /// # Errors
    /// [`LineError::Overtaken`] after a stop; after [`LineError::NoReply`] the command may have been
    /// carried out or not, and the caller has to look.
    pub async fn command_once(&self, command: &Command, stops: u64) -> Result<Reply, LineError> {
        self.ask_up_to(command, Some(stops), 1).await
    }

    /// Stops all devices of the line with one broadcast, ahead of everything that waits, and makes
    /// sure that each of `addresses` has heard it.
    ///
    /// # Errors
    /// [`LineError`] if one of them does not answer.
    pub async fn stop(&self, addresses: &[u8]) -> Result<Vec<Reply>, LineError> {
        self.shared.stops.send_modify(|stops| *stops += 1);
        let command = Command::new(0, 0, "stop");
        let attempts = self.shared.settings.attempts.max(1);
        let mut heard: BTreeMap<u8, Reply> = BTreeMap::new();
        for attempt in 1..=attempts {
            let missing: Vec<u8> = addresses
                .iter()
                .copied()
                .filter(|a| !heard.contains_key(a))
                .collect();
            let expected = Expected::Each(missing);
            let (job, answer) = self.job(&command, expected, attempt, None);
            // Fails only if the thread is gone; then so is the answer.
            let _ = self.urgent.send(job);
            let replies = match self.answer(answer).await {
                Ok(replies) | Err(Failure::Silence(replies)) => replies,
                Err(Failure::Final(error)) => return Err(error),
            };
            heard.extend(replies.into_iter().map(|reply| (reply.address, reply)));
            if addresses.iter().all(|address| heard.contains_key(address)) {
                return Ok(heard.into_values().collect());
            }
        }
        let silent = addresses.iter().find(|a| !heard.contains_key(a));
        Err(self.silence(silent.copied().unwrap_or(0), attempts))
    }

    /// Asks every device and gives the replies that came within the reply time-out, in the order
    /// in which they came. No reply at all is an empty list.
    ///
    /// # Errors
    /// [`LineError`] if the line is gone.
    pub async fn ask_everyone(&self, words: &str) -> Result<Vec<Reply>, LineError> {
        let command = Command::new(0, 0, words);
        let (job, answer) = self.job(&command, Expected::Anyone, 1, None);
        let _ = self.jobs.send(job).await;
        match self.answer(answer).await {
            Ok(replies) | Err(Failure::Silence(replies)) => Ok(replies),
            Err(Failure::Final(error)) => Err(error),
        }
    }

    /// How many stops there have been.
    #[must_use]
    pub fn stops(&self) -> u64 {
        *self.shared.stops.borrow()
    }

    /// Completes when there have been more stops than `stops`.
    pub async fn stopped_since(&self, stops: u64) {
        let mut watch = self.shared.stops.subscribe();
        // Fails only without a sender, and `self` holds one.
        let _ = watch.wait_for(|now| *now > stops).await;
    }

    /// From now on lines without a checksum are discarded: the devices have been told to send one.
    pub fn require_checksums(&self) {
        self.shared.checksum_required.store(true, Ordering::Relaxed);
    }

    /// What came that answered no question.
    #[must_use]
    pub fn counts(&self) -> LineCounts {
        let counters = &self.shared.counters;
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        LineCounts {
            exchanges: read(&counters.exchanges),
            timeouts: read(&counters.timeouts),
            garbled: read(&counters.garbled),
            strays: read(&counters.strays),
            alerts: read(&counters.alerts),
        }
    }

    async fn ask_up_to(
        &self,
        command: &Command,
        stops: Option<u64>,
        attempts: u32,
    ) -> Result<Reply, LineError> {
        for attempt in 1..=attempts {
            let (job, answer) = self.job(command, Expected::One, attempt, stops);
            let _ = self.jobs.send(job).await;
            match self.answer(answer).await {
                Ok(mut replies) => {
                    if let Some(reply) = replies.pop() {
                        return Ok(reply);
                    }
                }
                Err(Failure::Silence(_)) => {}
                Err(Failure::Final(error)) => return Err(error),
            }
        }
        Err(self.silence(command.address, attempts))
    }

    fn job(
        &self,
        command: &Command,
        expected: Expected,
        attempt: u32,
        stops: Option<u64>,
    ) -> (Job, oneshot::Receiver<Result<Vec<Reply>, Failure>>) {
        let (answer, receiver) = oneshot::channel();
        let job = Job {
            command: command.clone(),
            expected,
            wait: self.shared.settings.reply_timeout * attempt,
            stops,
            answer,
        };
        (job, receiver)
    }

    async fn answer(
        &self,
        answer: oneshot::Receiver<Result<Vec<Reply>, Failure>>,
    ) -> Result<Vec<Reply>, Failure> {
        answer.await.unwrap_or_else(|_| {
            Err(Failure::Final(LineError::Disconnected {
                port: self.shared.port.clone(),
                reason: "its thread has ended".to_owned(),
            }))
        })
    }

    fn silence(&self, address: u8, attempts: u32) -> LineError {
        LineError::NoReply {
            port: self.shared.port.clone(),
            address,
            attempts,
            discarded: self.shared.counters.garbled.load(Ordering::Relaxed),
        }
    }
}

/// The thread's own side.
struct Owner {
    /// The port, or why it is gone.
    port: Result<Box<dyn Port>, String>,
    shared: Arc<Shared>,
    lines: Lines,
    next_id: u8,
    /// Ids whose reply may still come, and until when.
    in_doubt: BTreeMap<u8, Instant>,
}

impl Owner {
    fn run(mut self, mut jobs: mpsc::Receiver<Job>, mut urgent: mpsc::UnboundedReceiver<Job>) {
        let next = async |jobs: &mut mpsc::Receiver<Job>,
                          urgent: &mut mpsc::UnboundedReceiver<Job>| {
            tokio::select! {
                biased;
                Some(job) = urgent.recv() => Some(job),
                job = jobs.recv() => job,
            }
        };
        while let Some(job) = futures::executor::block_on(next(&mut jobs, &mut urgent)) {
            // A motion that nobody waits for any more is not begun.
            if job.stops.is_some() && job.answer.is_closed() {
                continue;
            }
            let outcome = self.serve(&job);
            // Nobody waits any more if the future was dropped.
            let _ = job.answer.send(outcome);
        }
    }

    fn serve(&mut self, job: &Job) -> Result<Vec<Reply>, Failure> {
        let stops = *self.shared.stops.borrow();
        if job.stops.is_some_and(|then| then != stops) {
            return Err(Failure::Final(LineError::Overtaken));
        }
        let Some(id) = self.free_id() else {
            // All hundred ids are in doubt: the device has been silent all the time.
            return Err(Failure::Silence(Vec::new()));
        };
        let command = Command {
            id: Some(id),
            ..job.command.clone()
        };
        let packets = command.encode(true).map_err(|e| Failure::Final(e.into()))?;
        match self.exchange(&command, &packets, &job.expected, job.wait) {
            Ok(outcome) => {
                if outcome.is_err() {
                    let until = Instant::now() + REPLY_LATE_MAX;
                    self.in_doubt.insert(id, until);
                    add(&self.shared.counters.timeouts, "timeout");
                }
                outcome.map_err(Failure::Silence)
            }
            Err(error) => {
                warn!(port = %self.shared.port, "the line is gone: {error}");
                // Closed at once, so that the port is free when it comes back.
                self.port = Err(error.to_string());
                Err(Failure::Final(self.gone()))
            }
        }
    }

    fn gone(&self) -> LineError {
        LineError::Disconnected {
            port: self.shared.port.clone(),
            reason: self.port.as_ref().err().cloned().unwrap_or_default(),
        }
    }

    /// The next id whose last reply has come or cannot come any more.
    fn free_id(&mut self) -> Option<u8> {
        let now = Instant::now();
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

    /// One question and what answers it. `Ok(Err(replies))`: the time is over and replies are
    /// missing.
    fn exchange(
        &mut self,
        command: &Command,
        packets: &[Vec<u8>],
        expected: &Expected,
        wait: Duration,
    ) -> io::Result<Result<Vec<Reply>, Vec<Reply>>> {
        let mut buffer = [0; 512];
        let port = match &mut self.port {
            Ok(port) => port,
            Err(reason) => return Err(io::Error::other(reason.clone())),
        };
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
        for packet in packets {
            trace!(port = %self.shared.port, "> {}", packet.escape_ascii());
            port.write(packet)?;
        }
        let deadline = Instant::now() + wait;
        let mut gathering = Gathering {
            command,
            expected,
            whole: Vec::new(),
            open: None,
        };
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(Err(gathering.whole));
            }
            let n = port.read(&mut buffer, left)?;
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

impl Shared {
    /// A line that answers no open question: counted, and told at debug level.
    fn put_aside(&self, line: &[u8]) {
        let counters = &self.counters;
        match decode_message(line).map(|message| message.body) {
            Err(_) => add(&counters.garbled, "garbled"),
            Ok(Body::Alert(_)) => add(&counters.alerts, "alert"),
            Ok(Body::Info(_)) => {}
            Ok(Body::Reply(_)) => add(&counters.strays, "stray"),
        }
        debug!(port = %self.port, "answers no question: {}", line.escape_ascii());
    }
}

/// Counts one on this line, and in the whole program for monitors.
fn add(counter: &AtomicU64, what: &'static str) {
    counter.fetch_add(1, Ordering::Relaxed);
    metrics::counter!("ridged_stage_line_total", "what" => what).increment(1);
}

/// Replies to one question as they come in.
struct Gathering<'a> {
    command: &'a Command,
    expected: &'a Expected,
    whole: Vec<Reply>,
    /// A reply that goes on in info messages.
    open: Option<Reply>,
}

impl Gathering<'_> {
    /// Takes a line if it belongs here.
    fn take(&mut self, line: &[u8], shared: &Shared) -> bool {
        let Ok(message) = decode_message(line) else {
            return false;
        };
        if !message.checked && shared.checksum_required.load(Ordering::Relaxed) {
            add(&shared.counters.garbled, "garbled");
            return true;
        }
        match message.body {
            Body::Reply(reply) => {
                if !self.is_awaited(&reply) {
                    return false;
                }
                if message.more {
                    self.open = Some(reply);
                } else {
                    self.whole.push(reply);
                }
                true
            }
            Body::Info(info) => {
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
            Body::Alert(_) => false,
        }
    }

    fn is_awaited(&self, reply: &Reply) -> bool {
        if reply.id != self.command.id || reply.axis != self.command.axis {
            return false;
        }
        match self.expected {
            Expected::One => reply.address == self.command.address && self.whole.is_empty(),
            Expected::Each(addresses) => {
                addresses.contains(&reply.address)
                    && self.whole.iter().all(|r| r.address != reply.address)
            }
            // Two devices with one address are to be found out, the same reply twice is not.
            Expected::Anyone => !self.whole.contains(reply),
        }
    }

    fn is_done(&self) -> bool {
        match self.expected {
            Expected::One => !self.whole.is_empty(),
            Expected::Each(addresses) => self.whole.len() == addresses.len(),
            Expected::Anyone => false,
        }
    }
}
