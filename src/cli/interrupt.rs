//! Ctrl-C as a flag that long work looks at; SIGTERM, which batch queues and service managers send, is the same.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::CliError;

/// A flag that Ctrl-C or SIGTERM raises. A second one ends the program at once.
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

/// Completes on Ctrl-C or SIGTERM.
///
/// # Errors
/// Where the system refuses a signal handler.
pub async fn asked_to_stop() -> std::io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    tokio::select! {
        ended = tokio::signal::ctrl_c() => ended,
        _ = terminate.recv() => Ok(()),
    }
}
