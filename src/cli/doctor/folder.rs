//! The data folder: space and speed of its disk, the database, and the frames against hashes and rows.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use time::OffsetDateTime;

use super::findings::Findings;
use crate::bench::stage::StageIdentity;
use crate::cli::due;
use crate::cli::progress::Bar;
use crate::cli::runtime::real_clock;
use crate::clock::{Clock as _, SystemClock};
use crate::config::DueSection;
use crate::lab;
use crate::store::disk::{Disk, RealDisk};
use crate::store::{Store, StoreError};

/// Frames written to measure the disk.
const TRIAL_FRAMES: u32 = 4;
/// Largest file written to measure it.
const TRIAL_BYTES_MAX: u64 = 64_000_000;
/// A disk that takes longer for a frame slows a scan.
const SLOW_S: f64 = 0.5;
/// Fewer frames than this leave little for a night.
const FRAMES_FEW: u64 = 1000;
/// Damaged frames that are named one by one.
const NAMED_MAX: usize = 10;

/// Checks space and speed of the disk. `reserve_bytes` stay free in a scan; `frame_bytes` is the size of a frame's file.
pub fn check_disk(folder: &Path, reserve_bytes: u64, frame_bytes: u64, findings: &mut Findings) {
    if !folder.is_dir() {
        findings.note(
            "folder",
            format!(
                "{} does not exist; `ridged serve` creates it",
                folder.display()
            ),
        );
        return;
    }
    match RealDisk.free_bytes(folder) {
        Err(error) => findings.error("disk", &StoreError::file("the data folder", folder, error)),
        Ok(free) => {
            let frames = free.saturating_sub(reserve_bytes) / frame_bytes.max(1);
            let (free_mb, reserve_mb) = (free / 1_000_000, reserve_bytes / 1_000_000);
            let found =
                format!("{free_mb} MB free, {reserve_mb} MB of reserve: room for {frames} frames");
            match frames {
                0 => findings.fault("disk", found, "free some space: a scan would pause at once"),
                1..FRAMES_FEW => findings.warning(
                    "disk",
                    found,
                    "free some space, or plan fewer frames than that",
                ),
                _ => findings.ok("disk", found),
            }
        }
    }
    match write_trial(folder, frame_bytes) {
        Ok(longest_s) => {
            let bytes = frame_bytes.min(TRIAL_BYTES_MAX) as f64;
            let size = match bytes < 1e5 {
                true => format!("{:.1} kB", bytes / 1e3),
                false => format!("{:.1} MB", bytes / 1e6),
            };
            let found = format!(
                "a frame of {size} is durable after {:.0} ms at most",
                1e3 * longest_s
            );
            match longest_s > SLOW_S {
                true => findings.warning(
                    "disk",
                    found,
                    "a slow disk slows the scan; move the data folder to a faster one (--data)",
                ),
                false => findings.ok("disk", found),
            }
        }
        Err(error) => findings.error("disk", &StoreError::file("the data folder", folder, error)),
    }
}

/// Writes frames as a scan does, removes them, and returns the longest time of one in seconds.
fn write_trial(folder: &Path, frame_bytes: u64) -> std::io::Result<f64> {
    let trial = folder.join(format!(".doctor-{}", std::process::id()));
    // Not zeros, which some file systems do not store.
    let bytes = frame_bytes.min(TRIAL_BYTES_MAX);
    let content: Vec<u8> = (0..bytes)
        .map(|i| (i.wrapping_mul(2_654_435_761) >> 7) as u8)
        .collect();
    let written = (0..TRIAL_FRAMES).try_fold(0.0_f64, |longest_s, i| {
        let started = Instant::now();
        RealDisk.write_durably(&trial.join(format!("{i}.png")), &content)?;
        Ok(longest_s.max(started.elapsed().as_secs_f64()))
    });
    std::fs::remove_dir_all(&trial).ok();
    written
}

/// What the store knows that other checks compare with.
#[derive(Default)]
pub struct Known {
    /// Time of the newest event.
    pub newest_event: Option<OffsetDateTime>,
    /// Controllers of the last rig.
    pub stages: Option<StageIdentity>,
}

/// Checks database and frames, and what the settings ask to measure again; with `deep` every frame file is read.
pub async fn check_store(
    folder: &Path,
    deep: bool,
    due: &DueSection,
    findings: &mut Findings,
) -> Known {
    if !folder.is_dir() {
        return Known::default();
    }
    let store = match Store::open_for_reading(folder, Arc::new(RealDisk), real_clock()).await {
        Ok(store) => store,
        Err(StoreError::Missing { .. }) => {
            findings.note("database", "there is none yet; `ridged serve` creates it");
            return Known::default();
        }
        Err(error) => {
            findings.error("database", &error);
            return Known::default();
        }
    };
    let known = check_opened(&store, deep, findings).await;
    if known.is_ok() {
        check_due(&store, due, findings).await;
    }
    store.close().await;
    known.unwrap_or_else(|error| {
        findings.error("database", &error);
        Known::default()
    })
}

/// Checks when check standard and references were last measured.
async fn check_due(store: &Store, settings: &DueSection, findings: &mut Findings) {
    match lab::due(store, settings, SystemClock::new().utc()).await {
        Err(error) => findings.error("due", &error),
        Ok(all) => {
            for item in &all {
                match item.is_due {
                    true => findings.warning("due", due::words(item), &due::advice(item)),
                    false => findings.ok("due", due::words(item)),
                }
            }
        }
    }
}

async fn check_opened(
    store: &Store,
    deep: bool,
    findings: &mut Findings,
) -> Result<Known, StoreError> {
    let damage = store.check_database().await?;
    match damage.first() {
        None => findings.ok("database", "its integrity check finds nothing"),
        Some(first) => {
            findings.fault(
                "database",
                format!(
                    "its integrity check finds {} problems, first {first}",
                    damage.len()
                ),
                "keep the folder as it is and restore a copy of it",
            );
            return Ok(Known::default());
        }
    }
    let bar = Bar::new("frames");
    let audit = store.audit(deep, |done, of| bar.at(done, of)).await?;
    drop(bar);
    let how = match deep {
        true => format!("hashes of {:.0} MB and rows", audit.bytes_read as f64 / 1e6),
        false => "sizes and rows; --deep compares the hashes too".to_owned(),
    };
    let damaged = audit.discrepancies.len();
    match damaged {
        0 => findings.ok(
            "frames",
            format!("{} frames are as their rows state ({how})", audit.frames),
        ),
        _ => {
            for discrepancy in audit.discrepancies.iter().take(NAMED_MAX) {
                findings.fault(
                    "frames",
                    format!("scan {}: {}", discrepancy.scan_id, discrepancy.problem),
                    "restore it from a copy of the data folder; fits and exports leave it out or refuse it",
                );
            }
            if damaged > NAMED_MAX {
                let rest = damaged - NAMED_MAX;
                findings.fault(
                    "frames",
                    format!("{rest} more"),
                    "restore a copy of the data folder",
                );
            }
        }
    }
    let last = store.last_event_id().await?;
    let newest = store.events_after(last - 1, 1).await?;
    // A folder of an older program has no controllers.
    let stages = store.newest_stages().await.ok().flatten();
    Ok(Known {
        newest_event: newest.first().map(|event| event.at),
        stages: stages.and_then(|row| serde_json::from_str(&row.identity).ok()),
    })
}
