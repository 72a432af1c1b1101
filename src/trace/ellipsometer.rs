//! A virtual ellipsometer: the images of a traced surface with a filter and a compensator in front
//! of lamp and camera.
//!
//! Call [`curve`] for the plane of incidence. For six states of the lamp's light and six settings
//! of the camera's optics it returns the intensities, and from the Stokes vector the degree and
//! angle of linear polarisation (Wang et al. 2017, Sec. 4.4 and Figs. 7–9). Filter angles count
//! from s to p of a ray, in the frame (z × k, k × s) of [`crate::model::polarisation`]. The
//! compensator is an ideal quarter-wave plate after the lamp's filter and before the camera's; its
//! angle is that of the fast axis. A setting of the camera transmits the state that the lamp's
//! setting of the same name produces: linear-0 (I + Q)/2, left (I + V)/2, with V = I_left −
//! I_right.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

use nalgebra::{RowVector4, Vector4};
use serde::Serialize;

use super::counting::plane::{PlaneDirection, plane};
use super::counting::tally::{ElementCovariance, MonteCarloEstimate, NUMBERS, Totals};
use crate::model::polarisation::{Channel, Mueller, Stokes};

/// A setting of filter and compensator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PolariserSetting {
    /// The state that it produces or transmits.
    pub name: &'static str,
    /// Transmission axis of the filter, degrees from s to p.
    pub filter_deg: f64,
    /// Fast axis of the lamp's quarter-wave plate, degrees from s to p; parallel to the filter it
    /// has no effect.
    pub compensator_deg: f64,
    /// Fast axis of the camera's quarter-wave plate, which light passes before the filter.
    pub camera_compensator_deg: f64,
}

const fn setting(name: &'static str, filter_deg: f64, compensator_deg: f64) -> PolariserSetting {
    PolariserSetting {
        name,
        filter_deg,
        compensator_deg,
        // Circular light keeps its handedness when it passes plate and filter in the other
        // direction: the analyser of a state is its generator mirrored in the filter's axis.
        camera_compensator_deg: (2.0 * filter_deg - compensator_deg + 180.0) % 180.0,
    }
}

/// The canonical input states, which are also the camera's settings.
pub const SETTINGS: [PolariserSetting; 6] = [
    setting("linear-0", 0.0, 0.0),
    setting("linear-45", 45.0, 45.0),
    setting("linear-90", 90.0, 90.0),
    setting("linear-135", 135.0, 135.0),
    setting("left", 0.0, 135.0),
    setting("right", 0.0, 45.0),
];

fn at_angle(optic: &Mueller, degrees: f64) -> Mueller {
    let angle = degrees.to_radians();
    Mueller::rotation(-angle) * *optic * Mueller::rotation(angle)
}

fn filter(degrees: f64) -> Mueller {
    let along_s = Channel {
        s: 1.0,
        ..Channel::NONE
    };
    at_angle(&along_s.mueller(), degrees)
}

/// A quarter-wave plate: with exp(−iωt) the slow axis (p) gains the phase π/2, so t_s t_p* = −i.
fn quarter_wave(degrees: f64) -> Mueller {
    let fast_s = Channel {
        s: 1.0,
        p: 1.0,
        re: 0.0,
        im: -1.0,
    };
    at_angle(&fast_s.mueller(), degrees)
}

impl PolariserSetting {
    /// Stokes vector of the lamp's light after its optics, with intensity 1.
    #[must_use]
    pub fn lamp(&self) -> Stokes {
        let behind = quarter_wave(self.compensator_deg) * filter(self.filter_deg);
        2.0 * behind.0 * Vector4::new(1.0, 0.0, 0.0, 0.0)
    }

    /// The camera's signal per Stokes component of the light before its optics.
    #[must_use]
    pub fn camera(&self) -> RowVector4<f64> {
        let through = filter(self.filter_deg) * quarter_wave(self.camera_compensator_deg);
        through.0.row(0).into_owned()
    }
}

/// The results in one direction for one state of the lamp.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EllipsometerReading {
    /// The lamp's state.
    pub input: &'static str,
    /// Stokes vector per irradiance, sr⁻¹.
    pub stokes: [f64; 4],
    /// Standard errors of the Stokes vector.
    pub stokes_std: [f64; 4],
    /// The camera's signal for each of [`SETTINGS`], sr⁻¹.
    pub camera: [f64; 6],
    /// Standard errors of the signals.
    pub camera_std: [f64; 6],
    /// Degree of linear polarisation.
    pub dolp: f64,
    /// Its standard error; `None` with [too little light](ERROR_UNKNOWN).
    pub dolp_std: Option<f64>,
    /// Angle of polarisation, degrees from s to p, in (−90, 90].
    pub aop_deg: f64,
    /// Its standard error; `None` with too little light; for almost unpolarised light that of an
    /// arbitrary angle.
    pub aop_std_deg: Option<f64>,
}

/// Note on readings without errors of the degree and angle of polarisation.
pub const ERROR_UNKNOWN: &str = "directions that fewer than 10 replicates reached, or whose intensity has an error above 30 %, have no standard \
     error of the degree and angle of polarisation: the light of one photon has one state, however far from the mean; \
     trace more photons";

/// Least number of replicates with light in a direction for the covariance of its numbers: from a
/// single one, every ratio would seem exact.
const REPLICATES_MIN: u64 = 10;
/// Relative error of the intensity below which few replicates suffice: the rest is known without
/// them.
const HARMLESS: f64 = 0.01;
/// Relative error of the intensity above which ratios to it are not linear.
const INTENSITY_ERROR_MAX: f64 = 0.3;

impl EllipsometerReading {
    /// Whether the degree and angle of polarisation have standard errors.
    #[must_use]
    pub fn has_errors(&self) -> bool {
        self.dolp_std.is_some()
    }
}

/// The angles that an ellipsometer states, from linear light at 45°: tan Ψ exp(iΔ) = r_p/r_s for a surface that does not
/// depolarise (Azzam and Bashara 1977, Sec. 3.2).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PsiDelta {
    /// Ψ, degrees, in [0, 90]: cos 2Ψ = Q/√(Q² + U² + V²).
    pub psi_deg: f64,
    /// Its standard error; `None` with [too little light](ERROR_UNKNOWN).
    pub psi_std_deg: Option<f64>,
    /// Δ, degrees, in (−180, 180], with time as exp(+iωt) and the index n − ik, so that it is positive for metals and 180°
    /// for glass below Brewster's angle.
    pub delta_deg: f64,
    /// Its standard error; `None` with too little light; for light without U and V that of an arbitrary angle.
    pub delta_std_deg: Option<f64>,
    /// Degree of polarisation √(Q² + U² + V²)/I: 1 for a surface that does not depolarise.
    pub dop: f64,
    /// Its standard error; `None` with too little light.
    pub dop_std: Option<f64>,
}

/// One direction in the plane of incidence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EllipsometerPoint {
    /// Angle of reflection, degrees; positive on the side of the mirror direction.
    pub theta_s_deg: f64,
    /// One reading for each state of the lamp, for example [`SETTINGS`].
    pub readings: Vec<EllipsometerReading>,
    /// Ψ, Δ and the degree of polarisation, from linear light at 45°.
    pub psi_delta: PsiDelta,
    /// Whether the errors treat the Mueller elements as independent, which makes some too large and
    /// others too small: their covariance was not recorded ([`Totals::with_directions`]).
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub errors_as_independent: bool,
}

/// Degree of linear polarisation of a Stokes vector.
#[must_use]
pub fn dolp(stokes: &[f64; 4]) -> f64 {
    stokes[1].hypot(stokes[2]) / stokes[0]
}

/// Angle of polarisation, degrees from s to p, in (−90, 90].
#[must_use]
pub fn aop_deg(stokes: &[f64; 4]) -> f64 {
    // Removes the sign of U = −0: p is 90°, not −90°.
    0.5 * (stokes[2] + 0.0).atan2(stokes[1]).to_degrees()
}

/// The plane of incidence of a polarised run with the lamp at the azimuth `phi_i_deg`, by the angle
/// of reflection; directions without light are left out. `None` for scalar runs and pixel bins.
#[must_use]
pub fn curve(totals: &Totals, phi_i_deg: f64) -> Option<Vec<EllipsometerPoint>> {
    curve_of(totals, phi_i_deg, &SETTINGS.map(|s| (s.name, s.lamp())))
}

/// The same for other named states of the lamp's light, each of intensity 1.
#[must_use]
pub fn curve_of(
    totals: &Totals,
    phi_i_deg: f64,
    lamps: &[(&'static str, Stokes)],
) -> Option<Vec<EllipsometerPoint>> {
    if totals.elements() < 16 {
        return None;
    }
    let point = |direction: PlaneDirection| {
        let numbers = &direction.numbers;
        let std: Vec<f64> = numbers.iter().map(|e| e.std).collect();
        let errors_as_independent = direction.covariance.is_none();
        let covariance = direction.covariance.as_ref();
        let covariance =
            covariance.map_or_else(|| ElementCovariance::independent(&std), Clone::clone);
        let readings = lamps.iter();
        EllipsometerPoint {
            theta_s_deg: direction.theta_s_deg,
            readings: readings
                .map(|(name, lamp)| reading(name, lamp, numbers, &covariance))
                .collect(),
            psi_delta: psi_delta(numbers, &covariance),
            errors_as_independent,
        }
    };
    let directions = plane(totals, phi_i_deg)?;
    Some(directions.into_iter().map(point).collect())
}

/// Standard deviation (rad) of the angle of a vector whose length is `r` standard errors of its
/// components: 1/r for large r, π/√3 for a uniformly random angle.
fn angle_std(r: f64) -> f64 {
    const FAR: f64 = 30.0;
    const STEPS: usize = 256;
    if r.is_nan() {
        return angle_std(0.0);
    }
    if r > FAR {
        return 1.0 / r;
    }
    // Density of the angle φ of (r + n₁, n₂), n normal; at the middle of each step of (0, π).
    let density = |phi: f64| {
        let along = r * phi.cos();
        let tail = 0.5 * libm::erfc(-along * FRAC_1_SQRT_2);
        let lobe = (2.0 * PI).sqrt() * along * (-0.5 * (r * phi.sin()).powi(2)).exp() * tail;
        (-0.5 * r * r).exp() + lobe
    };
    let step = PI / STEPS as f64;
    let angles = (0..STEPS).map(|k| (k as f64 + 0.5) * step);
    let (all, squares) = angles.fold((0.0, 0.0), |(all, squares), phi| {
        let p = density(phi);
        (all + p, squares + p * phi * phi)
    });
    (squares / all).sqrt()
}

/// The Stokes vector that a state of the lamp gives in one direction, and the errors of functions of it.
struct SeenStokes<'a> {
    stokes: [f64; 4],
    lamp: &'a Stokes,
    covariance: &'a ElementCovariance,
}

impl<'a> SeenStokes<'a> {
    fn of(
        lamp: &'a Stokes,
        mueller: &[MonteCarloEstimate],
        covariance: &'a ElementCovariance,
    ) -> Self {
        SeenStokes {
            stokes: std::array::from_fn(|i| {
                (0..4).map(|j| mueller[4 * i + j].value * lamp[j]).sum()
            }),
            lamp,
            covariance,
        }
    }

    /// Standard error of a function with these slopes in the four components.
    fn std_of(&self, slopes: [f64; 4]) -> f64 {
        let weights: [f64; NUMBERS] = std::array::from_fn(|n| slopes[n / 4] * self.lamp[n % 4]);
        self.covariance.std(&weights)
    }

    /// Whether ratios to the intensity have standard errors.
    fn has_errors(&self) -> bool {
        let spread = self.std_of([1.0, 0.0, 0.0, 0.0]) / self.stokes[0];
        let few = |lit: u64| (1..REPLICATES_MIN).contains(&lit) && spread > HARMLESS;
        spread <= INTENSITY_ERROR_MAX && !self.covariance.replicates.is_some_and(few)
    }
}

fn psi_delta(mueller: &[MonteCarloEstimate], covariance: &ElementCovariance) -> PsiDelta {
    let at_45 = Stokes::new(1.0, 0.0, 1.0, 0.0);
    let seen = SeenStokes::of(&at_45, mueller, covariance);
    let known = seen.has_errors();
    let [i, q, u, v] = seen.stokes;
    let across = u.hypot(v);
    let polarised = q.hypot(across);
    let dop = polarised / i;
    let squared = polarised * polarised;
    let slope = |of: f64| if across > 0.0 { of / across } else { 0.0 };
    let psi_slopes = [
        0.0,
        -0.5 * across / squared,
        0.5 * q * slope(u) / squared,
        0.5 * q * slope(v) / squared,
    ];
    let turn = seen.std_of([0.0, 0.0, slope(v), -slope(u)]);
    let dop_slopes = [
        -dop / i,
        q / polarised / i,
        u / polarised / i,
        v / polarised / i,
    ];
    let std = |std: f64| known.then_some(std);
    PsiDelta {
        psi_deg: 0.5 * across.atan2(q).to_degrees(),
        psi_std_deg: std(seen.std_of(psi_slopes).to_degrees()),
        // −0 and 0 are the same V.
        delta_deg: (0.0 - v).atan2(u).to_degrees(),
        delta_std_deg: std(angle_std(across / turn).to_degrees()),
        dop,
        dop_std: std(seen.std_of(dop_slopes)),
    }
}

fn reading(
    input: &'static str,
    lamp: &Stokes,
    mueller: &[MonteCarloEstimate],
    covariance: &ElementCovariance,
) -> EllipsometerReading {
    let seen = SeenStokes::of(lamp, mueller, covariance);
    let std_of = |slopes: [f64; 4]| seen.std_of(slopes);
    let stokes = seen.stokes;
    let component = |i: usize| std::array::from_fn(|n| f64::from(u8::from(n == i)));
    let stokes_std: [f64; 4] = std::array::from_fn(|i| std_of(component(i)));
    let [i, q, u, _] = stokes;
    let linear = q.hypot(u);
    let (dolp, aop_deg) = (dolp(&stokes), aop_deg(&stokes));
    let known = seen.has_errors();
    let (dolp_std, aop_std_deg) = if linear > 0.0 {
        // Slopes of √(Q² + U²)/I and of ½ atan2(U, Q).
        let (along, across) = ([q / linear, u / linear], [-u / linear, q / linear]);
        let turn = std_of([0.0, across[0], across[1], 0.0]);
        (
            std_of([-dolp / i, along[0] / i, along[1] / i, 0.0]),
            (0.5 * angle_std(linear / turn)).to_degrees(),
        )
    } else {
        // Exactly unpolarised: no slope, but the noise of both components.
        (
            stokes_std[1].hypot(stokes_std[2]) / i,
            (0.5 * angle_std(0.0)).to_degrees(),
        )
    };
    let vector = Vector4::from(stokes);
    EllipsometerReading {
        input,
        camera: SETTINGS.map(|s| (s.camera() * vector)[0]),
        camera_std: SETTINGS.map(|s| std_of(s.camera().into())),
        dolp,
        dolp_std: known.then_some(dolp_std),
        aop_deg,
        aop_std_deg: known.then_some(aop_std_deg),
        stokes,
        stokes_std,
    }
}

#[cfg(test)]
mod tests {
    use super::super::run::{Follow, Shard, StopPolicy, trace, trace_following};
    use super::super::scene::Scene;
    use super::*;
    use crate::model::polarisation::Boundary;

    #[test]
    fn the_six_settings_make_the_six_states() {
        let expected = [
            [1.0, 1.0, 0.0, 0.0],
            [1.0, 0.0, 1.0, 0.0],
            [1.0, -1.0, 0.0, 0.0],
            [1.0, 0.0, -1.0, 0.0],
            [1.0, 0.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, -1.0],
        ];
        for (setting, state) in SETTINGS.iter().zip(expected) {
            let lamp = setting.lamp();
            for (i, x) in state.iter().enumerate() {
                assert!((lamp[i] - x).abs() < 1e-15, "{} {lamp}", setting.name);
            }
        }
    }

    #[test]
    fn the_camera_transmits_its_own_state_and_blocks_the_opposite_one() {
        let seen =
            |camera: usize, lamp: usize| (SETTINGS[camera].camera() * SETTINGS[lamp].lamp())[0];
        for (camera, lamp, share) in [
            (0, 0, 1.0),
            (0, 2, 0.0),
            (1, 1, 1.0),
            (1, 3, 0.0),
            (4, 4, 1.0),
            (4, 5, 0.0),
            (5, 5, 1.0),
            (5, 4, 0.0),
            (0, 4, 0.5),
            (1, 0, 0.5),
        ] {
            assert!(
                (seen(camera, lamp) - share).abs() < 1e-15,
                "{camera} {lamp}"
            );
        }
        // The meaning of a name in the convention of V.
        let left = SETTINGS[4].camera();
        assert!((left[0] - 0.5).abs() < 1e-15 && (left[3] - 0.5).abs() < 1e-15);
        let plates = SETTINGS.map(|s| s.camera_compensator_deg);
        assert_eq!(plates, [0.0, 45.0, 90.0, 135.0, 45.0, 135.0]);
    }

    #[test]
    fn light_along_p_has_one_angle_for_either_sign_of_zero_u() {
        for u in [0.0, -0.0] {
            assert_eq!(aop_deg(&[1.0, -0.5, u, 0.0]), 90.0);
            assert!(aop_deg(&[1.0, 0.5, u, 0.0]).is_sign_positive());
        }
    }

    #[test]
    fn the_angle_of_a_vector_within_its_noise_is_uniform() {
        assert!((angle_std(0.0) - PI / 3f64.sqrt()).abs() < 1e-4);
        assert_eq!(angle_std(f64::NAN), angle_std(0.0));
        // Continuous where the formula changes, and never below the linearised value.
        assert!((angle_std(30.0) * 30.0 - 1.0).abs() < 2e-3);
        for r in [0.1, 0.5, 1.0, 3.0, 10.0, 29.0] {
            assert!(angle_std(r) > angle_std(r + 0.5), "{r}");
            assert!(angle_std(r) < PI / 3f64.sqrt());
        }
        let mut stream =
            crate::trace::rng::RandomStream::new(7, crate::trace::rng::Purpose::Batch, 0);
        for r in [1.0, 3.0] {
            let squares: f64 = (0..200_000)
                .map(|_| {
                    let length = (-2.0 * (1.0 - stream.uniform()).ln()).sqrt();
                    let (s, c) = (2.0 * PI * stream.uniform()).sin_cos();
                    (length * s).atan2(r + length * c).powi(2)
                })
                .sum();
            let drawn = (squares / 200_000.0).sqrt();
            assert!((angle_std(r) / drawn - 1.0).abs() < 0.01, "{r} {drawn}");
        }
    }

    #[test]
    fn gold_changes_linear_light_by_fresnels_equations() {
        let theta = 61f64.to_radians();
        let text = "[light]\ntheta_i_deg = 61.0\nphi_i_deg = 90.0\n[[interface]]\nshape = \"flat\"\n\
                    below = \"Au550\"\n[run]\nphotons = 64\n";
        let scene = Scene::parse(text).unwrap();
        let prepared = scene.prepare(&|_| Err(String::new())).unwrap();
        let totals = trace(&prepared, Shard::WHOLE, &|_| true);
        let points = curve(&totals, 90.0).unwrap();
        let [only] = &points[..] else {
            panic!("a mirror reflects in one direction: {points:?}")
        };
        assert!((only.theta_s_deg - 61.0).abs() < 1e-9);
        // The covariance was not requested, and the point states that.
        assert!(only.errors_as_independent);
        let fresnel = Boundary::new(1.0, 0.3504, 2.7141).at(theta.cos()).reflected;
        let at_45 = &only.readings[1];
        let (i, q) = (0.5 * (fresnel.s + fresnel.p), 0.5 * (fresnel.s - fresnel.p));
        let expected = [1.0, q / i, fresnel.re / i, -fresnel.im / i];
        for (found, e) in at_45.stokes.iter().zip(expected) {
            assert!((found / at_45.stokes[0] - e).abs() < 1e-12, "{at_45:?}");
        }
        assert!((at_45.dolp - expected[1].hypot(expected[2])).abs() < 1e-12);
        // s light remains s light: full polarisation at 0°.
        assert!((only.readings[0].dolp - 1.0).abs() < 1e-12);
        assert!(only.readings[0].aop_deg.abs() < 1e-9);
        assert!((only.readings[2].aop_deg.abs() - 90.0).abs() < 1e-9);
        // Ψ and Δ of r_p/r_s by Fresnel's equations with complex numbers.
        let psi_delta = only.psi_delta;
        assert!(
            (psi_delta.psi_deg - 42.181_140_256_912_46).abs() < 1e-9,
            "{psi_delta:?}"
        );
        assert!(
            (psi_delta.delta_deg - 122.558_464_754_004_15).abs() < 1e-9,
            "{psi_delta:?}"
        );
        assert!((psi_delta.dop - 1.0).abs() < 1e-12, "{psi_delta:?}");
        // Filters along s and along p together transmit all light.
        let camera = &at_45.camera;
        assert!((camera[0] + camera[2] - at_45.stokes[0]).abs() < 1e-12 * camera[0]);
    }

    #[test]
    fn glass_turns_delta_by_half_a_turn_at_brewsters_angle() {
        let at = |theta_i_deg: f64| {
            let text = format!(
                "[light]\ntheta_i_deg = {theta_i_deg}\nphi_i_deg = 180.0\n[[interface]]\nshape = \"flat\"\n\
                 below = {{ n = 1.5 }}\n[run]\nphotons = 64\n"
            );
            let scene = Scene::parse(&text).unwrap();
            let prepared = scene.prepare(&|_| Err(String::new())).unwrap();
            let totals = trace(&prepared, Shard::WHOLE, &|_| true);
            curve(&totals, 180.0).unwrap()[0].psi_delta
        };
        for (theta_i_deg, psi_deg, delta_deg) in [
            (45.0, 16.874_494_297_944_29, 180.0),
            (65.0, 13.409_780_290_604_05, 0.0),
        ] {
            let found = at(theta_i_deg);
            assert!((found.psi_deg - psi_deg).abs() < 1e-7, "{found:?}");
            assert!(
                (found.delta_deg.abs() - delta_deg).abs() < 1e-9,
                "{found:?}"
            );
        }
    }

    #[test]
    fn the_error_of_polarisation_needs_enough_photons_in_a_direction() {
        let text = "[light]\ntheta_i_deg = 45.0\nphi_i_deg = 180.0\n[[interface]]\nshape = \"smith\"\nalpha_u = 0.2\n\
                    alpha_v = 0.2\nbelow = { n = 1.5 }\n[run]\nphotons = 3000\ntheta_bins = 18\nphi_bins = 36\n";
        let points = |photons: u64| {
            let prepared = Scene::parse(text).unwrap().prepare(&|_| Err(String::new()));
            let mut prepared = prepared.unwrap();
            prepared.photons = photons;
            let (follow, ending) = (Follow::Scene, StopPolicy::AtLast);
            let totals = trace_following(&prepared, follow, ending, &|_| true);
            curve(&totals, 180.0).unwrap()
        };
        let (few, many) = (points(20_000), points(200_000));
        let true_state = |at: f64, lamp: usize| {
            let point = many.iter().find(|p| p.theta_s_deg == at);
            point.map(|p| &p.readings[lamp]).filter(|r| r.has_errors())
        };
        let (mut with_error, mut without_error, mut squares) = (0, 0, 0.0);
        for point in &few {
            for (lamp, r) in point.readings.iter().enumerate() {
                assert_eq!(r.has_errors(), r.aop_std_deg.is_some());
                let (Some(std), Some(truth)) = (r.dolp_std, true_state(point.theta_s_deg, lamp))
                else {
                    without_error += 1;
                    continue;
                };
                // Linear light stays almost linear, and at the end of the range of DOLP the error
                // is one-sided.
                if lamp >= 4 {
                    let off = r.dolp - truth.dolp;
                    squares += (off / std.hypot(truth.dolp_std.unwrap())).powi(2);
                    with_error += 1;
                }
            }
        }
        assert!(
            without_error > 0 && with_error > 8,
            "{without_error} {with_error}"
        );
        // Both hands share their photons: about ten directions are independent.
        let rms = (squares / f64::from(with_error)).sqrt();
        assert!((0.4..1.8).contains(&rms), "{rms}");
    }

    #[test]
    fn readings_scatter_over_seeds_by_their_errors() {
        const SEEDS: usize = 40;
        let readings = |below: &str, seed: usize| {
            let text = format!(
                "[light]\ntheta_i_deg = 55.0\nphi_i_deg = 180.0\n[[interface]]\nshape = \"smith\"\nalpha_u = 0.3\n\
                 alpha_v = 0.3\nbelow = {below}\n[run]\nphotons = 8000\nseed = {seed}\ntheta_bins = 9\n\
                 phi_bins = 12\n"
            );
            let prepared = Scene::parse(&text)
                .unwrap()
                .prepare(&|_| Err(String::new()));
            let (follow, ending) = (Follow::Scene, StopPolicy::AtLast);
            let totals = trace_following(&prepared.unwrap(), follow, ending, &|_| true);
            let mut points = curve(&totals, 180.0).unwrap();
            // The bright half: degrees of polarisation from few photons are not linear.
            points.retain(|p| (10.0..80.0).contains(&p.theta_s_deg));
            points
        };
        let runs_on = |below: &str| -> Vec<Vec<EllipsometerPoint>> {
            (1..=SEEDS).map(|seed| readings(below, seed)).collect()
        };
        let (runs, on_gold) = (runs_on("{ n = 1.5 }"), runs_on("\"Au550\""));
        assert!(runs[0].len() == 7 && !runs[0][0].errors_as_independent);
        // Directions with 39 degrees of freedom each: for all 7 a ratio is known to 4.3 %, and 14 %
        // is more than three times that.
        let close = |name: &str, (ratio, directions): (f64, usize)| {
            let within = 0.14 * (7.0 / directions as f64).sqrt();
            assert!((ratio - 1.0).abs() < within, "{name}: {ratio} {directions}");
            directions
        };
        // Mean over directions of (scatter over seeds / stated error)² of a number, and the number of
        // directions with a stated error at every seed.
        type Number<'n> = &'n dyn Fn(&EllipsometerPoint) -> Option<(f64, f64)>;
        let of_all = |runs: &[Vec<EllipsometerPoint>], number: Number<'_>| {
            let n = SEEDS as f64;
            let of = |point: usize| {
                let each = runs.iter().map(|r| number(&r[point]));
                let each: Vec<(f64, f64)> = each.collect::<Option<_>>()?;
                let mean = each.iter().map(|e| e.0).sum::<f64>() / n;
                let scatter = each.iter().map(|e| (e.0 - mean).powi(2)).sum::<f64>() / (n - 1.0);
                let stated = each.iter().map(|e| e.1 * e.1).sum::<f64>() / n;
                // Numbers that are exactly zero, for example circular light from light along s
                // reflected off glass.
                Some(if scatter == 0.0 && stated == 0.0 {
                    1.0
                } else {
                    scatter / stated
                })
            };
            let found: Vec<f64> = (0..7).filter_map(of).collect();
            let mean = found.iter().sum::<f64>() / found.len() as f64;
            (mean.sqrt(), found.len())
        };
        let ratio = |lamp: usize, number: &dyn Fn(&EllipsometerReading) -> Option<(f64, f64)>| {
            of_all(&runs, &|point| number(&point.readings[lamp]))
        };
        let [psi, delta, dop]: [Number<'_>; 3] = [
            &|p| Some((p.psi_delta.psi_deg, p.psi_delta.psi_std_deg?)),
            &|p| Some((p.psi_delta.delta_deg, p.psi_delta.delta_std_deg?)),
            &|p| Some((p.psi_delta.dop, p.psi_delta.dop_std?)),
        ];
        for (name, number) in [
            ("psi", psi),
            ("delta", delta),
            ("degree of polarisation", dop),
        ] {
            assert!(close(name, of_all(&on_gold, number)) > 3);
        }
        for lamp in 0..SETTINGS.len() {
            for i in 0..4 {
                let found = ratio(lamp, &|r| Some((r.stokes[i], r.stokes_std[i])));
                close(&format!("{lamp} S{i}"), found);
            }
            let crossed = ratio(lamp, &|r| {
                let camera = (lamp + 2) % 4;
                Some((r.camera[camera], r.camera_std[camera]))
            });
            close(&format!("{lamp} camera"), crossed);
            let dolp = ratio(lamp, &|r| Some((r.dolp, r.dolp_std?)));
            // At Brewster's angle almost no light along p is reflected.
            if dolp.1 > 0 || lamp != 2 {
                close(&format!("{lamp} DOLP"), dolp);
            }
        }
        for lamp in [1, 3] {
            let aop = ratio(lamp, &|r| Some((r.aop_deg, r.aop_std_deg?)));
            assert!(close(&format!("{lamp} AOP"), aop) > 3);
        }
    }
}
