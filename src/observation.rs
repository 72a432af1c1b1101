//! What a reduced measurement is: the waist between rig and physics.
//!
//! A reduction turns frames into one [`ObservationSet`]; a fit reads nothing else. Signals are in
//! units of radiance for a lamp irradiance of 1 on a surface facing it (so a BRDF f gives
//! f·cos θi). With a white reference the unit is absolute up to the reference's own uncertainty and
//! the stray light, both of which the fit settles together with the flats; without one the unit is
//! arbitrary and [`ObservationSet::white_reference`] is `None`.

use crate::geometry::{Directions, Pose, RigGeometry};
use crate::material::Material;
use crate::units::Angle;

/// One reduced measurement of the sample at one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Position read back from the stages, never the one asked for.
    pub pose: Pose,
    /// Signal in radiance units (see the module's head); stray light is still in it.
    pub signal: f64,
    /// Own standard uncertainty of `signal`: shot noise, read noise, repeats. Independent between
    /// observations.
    pub sigma: f64,
    /// Errors that this observation has in common with all others.
    pub shared: SharedErrors,
    /// Frames that went into it.
    pub n_frames: u32,
    /// Mean time of its frames, in seconds after the mean time of the white reference's (of all observations where there is
    /// none); `None` where frames bear no times.
    pub taken_s: Option<f64>,
}

/// By how much one standard uncertainty of a source that all observations share moves this one.
/// The sign is that of a positive deviation of the source.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SharedErrors {
    /// White reference's certificate: change of `signal`.
    pub white_reference: f64,
    /// Lamp drift between the white reference and the sample: change of `signal`.
    pub led_drift: f64,
    /// The camera's curve and its exposure times, where they are told or stated: change of `signal`.
    pub detector: f64,
    /// Zero of the tilt stage beyond what the fit solves for: change of θc.
    pub theta_c_zero: Angle,
    /// Zero of the rotation stage beyond what the fit solves for: change of φs.
    pub phi_s_zero: Angle,
}

/// The white reference seen at one camera tilt. Modelled as
/// gain · [reflectance/π · cos θi(θc + δ) + stray light], δ the tilt's zero error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlatObservation {
    /// Camera tilt read back from the stage.
    pub theta_c: Angle,
    /// Signal in the same unit as the observations'.
    pub signal: f64,
    /// Standard uncertainty of `signal`, independent between flats.
    pub sigma: f64,
}

/// Certificate of the white reference: a Lambertian reflector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WhiteReference {
    /// Diffuse reflectance.
    pub reflectance: f64,
    /// Standard uncertainty of the reflectance.
    pub reflectance_std: f64,
}

/// A camera that is not linear, as exposures of one pose tell it: counts s = e (1 − c e/S) above the dark level of light
/// that a linear camera would count as e. Signals are corrected for it.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DetectorCurve {
    /// Share that is missing at full scale.
    pub c: f64,
    /// Standard uncertainty of c.
    pub std: f64,
    /// Pairs of exposures that tell it.
    pub pairs: usize,
    /// Full scale S, counts above black.
    pub full_scale_dn: f64,
    /// Share of the pairs' χ² that goes with the curve, 0 to 1.
    pub explains: f64,
}

/// A lamp that drifts, as a fit's residuals tell it: light = that of a steady lamp · (1 + Σ d_k [P_k(x) − P̄_k]), P_k Legendre's
/// polynomials in time, P̄_k their mean over the white reference.
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
    /// From the first to the last observation, hours.
    pub hours: f64,
    /// A straight line's coefficient over its standard uncertainty.
    pub t: f64,
    /// Variance that goes with the drift over what is left, per degree of freedom each.
    pub f: f64,
    /// Share of χ² that goes with it, 0 to 1.
    pub explains: f64,
    /// Share of time's column that the other parameters explain: above 0.95 time can hardly be told from them.
    pub alike: f64,
    /// The coefficient that stands out most from what leaving out whole tilts and azimuths does to it, in standard deviations.
    pub steady_over_groups: f64,
    /// Ridge angle of the fit that told it, before it was taken off, rad.
    pub theta_r_before: f64,
}

/// What is known of a quantity before the fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Expected value.
    pub mean: f64,
    /// Standard uncertainty.
    pub std: f64,
}

/// A frame that was left out of the reduction, by name and reason.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct RejectedFrame {
    /// File name as recorded.
    pub file: String,
    /// Stable word or short phrase: `saturated`, `black`, `unreadable`, `wrong size`, `shifted`, …
    pub reason: String,
    /// What was seen, in words and numbers; may be empty.
    #[serde(default)]
    pub detail: String,
}

/// One of the directions over which a near camera or lamp averages within an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Towards lamp and camera in the rig's frame (x, y, z) at the recorded tilt. A tilt offset turns
    /// both about +y.
    pub directions: Directions,
    /// Share of the observation times the irradiance there on a surface facing the lamp, relative
    /// to the centre of tilt.
    pub weight: f64,
}

impl Observation {
    /// Of one frame, with no error in common with others.
    #[must_use]
    pub fn new(pose: Pose, signal: f64, sigma: f64) -> Self {
        Observation {
            pose,
            signal,
            sigma,
            shared: SharedErrors::default(),
            n_frames: 1,
            taken_s: None,
        }
    }
}

/// All that a fit needs to know about one sample (or one region of it).
#[derive(Debug, Clone, PartialEq)]
pub struct ObservationSet {
    /// The rig that saw them.
    pub rig: RigGeometry,
    /// Nominal material with its uncertainty.
    pub material: Material,
    /// The sample's observations.
    pub observations: Vec<Observation>,
    /// Where camera or lamp are near: for each observation the directions over which it averages,
    /// signal = gain · (Σ weight · L(directions) + s). One view each where lamp and camera move freely, as a
    /// goniometer's do. Empty where both are far and the lamp is fixed to the camera.
    pub views: Vec<Vec<View>>,
    /// The white reference over its tilts; empty without one.
    pub flats: Vec<FlatObservation>,
    /// Certificate of the white reference; `None` makes the scale free.
    pub white_reference: Option<WhiteReference>,
    /// Stray light in the signals' unit, as known before the fit (from flats, darks or the mount).
    pub background: Prior,
    /// Standard uncertainty of how the sample's mean plane is inclined to the turntable, along any direction; `None`
    /// where nobody states it.
    pub wedge_std: Option<Angle>,
    /// Standard uncertainty of the rig's azimuth zero: of where v stands at a recorded φs; `None` where nobody states it.
    pub azimuth_zero_std: Option<Angle>,
    /// Standard uncertainty of the angle θl between lamp and camera; `None` where nobody states it.
    pub theta_l_std: Option<Angle>,
    /// Standard uncertainty that the dark frames' own noise gives all signals alike, in their unit.
    pub dark_std: f64,
    /// Share of the body's light that leaves evenly over the ridges, as the series states it; `None` where it does not.
    pub translucency: Option<Prior>,
    /// When each frame of the white reference was taken, in seconds after their mean time; empty where not all bear times.
    pub flat_times_s: Vec<f64>,
    /// The lamp's drift that was taken off the signals.
    pub lamp: Option<LampDrift>,
    /// The camera's curve, where it is told to be other than straight; signals are corrected for it.
    pub detector: Option<DetectorCurve>,
    /// Region of interest, where the sample has several.
    pub region: Option<String>,
    /// Where this region's lean direction stands relative to the rig's azimuth zero (90° for the odd
    /// patches of a checkerboard): already part of the model's azimuth, not of the offset.
    pub region_azimuth: Angle,
    /// Frames used, darks and flats included.
    pub n_frames_used: u32,
    /// Frames left out.
    pub rejected_frames: Vec<RejectedFrame>,
    /// Sentences for the user.
    pub warnings: Vec<String>,
}

impl ObservationSet {
    /// One sample of a far rig, one frame per observation, without flats and without a certificate of
    /// the scale.
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
            flats: Vec::new(),
            white_reference: None,
            background,
            wedge_std: None,
            azimuth_zero_std: None,
            theta_l_std: None,
            dark_std: 0.0,
            translucency: None,
            flat_times_s: Vec::new(),
            lamp: None,
            detector: None,
            region: None,
            region_azimuth: Angle::ZERO,
            rejected_frames: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// Towards lamp and camera in the rig's frame at the recorded tilt: the observation's own directions where it has one
    /// view, else those of the rig's centre.
    #[must_use]
    pub fn rig_directions(&self, index: usize) -> Directions {
        match self.views.get(index).map(Vec::as_slice) {
            Some([view]) => view.directions,
            _ => self
                .rig
                .rig_directions(self.observations[index].pose.theta_c),
        }
    }

    /// The same seen by a rig whose lamp stands farther from the camera by an angle: the geometry moves, the signals stay.
    #[must_use]
    pub fn with_lamp_moved(&self, by: Angle) -> Self {
        let mut moved = self.clone();
        moved.rig.theta_l = self.rig.theta_l + by;
        for view in moved.views.iter_mut().flatten() {
            let Directions { incident, outgoing } = view.directions;
            // Square to the camera's direction, on the lamp's side; a lamp right behind the camera has no side.
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
