//! The result of a reduction: the interface between rig and physics.
//!
//! A reduction turns frames into one [`ObservationSet`]; a fit reads nothing else. Signals are in
//! units of radiance for a lamp irradiance of 1 on a surface facing it (so a BRDF f gives f·cos
//! θi). With a white reference the unit is absolute, up to the reference's own uncertainty and the
//! stray light; the fit determines both together with the flats. Without one the unit is arbitrary
//! and [`ObservationSet::white_reference`] is `None`.

use crate::geometry::{Directions, Field, Pose, RigGeometry};
use crate::material::Material;
use crate::units::Angle;

/// One reduced measurement of the sample at one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Position read back from the stages, never the requested one.
    pub pose: Pose,
    /// Signal in radiance units (see the module's documentation), including stray light.
    pub signal: f64,
    /// Standard uncertainty of `signal` by independent errors: shot noise, read noise, repeats.
    pub sigma: f64,
    /// Errors that are common to all observations.
    pub shared: SharedErrors,
    /// Number of frames used.
    pub n_frames: u32,
    /// Mean time of its frames, in seconds after the mean time of the white reference's frames (or
    /// of all observations without a white reference); `None` if the frames have no times.
    pub taken_s: Option<f64>,
    /// Its place in a table of readings; `None` for frames.
    pub row: Option<TableRow>,
}

/// Place of a reading in a table, from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableRow {
    /// Line of a CSV file.
    Line(usize),
    /// Number among the readings of a BiRD file.
    Reading(usize),
}

impl std::fmt::Display for TableRow {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            TableRow::Line(n) => write!(f, "line {n}"),
            TableRow::Reading(n) => write!(f, "reading {n}"),
        }
    }
}

/// Change of this observation by one standard uncertainty of each source that all observations
/// share. The sign is that of a positive deviation of the source.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SharedErrors {
    /// Certificate of the white reference: change of `signal`.
    pub white_reference: f64,
    /// Lamp drift between the white reference and the sample: change of `signal`.
    pub led_drift: f64,
    /// The camera's curve and exposure times, if measured or stated: change of `signal`.
    pub detector: f64,
    /// Zero of the tilt stage beyond the fitted offset: change of θc.
    pub theta_c_zero: Angle,
    /// Zero of the rotation stage beyond the fitted offset: change of φs.
    pub phi_s_zero: Angle,
}

/// The white reference measured at one camera tilt. Modelled as gain · [reflectance/π · cos θi(θc +
/// δ) + stray light], with the tilt's zero error δ.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatObservation {
    /// Camera tilt read back from the stage.
    pub theta_c: Angle,
    /// Signal in the unit of the observations.
    pub signal: f64,
    /// Standard uncertainty of `signal`, independent between flats.
    pub sigma: f64,
    /// Times of its frames, in seconds after the mean time of all flats; empty unless all have times.
    pub times_s: Vec<f64>,
}

/// Certificate of the white reference: a Lambertian reflector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WhiteReference {
    /// Diffuse reflectance.
    pub reflectance: f64,
    /// Standard uncertainty of the reflectance.
    pub reflectance_std: f64,
}

/// Nonlinearity of a camera, determined from exposures at one pose: s = e (1 − c e/S) counts above
/// the dark level for light that a linear camera would measure as e. Signals are corrected for it.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DetectorCurve {
    /// Relative loss at full scale.
    pub c: f64,
    /// Exponent γ of counts ∝ light^γ, where the camera follows a power law instead; otherwise 1.
    #[serde(default = "linear_exponent")]
    pub exponent: f64,
    /// Standard uncertainty of c, or of γ.
    pub std: f64,
    /// Number of pairs of exposures from which it was determined.
    pub pairs: usize,
    /// Full scale S, counts above black.
    pub full_scale_dn: f64,
    /// Fraction of the pairs' χ² that the curve explains, 0 to 1.
    pub explains: f64,
}

/// γ of a camera without a power law.
fn linear_exponent() -> f64 {
    1.0
}

/// A power law of the camera, counts ∝ light^γ, that explains the disagreement of exposures as well as errors of the exposure
/// times do. Signals are corrected for the latter.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PowerLaw {
    /// γ.
    pub exponent: f64,
    /// Standard uncertainty of γ by that of the exposure times.
    pub std: f64,
    /// Largest error of an exposure time against another that it explains, as a share.
    pub spread: f64,
    /// Fraction of the pairs' χ² that it explains, 0 to 1.
    pub explains: f64,
    /// Number of pairs of exposures from which it was determined.
    pub pairs: usize,
    /// Warning of errors of the exposure times, which is void if the power law holds.
    pub instead_of: String,
}

/// Drift of the lamp, determined from a fit's residuals: light = that of a steady lamp · (1 + Σ d_k
/// [P_k(x) − P̄_k]), with the Legendre polynomials P_k of time and their means P̄_k over the white
/// reference.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LampDrift {
    /// d_k, degree 1 first; 0 for degrees that are not fitted.
    pub coefficients: [f64; 3],
    /// Their covariance.
    pub covariance: [[f64; 3]; 3],
    /// Relative change of the light from the first to the last observation.
    pub change_over_series: f64,
    /// Standard uncertainty of that change.
    pub change_std: f64,
    /// Time from the first to the last observation, hours.
    pub hours: f64,
    /// Coefficient of a straight line divided by its standard uncertainty.
    pub t: f64,
    /// Variance explained by the drift divided by the remaining one, each per degree of freedom.
    pub f: f64,
    /// Probability of so large an F by chance.
    pub chance: f64,
    /// Fraction of χ² that the drift explains, 0 to 1.
    pub explains: f64,
    /// Fraction of the time column that the other parameters explain: above 0.95 the drift cannot
    /// be separated from them.
    pub alike: f64,
    /// Reduced χ² by which the drift explains more than as many polynomials of the tilt or of the azimuth. Where the poses
    /// are visited in an order, these imitate each other.
    pub over_pose: f64,
    /// Largest ratio of a coefficient to its change when whole tilts and azimuths are left out, in
    /// standard deviations.
    pub steady_over_groups: f64,
    /// Ridge angle of the fit from which the drift was determined, before the correction, rad.
    pub theta_r_before: f64,
}

/// Prior knowledge of a quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Expected value.
    pub mean: f64,
    /// Standard uncertainty.
    pub std: f64,
}

/// A frame that the reduction left out, with its reason.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
#[schema(as = FrameRejected)]
pub struct RejectedFrame {
    /// File name as recorded.
    pub file: String,
    /// Stable word or short phrase: `saturated`, `black`, `unreadable`, `wrong size`, `shifted`, …
    pub reason: String,
    /// Details in words and numbers; may be empty.
    #[serde(default)]
    #[schema(required = true)]
    pub detail: String,
}

impl RejectedFrame {
    /// Returns the reason with its details.
    pub(crate) fn cause(&self) -> String {
        match self.detail.as_str() {
            "" => self.reason.clone(),
            detail => format!("{}: {detail}", self.reason),
        }
    }
}

/// One of the directions over which an observation averages with a near camera or lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Towards lamp and camera in the rig's frame (x, y, z) at the recorded tilt. A tilt offset
    /// rotates both about +y.
    pub directions: Directions,
    /// Fraction of the observation times the irradiance there on a surface facing the lamp,
    /// relative to the centre of tilt.
    pub weight: f64,
}

impl From<(Directions, f64)> for View {
    fn from((directions, weight): (Directions, f64)) -> Self {
        View { directions, weight }
    }
}

/// The frame over all of whose pixels each observation of a near camera or lamp averages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WholeField {
    /// The frame.
    pub field: Field,
    /// Width α of the narrowest lobe that the views sum right.
    pub narrowest: f64,
}

impl Observation {
    /// Makes an observation of one frame without shared errors.
    #[must_use]
    pub fn new(pose: Pose, signal: f64, sigma: f64) -> Self {
        Observation {
            pose,
            signal,
            sigma,
            shared: SharedErrors::default(),
            n_frames: 1,
            taken_s: None,
            row: None,
        }
    }
}

/// The measurements of one sample (or one region of it), as a fit uses them.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservationSet {
    /// The rig that measured them.
    pub rig: RigGeometry,
    /// Nominal material with its uncertainty.
    pub material: Material,
    /// The sample's observations.
    pub observations: Vec<Observation>,
    /// For a near camera or lamp: the directions over which each observation averages, signal =
    /// gain · (Σ weight · L(directions) + s). One view each if lamp and camera move freely, as on a
    /// goniometer. Empty if both are distant and the lamp is fixed to the camera.
    pub views: Vec<Vec<View>>,
    /// What the views stand for, if it is a whole frame of a near camera or lamp; without it they cannot be made finer.
    pub field: Option<WholeField>,
    /// The white reference over its tilts; empty without one.
    pub flats: Vec<FlatObservation>,
    /// Certificate of the white reference; if `None`, the fit determines the scale.
    pub white_reference: Option<WhiteReference>,
    /// Stray light in the unit of the signals, with its prior (from flats, darks or the mount).
    pub background: Prior,
    /// Standard uncertainty of the inclination of the sample's mean plane to the turntable, in any
    /// direction; `None` if not stated.
    pub wedge_std: Option<Angle>,
    /// Standard uncertainty of the rig's azimuth zero, that is of the direction of v at a recorded
    /// φs; `None` if not stated.
    pub azimuth_zero_std: Option<Angle>,
    /// Standard uncertainty of the angle θl between lamp and camera; `None` if not stated.
    pub theta_l_std: Option<Angle>,
    /// Standard uncertainty common to all signals by the noise of the dark frames, in their unit.
    pub dark_std: f64,
    /// Fraction of the body's light that leaves uniformly over the ridges, as stated in the series;
    /// `None` if not stated.
    pub translucency: Option<Prior>,
    /// The lamp drift for which the signals were corrected.
    pub lamp: Option<LampDrift>,
    /// The camera's nonlinearity, if significant; signals are corrected for it.
    pub detector: Option<DetectorCurve>,
    /// A power law of the camera that a fit compares with errors of the exposure times.
    pub power_law: Option<PowerLaw>,
    /// Region of interest, if the part has several.
    pub region: Option<String>,
    /// Direction of this region's lean relative to the rig's azimuth zero (90° for the odd patches
    /// of a checkerboard). It is already part of the model's azimuth and not of the offset.
    pub region_azimuth: Angle,
    /// Frames used, darks and flats included.
    pub n_frames_used: u32,
    /// Frames left out.
    pub rejected_frames: Vec<RejectedFrame>,
    /// Warnings to the user, as sentences.
    pub warnings: Vec<String>,
}

impl ObservationSet {
    /// Standard uncertainties of the observations, in the unit of the signals.
    #[must_use]
    pub fn sigma(&self) -> Vec<f64> {
        self.observations.iter().map(|o| o.sigma).collect()
    }

    /// Whether lamp and camera move freely, as on a goniometer: each observation has directions of its own.
    #[must_use]
    pub fn is_of_goniometer(&self) -> bool {
        self.views.first().is_some_and(|views| views.len() == 1)
    }

    /// Whether camera or lamp are near.
    #[must_use]
    pub fn is_of_near_rig(&self) -> bool {
        !self.views.is_empty() && !self.is_of_goniometer()
    }

    /// Makes a set of one sample on a distant rig, with one frame per observation, without flats
    /// and without a certificate.
    #[must_use]
    pub fn bare(
        rig: RigGeometry,
        material: Material,
        observations: Vec<Observation>,
        background: Prior,
    ) -> Self {
        ObservationSet {
            rig,
            material,
            n_frames_used: u32::try_from(observations.len()).unwrap_or(u32::MAX),
            observations,
            views: Vec::new(),
            field: None,
            flats: Vec::new(),
            white_reference: None,
            background,
            wedge_std: None,
            azimuth_zero_std: None,
            theta_l_std: None,
            dark_std: 0.0,
            translucency: None,
            lamp: None,
            detector: None,
            power_law: None,
            region: None,
            region_azimuth: Angle::ZERO,
            rejected_frames: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// Directions towards lamp and camera in the rig's frame at the recorded tilt: those of the
    /// observation's own view if it has exactly one, otherwise those of the rig's centre.
    #[must_use]
    pub fn rig_directions(&self, index: usize) -> Directions {
        match self.views.get(index).map(Vec::as_slice) {
            Some([view]) => view.directions,
            _ => self
                .rig
                .rig_directions(self.observations[index].pose.theta_c),
        }
    }

    /// Returns the place of a tilt in the range of the recorded ones: −1 at the lowest, 1 at the
    /// highest; 0 everywhere if all are equal.
    pub(crate) fn tilt_scale(&self) -> impl Fn(Angle) -> f64 + use<> {
        let tilts = self.observations.iter().map(|o| o.pose.theta_c.rad());
        let (low, high) = tilts.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), tilt| {
            (low.min(tilt), high.max(tilt))
        });
        move |tilt| match high > low {
            true => (2.0 * tilt.rad() - low - high) / (high - low),
            false => 0.0,
        }
    }

    /// Returns the set with views that sum a lobe of the width α right. `None` if its own views do, or if no finer ones can be
    /// had.
    #[must_use]
    pub fn with_finer_views(&self, alpha: f64) -> Option<Self> {
        /// Part of the width that a fit with finer views may find the lobe to be narrower.
        const MARGIN: f64 = 0.8;
        let whole = self.field.filter(|whole| alpha < whole.narrowest)?;
        let narrowest = MARGIN * alpha;
        let mut field = whole.field;
        field.imaging.rig = self.rig;
        let views = self.observations.iter().map(|o| {
            let views = field.views(o.pose.theta_c, narrowest);
            views.into_iter().map(View::from).collect()
        });
        let views: Vec<Vec<View>> = views.collect();
        let count = |views: &[Vec<View>]| views.iter().map(Vec::len).sum::<usize>();
        (count(&views) > count(&self.views)).then(|| ObservationSet {
            field: Some(WholeField { field, narrowest }),
            views,
            ..self.clone()
        })
    }

    /// Returns the set with the lamp moved away from the camera by an angle: the geometry changes,
    /// the signals stay.
    #[must_use]
    pub fn with_lamp_moved(&self, by: Angle) -> Self {
        let mut moved = self.clone();
        moved.rig.theta_l = self.rig.theta_l + by;
        for view in moved.views.iter_mut().flatten() {
            let Directions { incident, outgoing } = view.directions;
            // Perpendicular to the camera's direction, on the lamp's side; a lamp exactly behind
            // the camera has no side.
            let Some(aside) = (incident - outgoing * incident.dot(&outgoing)).try_normalize(0.0)
            else {
                continue;
            };
            let theta_l = incident
                .cross(&outgoing)
                .norm()
                .atan2(incident.dot(&outgoing))
                + by.rad();
            view.directions.incident = outgoing * theta_l.cos() + aside * theta_l.sin();
        }
        moved
    }
}
