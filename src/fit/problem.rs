//! The observation model and its parameters.
//!
//! ```text
//! sample   signal = g · [factor · L(θc + Δθc, φs + Δφs; η, k) + correction] + B
//! flat     signal = g · ρw/π · cos θi(θc + Δθc) + B
//! priors   B, η, k as stated
//! ```
//!
//! L is the radiance of the variant and g the gain of the signals (1 if the white reference is exact; the flats
//! determine it). B is the stray light in samples and flats; Δθc and Δφs are the zeros of the stages. B always has a
//! prior, because the sample alone leaves it nearly collinear with the diffuse term. The index is fitted within its
//! uncertainty, so that data which cannot separate it from the diffuse term do not move it. The certificate of the
//! white reference is not fitted. The corrections are fixed numbers per observation: the effect of a costlier tier on
//! the closed form, as a factor and as an added radiance.
//!
//! Inside, θr is signed and the roughnesses are logarithms. The fit may pass through θr = 0 and continues as (−θr, φs +
//! 180°), which is the same surface.

mod residuals;

use std::f64::consts::PI;
use std::sync::Arc;

use nalgebra::Vector3;

use super::known::priors;
use super::loss::Loss;
pub use super::quantity::{Quantity, Values};
use super::solver::Bounds;
use crate::geometry::Directions;
use crate::material::Material;
use crate::model::extended::slopes::TAIL_MAX;
use crate::model::extended::{self, CREST_MAX, Real, Terms, Walls};
use crate::model::prepared::{OpticsTable, Partials, Prepared};
use crate::model::views::{Rotation, Views};
use crate::model::{Gradient, Optics, Surface, Variant};
use crate::observation::{ObservationSet, Prior, View};
use crate::units::Angle;

/// Smallest and largest gain as multiples of the brightest signal. Without a limit, a lobe that all poses miss by far
/// could be scaled up until its skirt equals the signal. The fit's form of the model is 0 from 43 decades below the top
/// of a lobe; for the narrowest lobe this limit stays a share of 1e-12 of the brightest signal.
const GAIN: (f64, f64) = (1e-12, 1e24);
/// Steepest ridge that a fit considers, rad.
pub const THETA_R_MAX: f64 = 75.0 * PI / 180.0;
/// Smoothest facet that a fit considers.
pub const ALPHA_MIN: f64 = 1e-4;
/// Largest zero of the tilt that a fit considers, rad.
pub const TILT_OFFSET_MAX: f64 = 15.0 * PI / 180.0;
/// Roughest facet that a fit considers.
pub const ALPHA_MAX: f64 = 2.0;

/// A least-squares problem: a set of observations, a variant, weights and the free quantities.
#[derive(Debug, Clone)]
pub struct Problem<'a> {
    set: &'a ObservationSet,
    variant: Variant,
    free: Vec<Quantity>,
    fixed: Values,
    sigma: Vec<f64>,
    flat_sigma: Vec<f64>,
    factor: Vec<f64>,
    correction: Vec<f64>,
    optics: OpticsTable,
    priors: Vec<(Quantity, Prior)>,
    /// Priors of the user, in addition to the certificates.
    stated: Vec<(Quantity, Prior)>,
    loss: Loss,
    lean: bool,
    polarised: bool,
    /// Walls of a surface that deviates from an ideal sawtooth; without them those terms are omitted.
    walls: Option<Arc<Walls>>,
    /// Sines and cosines of the recorded poses: (θc, φs with the known zeros), one per observation.
    poses: Vec<[(f64, f64); 2]>,
    /// The views of observations that average over several; empty if none does.
    views: Arc<[Views]>,
}

/// The model at one set of values, prepared for every observation.
#[derive(Debug, Clone, Copy)]
pub struct Ready {
    prepared: Prepared,
    surface: Surface,
    real: Real,
    mirrored: bool,
    ridge: (f64, f64),
    tilt: (f64, f64),
    turn: (f64, f64),
    lamp: [f64; 3],
}

impl<'a> Problem<'a> {
    /// Makes a problem with the uncertainties of the observations and no correction; `fixed` has the values of all
    /// quantities that are not free.
    #[must_use]
    pub fn new(
        set: &'a ObservationSet,
        variant: Variant,
        free: Vec<Quantity>,
        fixed: Values,
    ) -> Self {
        Problem {
            variant,
            priors: priors(set, &free, &[]),
            stated: Vec::new(),
            loss: Loss::Linear,
            lean: false,
            polarised: true,
            walls: None,
            free,
            fixed,
            sigma: set.observations.iter().map(|o| o.sigma).collect(),
            flat_sigma: set.flats.iter().map(|f| f.sigma).collect(),
            factor: vec![1.0; set.observations.len()],
            correction: vec![0.0; set.observations.len()],
            optics: OpticsTable::new(&Optics::new(&set.rig, &set.material)),
            poses: set
                .observations
                .iter()
                .map(|o| {
                    let azimuth = o.pose.phi_s + set.rig.azimuth_zero + set.region_azimuth;
                    [o.pose.theta_c.sin_cos(), azimuth.sin_cos()]
                })
                .collect(),
            views: views(set),
            set,
        }
    }

    /// Sets other free quantities.
    #[must_use]
    pub fn with_free(mut self, free: Vec<Quantity>) -> Self {
        self.priors = priors(self.set, &free, &self.stated);
        self.free = free;
        self
    }

    /// Holds the index at its nominal value.
    pub(super) fn with_nominal_index(&self) -> Self {
        let free = self.free.iter().copied();
        let free = free.filter(|q| !matches!(q, Quantity::Eta | Quantity::K));
        self.clone().with_free(free.collect())
    }

    /// Sets other values of the quantities that are not free.
    #[must_use]
    pub fn with_fixed(mut self, fixed: Values) -> Self {
        self.fixed = fixed;
        self
    }

    /// Removes the priors of some quantities: another problem, solved together with this one, contains them.
    #[must_use]
    pub fn without_priors(mut self, of: &[Quantity]) -> Self {
        self.stated.retain(|(q, _)| !of.contains(q));
        self.priors.retain(|(q, _)| !of.contains(q));
        self
    }

    /// Sets priors of the user in natural units: angles in radians, θr ≥ 0, roughness itself. Priors on quantities that
    /// are not free are ignored.
    #[must_use]
    pub fn with_priors(mut self, stated: &[(Quantity, Prior)]) -> Self {
        self.stated = stated.to_vec();
        self.priors = priors(self.set, &self.free, &self.stated);
        self
    }

    /// Sets the loss of the sample residuals.
    #[must_use]
    pub fn with_loss(mut self, loss: Loss) -> Self {
        self.loss = loss;
        self
    }

    /// Selects the cheaper form of the closed form for finding the lobe.
    #[must_use]
    pub fn with_lean(mut self, lean: bool) -> Self {
        self.lean = lean;
        self
    }

    /// Returns the same problem for a series drawn from it: `set` differs only in its signals, and the means of the
    /// priors are drawn around `values` with `normal`.
    #[must_use]
    pub fn drawn<'s>(
        &self,
        set: &'s ObservationSet,
        values: &Values,
        normal: &mut dyn FnMut() -> f64,
    ) -> Problem<'s>
    where
        'a: 's,
    {
        let mut problem: Problem<'s> = self.clone();
        problem.set = set;
        for (quantity, prior) in &mut problem.priors {
            prior.mean = values.natural(*quantity) + prior.std * normal();
        }
        problem
    }

    /// Sets other standard uncertainties of the observations.
    #[must_use]
    pub fn with_sigma(mut self, sigma: Vec<f64>) -> Self {
        self.sigma = sigma;
        self
    }

    /// Sets other standard uncertainties of the flats.
    #[must_use]
    pub fn with_flat_sigma(mut self, sigma: Vec<f64>) -> Self {
        self.flat_sigma = sigma;
        self
    }

    /// Sets radiances to add to the closed form, one per observation.
    #[must_use]
    pub fn with_correction(mut self, correction: Vec<f64>) -> Self {
        self.correction = correction;
        self
    }

    /// Selects physical light, or light without polarisation as in a renderer.
    #[must_use]
    pub fn with_polarisation(mut self, polarised: bool) -> Self {
        self.polarised = polarised;
        self
    }

    /// Allows deviations from an ideal sawtooth ([`crate::model::extended`]). The roughness of the walls is that of the
    /// given values and stays fixed while the values move.
    #[must_use]
    pub fn with_walls_of(mut self, values: &Values) -> Self {
        let mut surface = values.surface();
        surface.theta_r = surface.theta_r.abs();
        let walls = Walls::new(&surface, &values.real, &self.optics(values));
        self.walls = Some(Arc::new(walls));
        self
    }

    /// Whether deviations from an ideal sawtooth are allowed.
    #[must_use]
    pub fn is_extended(&self) -> bool {
        self.walls.is_some()
    }

    /// Whether the correction of the closed form follows polarisation from one facet to the next.
    #[must_use]
    pub fn is_polarised(&self) -> bool {
        self.polarised
    }

    /// Sets factors of the closed form, applied before the correction, one per observation.
    #[must_use]
    pub fn with_factor(mut self, factor: Vec<f64>) -> Self {
        self.factor = factor;
        self
    }

    /// The observations.
    #[must_use]
    pub fn set(&self) -> &'a ObservationSet {
        self.set
    }

    /// The closed form.
    #[must_use]
    pub fn variant(&self) -> Variant {
        self.variant
    }

    /// The free quantities in the order of the solver.
    #[must_use]
    pub fn free(&self) -> &[Quantity] {
        &self.free
    }

    /// Standard uncertainties that divide the sample residuals.
    #[must_use]
    pub fn sigma(&self) -> &[f64] {
        &self.sigma
    }

    /// Standard uncertainties that divide the flat residuals.
    #[must_use]
    pub fn flat_sigma(&self) -> &[f64] {
        &self.flat_sigma
    }

    /// Number of residuals: samples, flats, priors.
    #[must_use]
    pub fn residual_count(&self) -> usize {
        self.set.observations.len() + self.set.flats.len() + self.priors.len()
    }

    /// Free quantities with a prior, in the order of their residuals.
    #[must_use]
    pub fn priors(&self) -> &[(Quantity, Prior)] {
        &self.priors
    }

    /// Priors of the user, in addition to the certificates.
    #[must_use]
    pub fn stated(&self) -> &[(Quantity, Prior)] {
        &self.stated
    }

    /// The optics at the nominal index.
    pub(super) fn nominal_optics(&self) -> &OpticsTable {
        &self.optics
    }

    /// Returns the optics of the model at given values.
    #[must_use]
    pub fn optics(&self, values: &Values) -> OpticsTable {
        let nominal = self.optics.optics;
        if values.eta == nominal.eta && values.k == nominal.k {
            return self.optics;
        }
        OpticsTable::new(&Optics {
            eta: values.eta,
            k: values.k,
            ..nominal
        })
    }

    /// Converts values to the vector of the solver.
    #[must_use]
    pub fn pack(&self, values: &Values) -> Vec<f64> {
        self.free.iter().map(|q| values.inner(*q)).collect()
    }

    /// Converts a vector of the solver to all values.
    #[must_use]
    pub fn unpack(&self, x: &[f64]) -> Values {
        let mut values = self.fixed;
        for (q, v) in self.free.iter().zip(x) {
            values.set_inner(*q, *v);
        }
        values
    }

    /// The bounds of the solver.
    #[must_use]
    pub fn bounds(&self) -> Bounds {
        let (eta, k) = self.set.material.index();
        let signals = self.set.observations.iter().map(|o| o.signal.abs());
        let brightest = signals.fold(0.0, f64::max);
        let range = |q: &Quantity| match q {
            // If the azimuth is held, θr cannot change its sign.
            Quantity::ThetaR if !self.free.contains(&Quantity::AzimuthOffset) => (0.0, THETA_R_MAX),
            Quantity::ThetaR => (-THETA_R_MAX, THETA_R_MAX),
            Quantity::AlphaU | Quantity::AlphaV => (ALPHA_MIN.ln(), ALPHA_MAX.ln()),
            // The amplitude of the printed lobe, A = F + (ρd/π)(1 − F)², stays positive. Its ρd may exceed 1, which
            // shows that the variant does not describe the sample.
            Quantity::RhoD => match self.variant {
                Variant::Paper => {
                    let f = normal_reflectance(eta, k);
                    (-0.99 * PI * f / ((1.0 - f) * (1.0 - f)), 1e3)
                }
                // Not 0, where the model omits the diffuse terms and their derivatives.
                Variant::Sawtooth => (1e-9, 1.0),
            },
            // In the unit of the signals.
            Quantity::Scale => {
                let unit = brightest.max(f64::MIN_POSITIVE);
                (GAIN.0 * unit, GAIN.1 * unit)
            }
            Quantity::Background | Quantity::AzimuthOffset => (f64::NEG_INFINITY, f64::INFINITY),
            Quantity::Eta => (0.01, f64::INFINITY),
            Quantity::K => (0.0, f64::INFINITY),
            Quantity::TiltOffset => (-TILT_OFFSET_MAX, TILT_OFFSET_MAX),
            Quantity::Translucency => (0.0, 1.0),
            Quantity::Tail => (0.0, TAIL_MAX),
            Quantity::CrestRadius => (0.0, CREST_MAX),
        };
        let (lower, upper) = self.free.iter().map(range).unzip();
        Bounds { lower, upper }
    }

    /// Prepares everything that does not depend on the pose, for [`Problem::gradient`].
    #[must_use]
    pub fn ready(&self, values: &Values) -> Ready {
        let mut surface = values.surface();
        let mut azimuth = values.azimuth_offset;
        let mirrored = surface.theta_r < 0.0;
        if mirrored {
            surface.theta_r = -surface.theta_r;
            azimuth += PI;
        }
        let mut prepared = Prepared::new(self.variant, &surface, &self.optics(values));
        if self.lean {
            prepared = prepared.lean();
        }
        let (sl, cl) = self.set.rig.theta_l.sin_cos();
        let (sa, ca) = self.set.rig.light_azimuth.sin_cos();
        Ready {
            prepared: match self.set.material {
                Material::Conductor { .. } => prepared.opaque(),
                Material::Dielectric { .. } => prepared,
            },
            surface,
            real: values.real,
            mirrored,
            ridge: surface.theta_r.sin_cos(),
            tilt: values.tilt_offset.sin_cos(),
            turn: azimuth.sin_cos(),
            lamp: [cl, sl * ca, sl * sa],
        }
    }

    /// Computes the directions of one observation in the sample frame, and sine and cosine of v's azimuth. They equal
    /// those of [`crate::geometry::RigGeometry::directions`]; the offsets are added by the angle sums. An observation
    /// with one view uses the view; one with several views uses the centre of the rig.
    #[must_use]
    pub fn directions(&self, index: usize, ready: &Ready) -> (Directions, f64, f64) {
        if let Some([view]) = self.set.views.get(index).map(Vec::as_slice) {
            return self.of_view(index, ready, &view.directions);
        }
        let [(st, ct), _] = self.poses[index];
        let (so, co) = ready.tilt;
        let (s, c) = (st * co + ct * so, ct * co - st * so);
        let [along, inside, beside] = ready.lamp;
        let incident = Vector3::new(along * s + inside * c, beside, along * c - inside * s);
        self.on_sample(index, ready, incident, Vector3::new(s, 0.0, c))
    }

    /// The same for one view of an observation.
    fn of_view(&self, index: usize, ready: &Ready, view: &Directions) -> (Directions, f64, f64) {
        let (so, co) = ready.tilt;
        // The tilt rotates (x, y, z) about +y towards +x.
        let tilted = |w: Vector3<f64>| Vector3::new(w.x * co + w.z * so, w.y, w.z * co - w.x * so);
        self.on_sample(index, ready, tilted(view.incident), tilted(view.outgoing))
    }

    /// Rotates rig directions at the true tilt into the sample frame of observation `index`.
    fn on_sample(
        &self,
        index: usize,
        ready: &Ready,
        incident: Vector3<f64>,
        outgoing: Vector3<f64>,
    ) -> (Directions, f64, f64) {
        let (sin, cos) = self.azimuth(index, ready);
        let turned =
            |w: Vector3<f64>| Vector3::new(w.x * sin - w.y * cos, w.x * cos + w.y * sin, w.z);
        let directions = Directions {
            incident: turned(incident),
            outgoing: turned(outgoing),
        };
        (directions, sin, cos)
    }

    /// Sine and cosine of the azimuth of v.
    fn azimuth(&self, index: usize, ready: &Ready) -> (f64, f64) {
        let [_, (sp, cp)] = self.poses[index];
        let (so, co) = ready.turn;
        (sp * co + cp * so, cp * co - sp * so)
    }

    /// Computes the radiance of one observation with all derivatives, for either sign of θr. For a near camera this is
    /// the weighted sum over the views.
    #[must_use]
    pub fn gradient(&self, index: usize, ready: &Ready) -> Gradient {
        let mut g = match (self.set.views.get(index), self.views.get(index)) {
            (Some(_), Some(views)) if self.walls.is_none() => {
                let rotation = Rotation {
                    tilt: ready.tilt,
                    turn: self.azimuth(index, ready),
                };
                ready.prepared.over_views(views, rotation)
            }
            (Some(views), _) => {
                let mut sum = Gradient::ZERO;
                for view in views {
                    let (directions, sin, cos) = self.of_view(index, ready, &view.directions);
                    let one = self.partials(&directions, ready);
                    sum.add(view.weight, &one.on_rig(&directions, sin, cos));
                }
                sum
            }
            (None, _) => {
                let (directions, sin, cos) = self.directions(index, ready);
                self.partials(&directions, ready)
                    .on_rig(&directions, sin, cos)
            }
        };
        if ready.mirrored {
            g.theta_r = -g.theta_r;
        }
        g
    }

    /// The same for one pair of directions, θr ≥ 0.
    fn partials(&self, directions: &Directions, ready: &Ready) -> Partials {
        let Some(walls) = &self.walls else {
            return ready.prepared.partials(directions);
        };
        let free = |q: Quantity| self.free.contains(&q);
        let terms = Terms::of(
            &ready.real,
            ready.prepared.optics(),
            free(Quantity::Tail),
            free(Quantity::CrestRadius),
        );
        extended::partials(
            directions,
            &ready.surface,
            &ready.real,
            terms,
            ready.prepared.optics(),
            walls,
        )
    }

    /// [`Problem::gradient`] with factor and correction of the costlier tier.
    #[must_use]
    pub fn corrected(&self, index: usize, ready: &Ready) -> Gradient {
        let mut g = Gradient::ZERO;
        g.add(self.factor[index], &self.gradient(index, ready));
        g.value += self.correction[index];
        g
    }

    /// Radiance in the directions of [`Problem::directions`] only, without the views.
    #[must_use]
    pub fn at_centre(&self, index: usize, ready: &Ready) -> f64 {
        let directions = self.directions(index, ready).0;
        self.partials(&directions, ready).value
    }

    /// The same for an ideal sawtooth with these walls.
    #[must_use]
    pub fn ideal_at_centre(&self, index: usize, ready: &Ready) -> f64 {
        let ideal = Ready {
            real: Real::NONE,
            ..*ready
        };
        self.at_centre(index, &ideal)
    }

    /// Cosines between lamp or camera and the normals of facet, riser and pitch, in the directions of
    /// [`Problem::directions`].
    pub(super) fn wall_cosines(&self, index: usize, ready: &Ready) -> [f64; 6] {
        let directions = self.directions(index, ready).0;
        let (s, c) = ready.ridge;
        let of = |w: Vector3<f64>| [w.y * s + w.z * c, w.z * s - w.y * c, w.z];
        let ([a, b, d], [e, f, g]) = (of(directions.incident), of(directions.outgoing));
        [a, b, d, e, f, g]
    }

    /// Sample signals that the model expects.
    #[must_use]
    pub fn predicted(&self, values: &Values) -> Vec<f64> {
        let ready = self.ready(values);
        (0..self.set.observations.len())
            .map(|i| values.scale * self.corrected(i, &ready).value + values.background)
            .collect()
    }

    /// Returns the same problem for a rig with the lamp at another place; `set` must differ in nothing else.
    pub(super) fn seen_by<'s>(&self, set: &'s ObservationSet) -> Problem<'s>
    where
        'a: 's,
    {
        Problem {
            set,
            views: views(set),
            ..self.clone()
        }
    }

    /// Cosine of the incidence on the white reference at flat `index`, and its derivative with respect to the tilt.
    #[must_use]
    pub fn flat_cosine(&self, index: usize, values: &Values) -> (f64, f64) {
        let tilt = self.set.flats[index].theta_c + Angle::from_rad(values.tilt_offset);
        self.set.rig.cos_incidence_and_slope(tilt)
    }

    /// Signal of the white reference that the model expects at flat `index`.
    #[must_use]
    pub fn flat_signal(&self, index: usize, values: &Values) -> f64 {
        let cosine = self.flat_cosine(index, values).0;
        values.scale * self.reflectance() / PI * cosine + values.background
    }

    /// Whether this is a least-squares problem of a far rig without corrections.
    pub(super) fn is_plain(&self) -> bool {
        self.set.views.is_empty()
            && self.loss == Loss::Linear
            && self.factor.iter().all(|f| *f == 1.0)
            && self.correction.iter().all(|c| *c == 0.0)
            && self.walls.is_none()
    }

    /// Sines and cosines of the recorded tilts and azimuths, including the known zeros.
    pub(super) fn poses(&self) -> &[[(f64, f64); 2]] {
        &self.poses
    }

    /// Reflectance of the white reference; 1 without one.
    pub(super) fn reflectance(&self) -> f64 {
        self.set.white_reference.map_or(1.0, |w| w.reflectance)
    }
}

/// The views of a set by columns, where there are several of an observation.
fn views(set: &ObservationSet) -> Arc<[Views]> {
    if set.views.iter().all(|views| views.len() < 2) {
        return Arc::default();
    }
    let of = |views: &Vec<View>| {
        let views: Vec<_> = views.iter().map(|v| (v.directions, v.weight)).collect();
        Views::new(&views)
    };
    set.views.iter().map(of).collect()
}

/// Fresnel reflectance at normal incidence; within 1e-4 of that at 5°.
fn normal_reflectance(eta: f64, k: f64) -> f64 {
    ((eta - 1.0).powi(2) + k * k) / ((eta + 1.0).powi(2) + k * k)
}

#[cfg(test)]
#[path = "problem_tests.rs"]
mod tests;
