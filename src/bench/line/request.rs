//! What a [`super::PortLine`] and its thread exchange: requests, failures, and the state that both see.

use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock};
use std::time::Duration;

use tokio::sync::{oneshot, watch};
use tokio_util::sync::CancellationToken;
use tracing::debug;

use super::history::{History, Stray};
use crate::bench::wire::zaber::{DeviceCommand, EncodeError, MessageBody, Reply, decode_message};

/// Time-out and number of attempts of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineSettings {
    /// Time that the first attempt waits for its reply; attempt n waits n times as long.
    pub reply_timeout: Duration,
    /// Attempts until the device counts as silent; at least 1.
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

/// Why a command has no reply.
#[derive(Debug, Clone, thiserror::Error)]
pub enum LineError {
    /// No attempt was answered.
    #[error(
        "the device with address {address} on {port} does not answer ({attempts} attempts, {discarded} garbled lines): \
         check cable and power, baud rate, and the address"
    )]
    NoReply {
        /// The port.
        port: String,
        /// The device asked.
        address: u8,
        /// Number of attempts.
        attempts: u32,
        /// Garbled lines received on this port so far.
        discarded: u64,
    },
    /// The connection is lost.
    #[error(
        "the connection to {port} is lost ({reason}): check the cable and the power of the controller"
    )]
    Disconnected {
        /// The port.
        port: String,
        /// Message of the operating system.
        reason: String,
    },
    /// A stop was issued after the request, so the command was not sent.
    #[error("the command was not sent because the stage was stopped first")]
    CancelledByStop,
    /// The command cannot be encoded.
    #[error("the command cannot be sent: {0}")]
    Encoding(#[from] EncodeError),
}

/// Counters of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LineCounts {
    /// Exchanges started.
    pub exchanges: u64,
    /// Exchanges without a reply in time.
    pub timeouts: u64,
    /// Lines that were garbled, torn, or lacked the checksum that the device should send.
    pub garbled: u64,
    /// Replies that belong to no open command: late, duplicate, or meant for another host.
    pub strays: u64,
    /// Alerts received.
    pub alerts: u64,
    /// Strays that are a second, different answer to the newest command.
    pub second_answers: u64,
    /// Address of the last of them.
    pub second_answer_address: u8,
    /// Strays that no command of this line explains.
    pub foreign: u64,
}

#[derive(Debug, Default)]
pub(super) struct Counters {
    pub exchanges: AtomicU64,
    pub timeouts: AtomicU64,
    pub garbled: AtomicU64,
    pub strays: AtomicU64,
    pub alerts: AtomicU64,
    pub second_answers: AtomicU64,
    pub second_answer_address: AtomicU8,
    pub foreign: AtomicU64,
}

#[derive(Debug)]
pub(super) struct LineState {
    pub port: String,
    pub settings: LineSettings,
    pub counters: Counters,
    pub checksum_required: AtomicBool,
    pub stops: watch::Sender<u64>,
    pub history: Mutex<History>,
    /// Cancelled to close the port.
    pub closing: CancellationToken,
    /// Why the connection was lost; unset if the line was closed on request.
    pub lost: OnceLock<String>,
}

/// Which replies end an exchange.
#[derive(Debug, Clone)]
pub(super) enum ExpectedReplies {
    /// One reply, from the device and axis addressed.
    One,
    /// One reply from each of these devices.
    Each(Vec<u8>),
    /// All replies that arrive within the time-out.
    Anyone,
}

pub(super) struct LineRequest {
    pub command: DeviceCommand,
    pub expected: ExpectedReplies,
    pub wait: Duration,
    /// Time after which it is sent again, until its replies are complete; `None` for once.
    pub again_after: Option<Duration>,
    /// Number of stops when this was requested; `None` if a stop does not cancel it.
    pub stops: Option<u64>,
    pub answer: oneshot::Sender<Result<Vec<Reply>, ExchangeFailure>>,
}

pub(super) enum ExchangeFailure {
    Silence(Vec<Reply>),
    Final(LineError),
}

impl LineState {
    pub fn history(&self) -> MutexGuard<'_, History> {
        self.history.lock().expect("no holder of this lock panics")
    }

    /// The error of a command on a closed line.
    pub fn gone(&self) -> LineError {
        let reason = self.lost.get().map(String::as_str);
        LineError::Disconnected {
            port: self.port.clone(),
            reason: reason.unwrap_or("it was closed").to_owned(),
        }
    }

    /// Counts a line that answers no open command, and logs it at debug level.
    pub fn put_aside(&self, line: &[u8]) {
        let counters = &self.counters;
        match decode_message(line).map(|message| message.body) {
            Err(_) => add(&counters.garbled, "garbled"),
            Ok(MessageBody::Alert(_)) => add(&counters.alerts, "alert"),
            Ok(MessageBody::Info(_)) => {}
            Ok(MessageBody::Reply(reply)) => {
                add(&counters.strays, "stray");
                match self.history().explain(&reply) {
                    Stray::Late => {}
                    Stray::SecondAnswer => {
                        let address = &counters.second_answer_address;
                        address.store(reply.address, Ordering::Relaxed);
                        add(&counters.second_answers, "second answer");
                    }
                    Stray::Foreign => add(&counters.foreign, "foreign"),
                }
            }
        }
        debug!(port = %self.port, "answers no command: {}", line.escape_ascii());
    }
}

/// Increments a counter of this line and the program's metric.
pub(super) fn add(counter: &AtomicU64, what: &'static str) {
    counter.fetch_add(1, Ordering::Relaxed);
    metrics::counter!("ridged_stage_line_total", "what" => what).increment(1);
}
