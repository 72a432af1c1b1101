//! Ctrl-C as a flag that long work checks. SIGTERM (sent by batch queues and service managers) and SIGHUP have the same
//! effect.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::CliError;

/// Returns a flag that Ctrl-C, SIGTERM or SIGHUP raises. A second signal ends the program at once.
///
/// # Errors
/// No result where the system refuses a thread or a signal handler.
pub fn flag() -> Result<Arc<AtomicBool>, CliError> {
    let flag = Arc::new(AtomicBool::new(false));
    let raised = Arc::clone(&flag);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(CliError::no_result)?;
    std::thread::Builder::new()
        .name("ctrl-c".to_owned())
        .spawn(move || {
            runtime.block_on(async {
                while asked_to_stop().await.is_ok() {
                    if raised.swap(true, Ordering::Relaxed) {
                        std::process::exit(130);
                    }
                }
            });
        })
        .map_err(CliError::no_result)?;
    Ok(flag)
}

/// Completes on Ctrl-C, SIGTERM or SIGHUP.
///
/// # Errors
/// Where the system refuses a signal handler.
pub async fn asked_to_stop() -> std::io::Result<()> {
    signals()?.await;
    Ok(())
}

/// Listens from now on; completes on the first of Ctrl-C, SIGTERM and SIGHUP (sent when a terminal is closed). A process
/// under `nohup` keeps ignoring SIGHUP.
///
/// # Errors
/// Where the system refuses a signal handler.
pub fn signals() -> std::io::Result<impl Future<Output = ()> + Send> {
    use tokio::signal::unix::{Signal, SignalKind, signal};
    /// Known on Linux only; elsewhere no signal counts as ignored.
    const PROCESS_STATUS: &str = "/proc/self/status";
    let status = std::fs::read_to_string(PROCESS_STATUS).unwrap_or_default();
    let hangup = SignalKind::hangup();
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut hangup: Option<Signal> = match ignores(&status, hangup.as_raw_value()) {
        true => None,
        false => Some(signal(hangup)?),
    };
    Ok(async move {
        let hung_up = async {
            match &mut hangup {
                Some(hangup) => hangup.recv().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hung_up => {}
        }
    })
}

/// Whether a process with this `/proc/self/status` ignores a signal.
fn ignores(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|l| l.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ignored_signal_is_recognised() {
        let status =
            "Name:\tridged\nSigBlk:\t0000000000000001\nSigIgn:\t0000000000001001\nSigCgt:\t0\n";
        assert!(ignores(status, 1));
        assert!(ignores(status, 13));
        assert!(!ignores(status, 15));
        assert!(!ignores("SigIgn:\t0000000000001000\n", 1));
        assert!(!ignores("", 1));
    }
}
