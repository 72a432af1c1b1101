//! What all commands that run a lab share: settings, runtime, signals and exit codes.

use std::path::Path;
use std::sync::Arc;

use super::CliError;
use super::interrupt::asked_to_stop;
use crate::clock::{Clock, SystemClock};
use crate::config::{Config, ConfigError};
use crate::lab::{LabError, StoredSeries};
use crate::store::disk::RealDisk;
use crate::store::{Store, StoreError};

/// Reads the settings of `--config` and of the environment.
///
/// # Errors
/// Bad input, naming file, line and key.
pub fn read_config(file: Option<&Path>) -> Result<Config, CliError> {
    let environment = std::env::vars_os()
        .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
    Config::read(file, environment).map_err(|error: ConfigError| CliError::bad_input(error))
}

/// The clock of a real rig.
#[must_use]
pub fn real_clock() -> Arc<dyn Clock> {
    Arc::new(SystemClock::new())
}

/// Maps an error of the lab to an exit code: bad input 2, everything else 1.
pub fn lab_error(error: LabError) -> CliError {
    match &error {
        LabError::Plan(_)
        | LabError::Invalid { .. }
        | LabError::Series(_)
        | LabError::Frame { .. }
        | LabError::Export(_)
        | LabError::NoRig
        | LabError::Store(
            StoreError::NotFound { .. }
            | StoreError::NoVersion { .. }
            | StoreError::NameTaken { .. }
            | StoreError::PartNameTaken { .. }
            | StoreError::Missing { .. }
            | StoreError::FolderName { .. },
        ) => CliError::bad_input(error),
        LabError::BrokenOff => CliError::Interrupted,
        _ => CliError::no_result(error),
    }
}

/// Completes on Ctrl-C, SIGTERM or SIGHUP.
///
/// # Errors
/// No result if the system refuses a signal handler.
pub async fn stop_requested() -> Result<(), CliError> {
    asked_to_stop().await.map_err(CliError::no_result)
}

/// Opens a stored scan as a series to reduce, also beside a running daemon.
///
/// # Errors
/// Bad input for a folder without a store or an unknown scan.
pub fn stored_series(folder: &Path, scan_id: i64) -> Result<StoredSeries, CliError> {
    block_on(stored_series_of(folder, scan_id))
}

/// The same within a runtime.
///
/// # Errors
/// As [`stored_series`].
pub async fn stored_series_of(folder: &Path, scan_id: i64) -> Result<StoredSeries, CliError> {
    let store = Store::open_for_reading(folder, Arc::new(RealDisk), real_clock())
        .await
        .map_err(|error| lab_error(error.into()))?;
    let series = StoredSeries::open(&store, scan_id).await.map_err(lab_error);
    // Frames are read from files; the database is no longer needed.
    store.close().await;
    series
}

/// Runs a command's future on a runtime of its own.
///
/// # Errors
/// What the command returns, or no result if the system gives no threads.
pub fn block_on<T>(work: impl Future<Output = Result<T, CliError>>) -> Result<T, CliError> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(CliError::no_result)?
        .block_on(work)
}
