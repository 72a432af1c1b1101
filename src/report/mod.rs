//! The report of a measurement: what a quality folder keeps of a scan, as JSON with all digits and as a page to print.
//!
//! [`MeasurementReport`] is the content; everything in it comes from the store or from the files of a series.
//! [`MeasurementReport::sealed`] returns it as JSON with a SHA-256 over its canonical form, which [`check`] compares, and
//! [`MeasurementReport::html`] as one HTML file without scripts and without other files. The form has no time of printing,
//! so the same measurement always gives the same JSON.

mod canonical;
mod html;
mod markup;
mod plots;
mod repeats;
mod sections;

use serde::Serialize;
use serde_json::Value;
use sha2::{Digest, Sha256};

pub use canonical::{Check, canonical, check};

use crate::fit::FitReport;
use crate::frame::FrameKind;
use crate::judge::VerdictReport;
use crate::material::Material;
use crate::repeatability::Repeatability;
use crate::scan::{Incident, Plan, ScanState};
use crate::series::{CameraFacts, FlatFacts, RigFacts};
use crate::wording::hex;

/// Name of the JSON form.
pub const FORM: &str = "ridged-report-1";

/// Everything that a report states.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct MeasurementReport {
    /// [`FORM`].
    #[schema(value_type = String)]
    pub form: &'static str,
    /// Program that made the report, with its commit.
    pub program: String,
    /// What was measured.
    pub part: MeasuredPart,
    /// The scan; none for a folder that is not in the store.
    pub scan: Option<MeasuredScan>,
    /// Poses, exposures and repeats.
    pub plan: Plan,
    /// Lamp, camera and stages.
    pub rig: MeasuringRig,
    /// The white reference.
    pub white_reference: Option<FlatFacts>,
    /// Dark and white-reference frames of the store that the scan used; empty for a series, which has its own.
    pub calibrations: Vec<UsedCalibration>,
    /// The fit.
    pub fit: ReportedFit,
    /// Whether a white reference defines the scale of the observations; otherwise their unit is arbitrary.
    pub absolute: bool,
    /// The observations that were fitted.
    pub observations: Vec<ReportedObservation>,
    /// The newest verdict on the scan, if it was judged.
    pub verdict: Option<ReportedVerdict>,
    /// Scatter of the scans of this part by the same version of the recipe, this scan and the earlier ones; null below three.
    pub repeatability: Option<Repeatability>,
    /// Faults during the scan and their ends, oldest first.
    pub incidents: Vec<Incident>,
    /// The frames, by their content.
    pub frames: FrameHashes,
    /// Curves to draw through the observations. They follow from the fit.
    #[serde(skip)]
    pub curves: Vec<ReportedCurve>,
}

/// What was measured.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct MeasuredPart {
    /// Number of the part in the store.
    pub sample_id: Option<i64>,
    /// Its name.
    pub name: String,
    /// Its note.
    pub note: Option<String>,
    /// Nominal material with standard uncertainties.
    pub material: Material,
    /// Names that it had, oldest first.
    pub earlier_names: Vec<Earlier>,
}

/// Something that was corrected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct Earlier {
    /// What it was.
    pub name: String,
    /// When it was corrected, RFC 3339 in UTC.
    pub until: String,
}

/// The scan.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct MeasuredScan {
    /// Number of the scan.
    pub id: i64,
    /// `rig` or `import`.
    #[schema(value_type = String)]
    pub origin: &'static str,
    /// Its state.
    pub state: ScanState,
    /// Reason for the state, if it is not the normal course.
    pub reason: Option<String>,
    /// The version of the recipe that it was started with.
    pub recipe: Option<UsedDefinition>,
    /// The version of the specification that it was started with.
    pub specification: Option<UsedDefinition>,
    /// Lot of the part.
    pub lot: Option<String>,
    /// Number of the part or order in another system.
    pub external_id: Option<String>,
    /// The order of the queue that it measures.
    pub order_id: Option<i64>,
    /// The person at the rig.
    pub operator_name: Option<String>,
    /// Who started it.
    pub who: String,
    /// Program that ran it, with its commit.
    pub program: String,
    /// When it was requested, RFC 3339 in UTC.
    pub created_at: String,
    /// When it started; null for an import.
    pub started_at: Option<String>,
    /// When it ended.
    pub ended_at: Option<String>,
    /// Number of frames that were taken and rejected.
    pub frames_rejected: u32,
    /// Parts that it was assigned to before, oldest first.
    pub earlier_samples: Vec<Earlier>,
}

/// A version of a recipe or specification.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct UsedDefinition {
    /// Number of the recipe or specification in the store.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// Its version, from 1.
    pub version: i64,
}

/// The rig as the scan used it.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct MeasuringRig {
    /// Whether it was simulated.
    pub simulated: bool,
    /// Where lamp and camera are, with the stated uncertainties.
    pub geometry: RigFacts,
    /// How the camera makes counts.
    pub camera: CameraFacts,
    /// Controllers of the stages during the scan, the last ones first.
    pub stages: Vec<StageController>,
    /// Serial number of the camera, where its program states one.
    pub camera_serial: Option<String>,
    /// Lowest and highest temperature of the sensor, °C, where the camera's program states it.
    pub sensor_temperature_c: Option<[f64; 2]>,
}

/// A controller of a stage.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct StageController {
    /// Axis.
    pub axis: String,
    /// Serial number.
    pub serial: u32,
    /// The manufacturer's product number.
    pub device_id: u32,
    /// Firmware version.
    pub firmware: String,
}

/// Dark or white-reference frames of the store.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct UsedCalibration {
    /// Number of the calibration.
    pub id: i64,
    /// Kind of its frames.
    pub kind: FrameKind,
    /// Number of the scan that took the frames.
    pub scan_id: i64,
    /// Exposure times, s.
    pub exposures_s: Vec<f64>,
    /// Camera tilts θc, degrees; empty for dark frames.
    pub theta_c_deg: Vec<f64>,
    /// Number of frames.
    pub n_frames: u32,
    /// When the frames were taken, RFC 3339 in UTC.
    pub created_at: String,
    /// Age at the start of the scan, h; 0 for frames that the scan took itself.
    pub age_h: Option<f64>,
}

/// The fit.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ReportedFit {
    /// Number of the fit in the store.
    pub id: Option<i64>,
    /// The request, as it was accepted.
    #[schema(value_type = Object)]
    pub request: Value,
    /// Who started it.
    pub who: Option<String>,
    /// Program that computed it, with its commit.
    pub computed_by: String,
    /// When it was requested, RFC 3339 in UTC.
    pub created_at: Option<String>,
    /// When it ended.
    pub ended_at: Option<String>,
    /// The result, as `ridged fit --json` prints it.
    #[serde(flatten)]
    pub result: FitReport,
}

/// An observation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ReportedObservation {
    /// Camera tilt θc read back, degrees.
    pub theta_c_deg: f64,
    /// Sample azimuth φs read back, degrees.
    pub phi_s_deg: f64,
    /// Radiance for a lamp irradiance of 1 on a surface that faces the lamp; in an arbitrary unit if not `absolute`.
    pub signal: f64,
    /// Its standard uncertainty by independent errors.
    pub sigma: f64,
    /// Frames of this observation.
    pub n_frames: u32,
}

/// The verdict.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ReportedVerdict {
    /// Number of the verdict in the store.
    pub id: i64,
    /// The request with the whole specification.
    #[schema(value_type = Object)]
    pub request: Value,
    /// Who asked for it.
    pub who: String,
    /// When it was requested, RFC 3339 in UTC.
    pub created_at: String,
    /// When it ended.
    pub ended_at: Option<String>,
    /// The result, as `ridged judge --json` prints it.
    #[serde(flatten)]
    pub result: VerdictReport,
}

/// Frames by their content.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct FrameHashes {
    /// Number of frames.
    pub count: usize,
    /// SHA-256 of the text that `sha256sum` prints of the files: a line `HASH  NAME` for each, in the order of `files`.
    pub sha256: String,
    /// The frames, by name.
    pub files: Vec<FrameHash>,
}

/// A frame.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct FrameHash {
    /// File name in the series or in an export.
    pub file: String,
    /// What it shows.
    pub kind: FrameKind,
    /// SHA-256 of the file.
    pub sha256: String,
}

impl FrameHashes {
    /// Sorts the frames by name and combines their hashes.
    #[must_use]
    pub fn of(mut files: Vec<FrameHash>) -> Self {
        files.sort_by(|a, b| (&a.file, &a.sha256).cmp(&(&b.file, &b.sha256)));
        let mut all = Sha256::new();
        for file in &files {
            all.update(format!("{}  {}\n", file.sha256, file.file));
        }
        FrameHashes {
            count: files.len(),
            sha256: hex(&all.finalize()),
            files,
        }
    }

    /// Returns the number of frames of a kind.
    fn of_kind(&self, kind: FrameKind) -> usize {
        let files = self.files.iter();
        files.filter(|file| file.kind == kind).count()
    }
}

/// A fitted curve over the azimuth at one tilt.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportedCurve {
    /// Camera tilt θc, degrees.
    pub theta_c_deg: f64,
    /// Azimuth in degrees and signal.
    pub points: Vec<(f64, f64)>,
}

impl MeasurementReport {
    /// Returns the report as JSON, with `sha256` over the canonical form of all other fields.
    ///
    /// # Panics
    /// Never: all keys are text.
    #[must_use]
    pub fn sealed(&self) -> Value {
        let value = serde_json::to_value(self).expect("a report is JSON");
        canonical::sealed(value)
    }

    /// Returns the report as a page to print. `printed_at` is the time that it states, RFC 3339 in UTC.
    #[must_use]
    pub fn html(&self, printed_at: &str) -> String {
        html::page(self, printed_at)
    }

    /// Returns the name of the scan or series, for titles and files.
    fn source(&self) -> String {
        match &self.scan {
            Some(scan) => format!("scan {}", scan.id),
            None => "recorded series".to_owned(),
        }
    }
}
