//! The thread that owns a port: it sends commands and matches the replies to them.
//!
//! [`PortLine::open`] starts the thread; [`PortLine::ask`] is the function to call. The thread
//! guarantees:
//!
//! - Unread input is discarded before each exchange.
//! - A reply answers a command only if address, axis and id agree.
//! - An id is not reused while its reply can still arrive.
//! - Alerts are set aside.
//! - A stop is sent before all waiting commands, at most 10 ms after it was issued although another command waits for its
//!   reply. It is sent again every 100 ms until every device has acknowledged it. Motions issued before the stop are not sent after
//!   it.
//! - A command whose device has answered a later stop is no longer waited for: devices answer in order.
//! - [`PortLine::close`] closes the port for all handles, so that no forgotten handle keeps a port
//!   from being opened again.
//!
//! This module knows nothing of axes and angles. Its requests and replies are those of Zaber ASCII; a port that speaks another
//! protocol translates them.

mod history;
mod owner;
mod request;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

use super::port::{PortAddress, PortError, PortSeam};
use super::wire::zaber::{DeviceCommand, Reply};
use super::wire::zaber_stream::LineSplitter;

pub use super::port::NoFaults;
use owner::Owner;
use request::{Counters, ExchangeFailure, ExpectedReplies, LineRequest, LineState};
pub use request::{LineCounts, LineError, LineSettings};

/// Time after which a stop without its replies is sent again: a reply takes a few milliseconds, and the axes may move meanwhile.
const STOP_AGAIN_AFTER: Duration = Duration::from_millis(100);
/// Capacity of the queue of requests; further callers wait for a place.
const QUEUE: usize = 32;

/// A handle to the thread that owns a port. Cheap to clone; the thread ends with the last handle, or
/// with [`PortLine::close`].
#[derive(Debug, Clone)]
pub struct PortLine {
    requests: mpsc::Sender<LineRequest>,
    urgent: mpsc::UnboundedSender<LineRequest>,
    shared: Arc<LineState>,
    /// Its sender is dropped after the port.
    open: watch::Receiver<()>,
}

impl PortLine {
    /// Opens a port and starts its thread.
    ///
    /// # Errors
    /// [`PortError`] names the cause and the remedy.
    pub fn open(
        address: &PortAddress,
        baud: u32,
        settings: LineSettings,
        seam: &dyn PortSeam,
    ) -> Result<PortLine, PortError> {
        let port = seam.open(address, baud)?;
        let (requests, normal) = mpsc::channel(QUEUE);
        let (urgent, ahead) = mpsc::unbounded_channel();
        let shared = Arc::new(LineState {
            port: address.to_string(),
            settings,
            counters: Counters::default(),
            checksum_required: AtomicBool::new(false),
            stops: watch::Sender::new(0),
            history: Mutex::default(),
            closing: CancellationToken::new(),
            lost: OnceLock::new(),
        });
        let (is_open, open) = watch::channel(());
        let owner = Owner {
            port,
            shared: Arc::clone(&shared),
            lines: LineSplitter::of_messages(),
            next_id: 0,
            in_doubt: BTreeMap::new(),
            waiting: Vec::new(),
            _is_open: is_open,
        };
        std::thread::Builder::new()
            .name(format!("line {address}"))
            .spawn(move || owner.run(normal, ahead))
            .map_err(|source| PortError::NoThread {
                address: address.clone(),
                source,
            })?;
        Ok(PortLine {
            requests,
            urgent,
            shared,
            open,
        })
    }

    /// Closes the port for all handles. Every waiting and later command fails with
    /// [`LineError::Disconnected`].
    pub fn close(&self) {
        self.shared.closing.cancel();
    }

    /// Whether the port is closed or about to close: [`PortLine::close`] was called, or the
    /// connection is lost.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.shared.closing.is_cancelled()
    }

    /// The error of every command on a closed line.
    #[must_use]
    pub fn loss(&self) -> LineError {
        self.shared.gone()
    }

    /// Completes when the port of a closed line may be opened again.
    pub async fn closed(&self) {
        // Nothing is ever sent: this ends when the thread drops its sender.
        self.open.clone().changed().await.ok();
    }

    /// Sends a command that may safely be repeated, up to the configured number of attempts.
    ///
    /// # Errors
    /// [`LineError`]; a refusal by the device is a reply, not an error.
    pub async fn ask(&self, command: &DeviceCommand) -> Result<Reply, LineError> {
        let attempts = self.shared.settings.attempts.max(1);
        self.ask_up_to(command, None, attempts, 1).await
    }

    /// As [`PortLine::ask`], with more and shorter attempts that take about as long together: a person waits for what it says.
    ///
    /// # Errors
    /// As [`PortLine::ask`].
    pub async fn ask_soon(&self, command: &DeviceCommand) -> Result<Reply, LineError> {
        let attempts = self.shared.settings.attempts.max(1);
        self.ask_up_to(command, None, 2 * attempts - 1, 3).await
    }

    /// Sends a command once, unless there has been a stop since [`PortLine::stops`] returned
    /// `stops`.
    ///
    /// # Errors
    /// [`LineError::CancelledByStop`] after a stop. After [`LineError::NoReply`] the device may have
    /// executed the command or not; the caller must check.
    pub async fn command_once(
        &self,
        command: &DeviceCommand,
        stops: u64,
    ) -> Result<Reply, LineError> {
        self.ask_up_to(command, Some(stops), 1, 1).await
    }

    /// Stops all devices of the line with one broadcast, before all waiting commands, and checks
    /// that each of `addresses` acknowledged it.
    ///
    /// # Errors
    /// [`LineError`] if one of them does not answer.
    pub async fn stop(&self, addresses: &[u8]) -> Result<Vec<Reply>, LineError> {
        match self.stop_each(addresses).await {
            (replies, None) => Ok(replies),
            (_, Some(error)) => Err(error),
        }
    }

    /// As [`PortLine::stop`]; returns the replies also where one of the devices does not answer.
    pub async fn stop_each(&self, addresses: &[u8]) -> (Vec<Reply>, Option<LineError>) {
        self.shared.stops.send_modify(|stops| *stops += 1);
        let command = DeviceCommand::new(0, 0, "stop");
        let LineSettings {
            reply_timeout,
            attempts,
        } = self.shared.settings;
        // As long as the attempts of another command.
        let waits = (1..=attempts.max(1)).map(|attempt| reply_timeout * attempt);
        let expected = ExpectedReplies::Each(addresses.to_vec());
        let (request, answer) = self.request(&command, expected, waits.sum(), None);
        let request = LineRequest {
            again_after: Some(STOP_AGAIN_AFTER.min(reply_timeout)),
            ..request
        };
        // Fails only if the thread has ended; the answer then reports that.
        let _ = self.urgent.send(request);
        let replies = match self.answer(answer).await {
            Ok(replies) => return (replies, None),
            Err(ExchangeFailure::Silence(replies)) => replies,
            Err(ExchangeFailure::Final(error)) => return (Vec::new(), Some(error)),
        };
        let heard = |address: &&u8| replies.iter().any(|reply| reply.address == **address);
        let silent = addresses.iter().find(|address| !heard(address));
        let silence = self.silence(silent.copied().unwrap_or(0), attempts);
        (replies, Some(silence))
    }

    /// Sends a command to every device and returns the replies that arrive within the reply
    /// time-out, in order of arrival. The list is empty if no device replies.
    ///
    /// # Errors
    /// [`LineError`] if the connection is lost.
    pub async fn ask_everyone(&self, words: &str) -> Result<Vec<Reply>, LineError> {
        let command = DeviceCommand::new(0, 0, words);
        let (request, answer) = self.request(
            &command,
            ExpectedReplies::Anyone,
            self.shared.settings.reply_timeout,
            None,
        );
        let _ = self.requests.send(request).await;
        match self.answer(answer).await {
            Ok(replies) | Err(ExchangeFailure::Silence(replies)) => Ok(replies),
            Err(ExchangeFailure::Final(error)) => Err(error),
        }
    }

    /// Number of stops so far.
    #[must_use]
    pub fn stops(&self) -> u64 {
        *self.shared.stops.borrow()
    }

    /// Completes when the number of stops exceeds `stops`.
    pub async fn stopped_since(&self, stops: u64) {
        let mut watch = self.shared.stops.subscribe();
        // Fails only without a sender, and `self` holds one.
        let _ = watch.wait_for(|now| *now > stops).await;
    }

    /// Discards lines without a checksum from now on: the devices have been set to send one.
    pub fn require_checksums(&self) {
        self.shared.checksum_required.store(true, Ordering::Relaxed);
    }

    /// Counters of the lines that answered no command.
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
            second_answers: read(&counters.second_answers),
            second_answer_address: counters.second_answer_address.load(Ordering::Relaxed),
            foreign: read(&counters.foreign),
        }
    }

    async fn ask_up_to(
        &self,
        command: &DeviceCommand,
        stops: Option<u64>,
        attempts: u32,
        shorter: u32,
    ) -> Result<Reply, LineError> {
        for attempt in 1..=attempts {
            let wait = self.shared.settings.reply_timeout * attempt / shorter;
            let (request, answer) = self.request(command, ExpectedReplies::One, wait, stops);
            let _ = self.requests.send(request).await;
            match self.answer(answer).await {
                Ok(mut replies) => {
                    if let Some(reply) = replies.pop() {
                        return Ok(reply);
                    }
                }
                Err(ExchangeFailure::Silence(_)) => {}
                Err(ExchangeFailure::Final(error)) => return Err(error),
            }
        }
        Err(self.silence(command.address, attempts))
    }

    fn request(
        &self,
        command: &DeviceCommand,
        expected: ExpectedReplies,
        wait: Duration,
        stops: Option<u64>,
    ) -> (
        LineRequest,
        oneshot::Receiver<Result<Vec<Reply>, ExchangeFailure>>,
    ) {
        let (answer, receiver) = oneshot::channel();
        let request = LineRequest {
            command: command.clone(),
            expected,
            wait,
            again_after: None,
            stops,
            answer,
        };
        (request, receiver)
    }

    async fn answer(
        &self,
        answer: oneshot::Receiver<Result<Vec<Reply>, ExchangeFailure>>,
    ) -> Result<Vec<Reply>, ExchangeFailure> {
        answer
            .await
            .unwrap_or_else(|_| Err(ExchangeFailure::Final(self.shared.gone())))
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
