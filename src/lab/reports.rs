//! Reports: a fit, its scan and everything that it rests on, collected from the store.

pub mod accuracy_results;
pub(super) mod charts;
pub(super) mod comparisons;

use serde_json::Value;
use time::OffsetDateTime;

use super::jobs::chosen_fit::{ReportChoice, chosen};
use super::jobs::curves::{FitCurves, curves_of};
use super::rig::pinned_stages::identity_of;
use super::scans::incidents::incidents;
use super::series::plan_of_rows;
use super::tasks::blocking;
use super::{AxisName, Lab, LabError, StoredSeries};
use crate::analysis::Analysis;
use crate::frame::FrameTag;
use crate::job::{JobId, JobKind, JobState};
use crate::observation::ObservationSet;
use crate::reduction::FrameSource;
use crate::repeatability::{Repeatability, StudyChoice};
use crate::report::{
    Earlier, FORM, FrameHash, FrameHashes, MeasuredPart, MeasuredScan, MeasurementReport,
    MeasuringRig, ReportedCurve, ReportedFit, ReportedObservation, ReportedVerdict,
    StageController, UsedCalibration, UsedDefinition,
};
use crate::series::{FrameReadError, Series};
use crate::store::definitions::DefinitionRef;
use crate::store::jobs::JobFilter;
use crate::store::scans::{Origin, Scan, ScanFilter};
use crate::store::{PageRequest, Store, StoreError, sha256_hex, utc_of};
use crate::version::BUILD;
use comparisons::{SCANS_MAX, repeatability};

/// Distance of the points of a curve, degrees.
const CURVE_STEP_DEG: f64 = 3.0;
/// Fewest results of which a report shows the scatter.
const REPEATS_MIN: usize = 3;
/// Rows read at a time.
const ROWS: PageRequest = PageRequest {
    cursor: None,
    limit: 1000,
};

impl Lab {
    /// Returns the report on a scan.
    ///
    /// # Errors
    /// As [`report`].
    pub async fn report(
        &self,
        scan_id: i64,
        choice: &ReportChoice,
    ) -> Result<MeasurementReport, LabError> {
        report(self.store(), scan_id, choice).await
    }
}

/// Returns the report on a scan of a store.
///
/// # Errors
/// An unknown scan or fit, [`LabError::NoReport`] without a completed fit, or a store error.
pub async fn report(
    store: &Store,
    scan_id: i64,
    choice: &ReportChoice,
) -> Result<MeasurementReport, LabError> {
    let scan = store.scan(scan_id).await?;
    let (job, result, set_id) = chosen(store, &scan, choice).await?;
    let set = store.observations(set_id).await?;
    let series = StoredSeries::open(store, scan_id).await?;
    let manifest = series.manifest().clone();
    if set.material != manifest.material() {
        return Err(LabError::NoReport {
            scan_id,
            why: format!(
                "fit {} used the material of a part that the scan was assigned to before; fit the scan again",
                job.number
            ),
        });
    }
    let sample = store.sample(scan.sample_id).await?;
    let earlier_names = sample.earlier_names.into_iter().map(|earlier| Earlier {
        name: earlier.name,
        until: earlier.until,
    });
    let part = MeasuredPart {
        sample_id: Some(sample.id),
        name: sample.name,
        note: sample.note,
        material: set.material,
        earlier_names: earlier_names.collect(),
    };
    let plan = match &scan.plan {
        Some(plan) => plan.clone(),
        None => plan_of_rows(series.rows()),
    };
    let rig = rig(store, &scan, &series).await?;
    let verdict = verdict(store, scan_id, result.region.as_deref()).await?;
    let job_id = JobId::new(JobKind::Fit, job.number);
    let fit = ReportedFit {
        id: Some(job.number),
        request: json_of(&job.request)?,
        who: Some(job.who),
        computed_by: store.program_of_job(job_id).await?,
        created_at: Some(job.created_at),
        ended_at: job.ended_at,
        result,
    };
    let frames = series.hashes().map(|(row, sha256)| FrameHash {
        file: row.file.clone(),
        kind: row.kind,
        sha256: sha256.to_owned(),
    });
    let drawn = (fit.result.clone(), set.clone());
    let curves = blocking(move || curves_of(&drawn.0, &drawn.1, CURVE_STEP_DEG)).await?;
    let repeatability = repeats(store, &scan, fit.result.region.as_deref()).await?;
    Ok(MeasurementReport {
        form: FORM,
        program: BUILD.to_owned(),
        part,
        plan,
        rig,
        white_reference: manifest.flat,
        calibrations: calibrations(store, &scan).await?,
        fit,
        absolute: set.white_reference.is_some(),
        observations: observations(&set),
        verdict,
        repeatability,
        incidents: incidents(store, scan_id).await?,
        frames: FrameHashes::of(frames.collect()),
        curves: drawn_curves(curves),
        scan: Some(measured(store, scan).await?),
    })
}

/// Returns the report on a series that is not in the store.
///
/// # Errors
/// A frame that cannot be read.
pub fn report_on_series(
    series: &Series,
    analysis: &Analysis,
    request: Value,
) -> Result<MeasurementReport, FrameReadError> {
    let manifest = series.manifest();
    let set = &analysis.observations;
    let frames = series.rows().iter().enumerate().map(|(index, row)| {
        Ok(FrameHash {
            file: row.file.clone(),
            kind: row.kind,
            sha256: sha256_hex(&series.read_bytes(index)?),
        })
    });
    let frames = frames.collect::<Result<Vec<_>, FrameReadError>>()?;
    let name = match manifest.name.as_str() {
        "" => series.folder().display().to_string(),
        name => name.to_owned(),
    };
    Ok(MeasurementReport {
        form: FORM,
        program: BUILD.to_owned(),
        part: MeasuredPart {
            sample_id: None,
            name,
            note: None,
            material: set.material,
            earlier_names: Vec::new(),
        },
        scan: None,
        plan: plan_of_rows(series.rows()),
        rig: MeasuringRig {
            simulated: false,
            geometry: manifest.rig.clone(),
            camera: manifest.camera.clone(),
            stages: Vec::new(),
            camera_serial: None,
            sensor_temperature_c: None,
        },
        white_reference: manifest.flat.clone(),
        calibrations: Vec::new(),
        fit: ReportedFit {
            id: None,
            request,
            who: None,
            computed_by: BUILD.to_owned(),
            created_at: None,
            ended_at: None,
            result: analysis.report.clone(),
        },
        absolute: set.white_reference.is_some(),
        observations: observations(set),
        verdict: None,
        repeatability: None,
        incidents: Vec::new(),
        frames: FrameHashes::of(frames),
        curves: drawn_curves(curves_of(&analysis.report, set, CURVE_STEP_DEG)),
    })
}

async fn measured(store: &Store, scan: Scan) -> Result<MeasuredScan, LabError> {
    let earlier_samples = scan.earlier_samples.iter().map(|earlier| Earlier {
        name: earlier.sample_name.clone(),
        until: earlier.until.clone(),
    });
    Ok(MeasuredScan {
        id: scan.id,
        origin: scan.origin.as_str(),
        state: scan.state,
        program: store.program_of_scan(scan.id).await?,
        frames_rejected: store.frames_rejected(scan.id).await?,
        earlier_samples: earlier_samples.collect(),
        ended_at: scan.ended_at().map(str::to_owned),
        started_at: match scan.origin {
            Origin::Rig => scan.started_at,
            Origin::Import => None,
        },
        reason: scan.reason,
        recipe: scan.recipe.map(used),
        specification: scan.specification.map(used),
        lot: scan.lot,
        external_id: scan.external_id,
        order_id: scan.order_id,
        operator_name: scan.operator_name,
        who: scan.who,
        created_at: scan.created_at,
    })
}

fn used(definition: DefinitionRef) -> UsedDefinition {
    UsedDefinition {
        id: definition.id,
        name: definition.name,
        version: definition.version,
    }
}

async fn rig(store: &Store, scan: &Scan, series: &StoredSeries) -> Result<MeasuringRig, LabError> {
    let manifest = series.manifest();
    let mut simulated = false;
    if let Some(rig_id) = scan.rig_id {
        let settings = json_of(&store.rig_settings(rig_id).await?)?;
        // A real rig has no label.
        simulated = settings["label"].as_str().is_some_and(|l| !l.is_empty());
    }
    let mut stages = Vec::new();
    for row in store.stages_of_scan(scan.id).await? {
        let identity = identity_of(&row)?;
        for axis in AxisName::ALL {
            let device = identity.axis(axis);
            stages.push(StageController {
                axis: axis.to_string(),
                serial: device.serial,
                device_id: device.device_id,
                firmware: device.firmware.clone(),
            });
        }
    }
    let tags = store.tags_of_scan(scan.id, 0, i64::MAX).await?;
    let of = |value: fn(&FrameTag) -> Option<f64>| tags.values().filter_map(value);
    let temperatures = of(|tag| tag.temperature_c);
    let ends = temperatures.fold(None, |ends: Option<[f64; 2]>, value| {
        let [low, high] = ends.unwrap_or([value, value]);
        Some([low.min(value), high.max(value)])
    });
    Ok(MeasuringRig {
        simulated,
        geometry: manifest.rig.clone(),
        camera: manifest.camera.clone(),
        stages,
        camera_serial: tags.values().find_map(|tag| tag.serial.clone()),
        sensor_temperature_c: ends,
    })
}

async fn calibrations(store: &Store, scan: &Scan) -> Result<Vec<UsedCalibration>, LabError> {
    let started = scan.started_at.as_deref().and_then(utc_of);
    let mut used = Vec::new();
    for id in store.calibrations_of_scan(scan.id).await? {
        let kept = store.calibration(id).await?;
        // Those that the scan itself took are younger than its start.
        let hours =
            |from: OffsetDateTime| Some(((started? - from).as_seconds_f64() / 3600.0).max(0.0));
        used.push(UsedCalibration {
            id,
            kind: kept.kind,
            scan_id: kept.scan_id,
            exposures_s: kept.exposures_s,
            theta_c_deg: kept.theta_c_deg,
            n_frames: kept.n_frames,
            age_h: utc_of(&kept.created_at).and_then(hours),
            created_at: kept.created_at,
        });
    }
    Ok(used)
}

/// Returns the newest completed verdict on a region of a scan.
async fn verdict(
    store: &Store,
    scan_id: i64,
    region: Option<&str>,
) -> Result<Option<ReportedVerdict>, LabError> {
    let filter = JobFilter {
        scan_id: Some(scan_id),
        state: Some(JobState::Completed),
        ..JobFilter::default()
    };
    for job in store.jobs(JobKind::Verdict, &filter, ROWS).await?.items {
        let Some(result) = &job.result else { continue };
        let result: crate::judge::VerdictReport =
            serde_json::from_str(result).map_err(|e| StoreError::bad_row("job_ends", e))?;
        if result.region.as_deref() == region {
            return Ok(Some(ReportedVerdict {
                id: job.number,
                request: json_of(&job.request)?,
                who: job.who,
                created_at: job.created_at,
                ended_at: job.ended_at,
                result,
            }));
        }
    }
    Ok(None)
}

/// Returns the scatter of the scans of this part by this version of the recipe, up to this scan; none below
/// [`REPEATS_MIN`] results. Later scans do not count, so that the report stays the same.
async fn repeats(
    store: &Store,
    scan: &Scan,
    region: Option<&str>,
) -> Result<Option<Repeatability>, LabError> {
    if scan.recipe.is_none() {
        return Ok(None);
    }
    let filter = ScanFilter {
        sample_id: Some(scan.sample_id),
        archived: Some(false),
        ..ScanFilter::default()
    };
    let up_to = PageRequest {
        cursor: Some(scan.id),
        ..ROWS
    };
    let earlier = store.scans(filter, up_to).await?.items.into_iter();
    let earlier = earlier.filter(|other| other.recipe == scan.recipe);
    let mut ids = vec![scan.id];
    ids.extend(earlier.map(|other| other.id).take(SCANS_MAX - 1));
    if ids.len() < REPEATS_MIN {
        return Ok(None);
    }
    let study = repeatability(store, &ids, region, &StudyChoice::default()).await;
    match study {
        Ok(study) => Ok(Some(study).filter(|study| study.results.len() >= REPEATS_MIN)),
        // Fits of several regions: there is no one result per scan.
        Err(LabError::Invalid { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

fn observations(set: &ObservationSet) -> Vec<ReportedObservation> {
    let all = set.observations.iter();
    all.map(|o| ReportedObservation {
        theta_c_deg: o.pose.theta_c.deg_for_tables(),
        phi_s_deg: o.pose.phi_s.deg_for_tables(),
        signal: o.signal,
        sigma: o.sigma,
        n_frames: o.n_frames,
    })
    .collect()
}

fn drawn_curves(curves: FitCurves) -> Vec<ReportedCurve> {
    let all = curves.curves.into_iter();
    all.map(|curve| ReportedCurve {
        theta_c_deg: curve.theta_c_deg,
        points: curve.phi_s_deg.into_iter().zip(curve.signal).collect(),
    })
    .collect()
}

fn json_of(text: &str) -> Result<Value, StoreError> {
    serde_json::from_str(text).map_err(|e| StoreError::bad_row("jobs", e))
}
