//! Messages to the service manager (systemd): ready, alive, stopping. Without one they have no effect.

use std::time::Duration;

use sd_notify::{NotifyState, notify};

use crate::lab::Lab;

/// Reports that the daemon accepts requests.
pub fn ready() {
    send(NotifyState::Ready);
}

/// Reports that the daemon is ending.
pub fn stopping() {
    send(NotifyState::Stopping);
}

/// Reports three times per watchdog interval that the daemon works, if the service manager expects it. The reports end when
/// the task that owns the rig has ended, so that the service manager starts the daemon again.
pub fn report_life(lab: &Lab) {
    let Some(interval) = sd_notify::watchdog_enabled().filter(|i| *i > Duration::ZERO) else {
        return;
    };
    let lab = lab.clone();
    tokio::spawn(async move {
        while lab.rig_has_an_owner() {
            send(NotifyState::Watchdog);
            tokio::time::sleep(interval / 3).await;
        }
        tracing::error!(
            "the task that owns the rig has ended; the watchdog of the service manager is no longer fed"
        );
    });
}

fn send(state: NotifyState<'_>) {
    if let Err(error) = notify(&[state]) {
        tracing::warn!(%error, "the service manager could not be notified: {error}");
    }
}
