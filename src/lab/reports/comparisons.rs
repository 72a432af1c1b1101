//! Comparisons of two scans, and the repeatability of several: their results and circumstances, read from the store.

use crate::comparison::shared::{Circumstances, SharedChoice, WhiteReferenceOf};
use crate::comparison::{self, Comparison, MeasuredResult, ResultOf};
use crate::fit::report::Parameters;
use crate::frame::FrameKind;
use crate::lab::exchange::exports::measured_between;
use crate::lab::jobs::chosen_fit::{ReportChoice, chosen};
use crate::lab::request_checks::invalid;
use crate::lab::series::plan_of_rows;
use crate::lab::{LabError, StoredSeries};
use crate::reduction::FrameSource as _;
use crate::repeatability::{LeftOutScan, Repeatability, StudyChoice, study};
use crate::series::Manifest;
use crate::store::Store;
use crate::store::scans::Scan;

/// Most scans of a study.
pub const SCANS_MAX: usize = 200;

/// Compares the newest fits of two scans of a store.
///
/// # Errors
/// [`LabError::Invalid`] for another number of scans, one scan twice, or fits of different regions;
/// [`LabError::NoReport`] for a scan without a completed fit; an unknown scan, or a store error.
pub async fn compare(
    store: &Store,
    scan_ids: &[i64],
    region: Option<&str>,
    shared: &SharedChoice,
) -> Result<Comparison, LabError> {
    let &[first, second] = scan_ids else {
        let problem = format!("expected two scans, got {}", scan_ids.len());
        return Err(invalid("scan_id", problem));
    };
    each_once(scan_ids)?;
    let first = measured(store, first, region).await?;
    let second = measured(store, second, region).await?;
    of_one_region(&[&first, &second])?;
    Ok(comparison::compare(&first, &second, shared))
}

/// Evaluates the scatter of scans of a store, and their gauge R&R. A scan without a completed fit is listed as left out.
///
/// # Errors
/// [`LabError::Invalid`] for fewer than two scans or too many, one scan twice, an unknown parameter, or fits of different
/// regions; an unknown scan, or a store error.
pub async fn repeatability(
    store: &Store,
    scan_ids: &[i64],
    region: Option<&str>,
    choice: &StudyChoice,
) -> Result<Repeatability, LabError> {
    if !(2..=SCANS_MAX).contains(&scan_ids.len()) {
        let problem = format!("expected 2 to {SCANS_MAX} scans, got {}", scan_ids.len());
        return Err(invalid("scan_id", problem));
    }
    each_once(scan_ids)?;
    is_parameter(&choice.parameter)?;
    let (mut found, mut left_out) = (Vec::new(), Vec::new());
    for &scan_id in scan_ids {
        match measured(store, scan_id, region).await {
            Ok(result) => found.push(result),
            Err(LabError::NoReport { scan_id, why }) => left_out.push(LeftOutScan { scan_id, why }),
            Err(error) => return Err(error),
        }
    }
    of_one_region(&found.iter().collect::<Vec<_>>())?;
    Ok(study(found, left_out, choice))
}

fn each_once(scan_ids: &[i64]) -> Result<(), LabError> {
    let twice = scan_ids
        .iter()
        .enumerate()
        .find(|(at, id)| scan_ids[..*at].contains(id));
    match twice {
        Some((_, id)) => Err(invalid("scan_id", format!("scan {id} is given twice"))),
        None => Ok(()),
    }
}

/// Refuses a key that is not that of a fit's parameter.
pub(in crate::lab) fn is_parameter(name: &str) -> Result<(), LabError> {
    if Parameters::NAMES.contains(&name) {
        return Ok(());
    }
    let short: String = name.chars().take(40).collect();
    let known = Parameters::NAMES.join(", ");
    let problem = format!("there is no parameter {short:?}; expected one of {known}");
    Err(invalid("parameter", problem))
}

fn of_one_region(results: &[&MeasuredResult]) -> Result<(), LabError> {
    let name = |result: &MeasuredResult| result.of.region.clone().unwrap_or("none".to_owned());
    let other = results
        .windows(2)
        .find(|pair| pair[0].of.region != pair[1].of.region);
    match other {
        None => Ok(()),
        Some(pair) => Err(invalid(
            "region",
            format!(
                "the newest fit of scan {} is of region {}, that of scan {} of region {}; state one region",
                pair[0].of.scan_id,
                name(pair[0]),
                pair[1].of.scan_id,
                name(pair[1])
            ),
        )),
    }
}

/// Returns the result of the newest completed fit of a scan, with its circumstances.
async fn measured(
    store: &Store,
    scan_id: i64,
    region: Option<&str>,
) -> Result<MeasuredResult, LabError> {
    let scan = store.scan(scan_id).await?;
    let choice = ReportChoice {
        fit_id: None,
        region: region.map(str::to_owned),
    };
    let (job, report, _) = chosen(store, &scan, &choice).await?;
    let (plan, measured_at) = match scan.plan.clone() {
        Some(plan) => (plan, measured_between(&scan, &[]).0),
        None => {
            let series = StoredSeries::open(store, scan_id).await?;
            let rows = series.rows();
            (plan_of_rows(rows), measured_between(&scan, rows).0)
        }
    };
    Ok(MeasuredResult {
        freedom: report.freedom,
        circumstances: Circumstances {
            sample_id: scan.sample_id,
            variant: report.variant,
            rig_id: scan.rig_id,
            poses_deg: plan.sample_poses_deg(),
            exposures_s: plan.exposures_s,
            white_reference: white_reference(store, &scan).await?,
        },
        of: ResultOf {
            scan_id,
            fit_id: job.number,
            sample_id: scan.sample_id,
            part: scan.sample_name,
            region: report.region,
            variant: report.variant,
            operator_name: scan.operator_name,
            measured_at,
        },
        parameters: report.parameters,
    })
}

async fn white_reference(store: &Store, scan: &Scan) -> Result<Option<WhiteReferenceOf>, LabError> {
    let text = store.manifest(scan.id).await?;
    let manifest = Manifest::from_toml(&text, "manifest.toml")?;
    let Some(flat) = manifest.flat else {
        return Ok(None);
    };
    let mut calibration_ids = Vec::new();
    for id in store.calibrations_of_scan(scan.id).await? {
        if store.calibration(id).await?.kind == FrameKind::Flat {
            calibration_ids.push(id);
        }
    }
    Ok(Some(WhiteReferenceOf {
        certificate: flat.certificate().map(str::to_owned),
        reflectance: flat.reflectance,
        reflectance_std: flat.reflectance_std,
        calibration_ids,
        frames_sha256: store.flats_of_scan(scan.id).await?,
    }))
}
