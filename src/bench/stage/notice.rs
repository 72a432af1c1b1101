//! What a person should learn of the stages although no request failed.

use tokio::sync::broadcast;

use crate::bench::port::PortAddress;

/// Notices that wait for a slow reader; older ones are dropped.
const NOTICES_MAX: usize = 64;

/// An observation about the stages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StageNotice {
    /// Stable word.
    pub code: &'static str,
    /// What happened and what to do.
    pub message: String,
}

/// Sends notices to all subscribers; without a subscriber they are only logged.
#[derive(Debug, Clone)]
pub struct Notices {
    sender: broadcast::Sender<StageNotice>,
}

impl Default for Notices {
    fn default() -> Self {
        Notices {
            sender: broadcast::Sender::new(NOTICES_MAX),
        }
    }
}

impl Notices {
    /// Receives all notices from now on.
    #[must_use]
    pub fn subscribe(&self) -> broadcast::Receiver<StageNotice> {
        self.sender.subscribe()
    }

    /// Reports that the controllers answer on another port than the named one.
    pub fn port_changed(&self, named: &PortAddress, found: &PortAddress) {
        let message = format!(
            "the stages of this rig answer on {found}, not on {named}, and are used there: set `port` to a name below \
             /dev/serial/by-id, which does not change when they are plugged in again"
        );
        self.send("stage-port-changed", message);
    }

    pub(super) fn send(&self, code: &'static str, message: String) {
        tracing::warn!(code, "{message}");
        // Fails without a subscriber.
        self.sender.send(StageNotice { code, message }).ok();
    }
}
