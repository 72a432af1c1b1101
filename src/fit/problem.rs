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
//! white reference is not fitted. The corrections are fixed numbers per observation: the effect of a higher order on
//! the closed form, as a factor and as an added radiance.
//!
//! A wedge (the sample is tilted across v) rotates both directions about v; a turned lamp moves about the camera's axis
//! ([`alignment`]). Only problems with walls have them free: elsewhere the azimuth stands for a wedge, to first order
//! ([`super::causes::wedge`]).
//!
//! Inside, θr is signed and the roughnesses are logarithms. The fit may pass through θr = 0 and continues as (−θr, φs +
//! 180°), which is the same surface.

mod alignment;
mod bounds;
mod changed;
mod residuals;

use std::f64::consts::PI;
use std::sync::Arc;

use nalgebra::Vector3;

use self::alignment::{Alignment, lamp_rate};
use super::known::priors;
use super::loss::Loss;
pub use super::quantity::{Quantity, Values};
use crate::geometry::Directions;
use crate::material::Material;
use crate::model::extended::{self, Real, Terms, Walls};
use crate::model::prepared::{OpticsTable, Partials, Prepared};
use crate::model::views::{Rotation, Views};
use crate::model::{Gradient, Optics, Surface, Variant};
use crate::observation::{ObservationSet, Prior, View};
use crate::units::Angle;
pub use bounds::{ALPHA_MAX, ALPHA_MIN, THETA_R_MAX, TILT_OFFSET_MAX};

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
    polarised: bool,
    /// Whether the facets reflect.
    lobe: bool,
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
    alignment: Alignment,
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
            polarised: true,
            lobe: true,
            walls: None,
            free,
            fixed,
            sigma: set.sigma(),
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

    /// The column of a quantity in the vector of the solver and in the derivatives; `None` if it is not free.
    #[must_use]
    pub fn column(&self, quantity: Quantity) -> Option<usize> {
        self.free.iter().position(|q| *q == quantity)
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

    /// Prepares everything that does not depend on the pose, for [`Problem::gradient`].
    #[must_use]
    pub fn ready(&self, values: &Values) -> Ready {
        let mut surface = values.surface();
        let (mut azimuth, mut wedge) = (values.azimuth_offset, values.wedge);
        let mirrored = surface.theta_r < 0.0;
        if mirrored {
            surface.theta_r = -surface.theta_r;
            azimuth += PI;
            wedge = -wedge;
        }
        if !self.lobe {
            surface.amplitude = 0.0;
        }
        let prepared = Prepared::new(self.variant, &surface, &self.optics(values));
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
            alignment: Alignment::new(wedge, values.lamp_turn),
            lamp: [cl, sl * ca, sl * sa],
        }
    }

    /// Computes the directions of one observation in the sample frame. Without a wedge they equal those of
    /// [`crate::geometry::RigGeometry::directions`]; the offsets are added by the angle sums. An observation with one view
    /// uses the view; one with several views uses the centre of the rig.
    #[must_use]
    pub fn directions(&self, index: usize, ready: &Ready) -> Directions {
        ready.alignment.on_wedge(&self.centre(index, ready).0)
    }

    /// The same in the turntable's plane, with sine and cosine of v's azimuth.
    fn centre(&self, index: usize, ready: &Ready) -> (Directions, f64, f64) {
        if let Some([view]) = self.set.views.get(index).map(Vec::as_slice) {
            return self.of_view(index, ready, &view.directions);
        }
        let [(st, ct), _] = self.poses[index];
        let (so, co) = ready.tilt;
        let (s, c) = (st * co + ct * so, ct * co - st * so);
        let [along, inside, beside] = ready.lamp;
        let incident = Vector3::new(along * s + inside * c, beside, along * c - inside * s);
        self.on_table(index, ready, incident, Vector3::new(s, 0.0, c))
    }

    /// The same for one view of an observation.
    fn of_view(&self, index: usize, ready: &Ready, view: &Directions) -> (Directions, f64, f64) {
        let (so, co) = ready.tilt;
        // The tilt rotates (x, y, z) about +y towards +x.
        let tilted = |w: Vector3<f64>| Vector3::new(w.x * co + w.z * so, w.y, w.z * co - w.x * so);
        self.on_table(index, ready, tilted(view.incident), tilted(view.outgoing))
    }

    /// Rotates rig directions at the true tilt into the turntable's plane of observation `index`.
    fn on_table(
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
        (ready.alignment.with_lamp(directions), sin, cos)
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
                    let seen = self.of_view(index, ready, &view.directions);
                    sum.add(view.weight, &self.seen(seen, ready));
                }
                sum
            }
            (None, _) => self.seen(self.centre(index, ready), ready),
        };
        if ready.mirrored {
            g.theta_r = -g.theta_r;
            g.wedge = -g.wedge;
        }
        g
    }

    /// The same for one pair of directions in the turntable's plane, θr ≥ 0.
    fn seen(&self, (directions, sin, cos): (Directions, f64, f64), ready: &Ready) -> Gradient {
        let partials = self.partials(&ready.alignment.on_wedge(&directions), ready);
        let partials = ready.alignment.off_wedge(partials);
        let mut g = partials.on_rig(&directions, sin, cos);
        g.lamp_turn = lamp_rate(&directions).dot(&Vector3::from(partials.incident));
        g
    }

    /// Computes radiance and derivatives for one pair of directions in the sample frame.
    fn partials(&self, directions: &Directions, ready: &Ready) -> Partials {
        let Some(walls) = &self.walls else {
            return ready.prepared.partials(directions);
        };
        let free = |q: Quantity| self.free.contains(&q);
        let terms = Terms::of(
            &ready.real,
            ready.prepared.optics(),
            &Real {
                translucency: free(Quantity::Translucency),
                tail: free(Quantity::Tail),
                crest: free(Quantity::CrestRadius),
                land: free(Quantity::Land),
            },
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

    /// [`Problem::gradient`] with factor and correction of the higher order.
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
        let directions = self.directions(index, ready);
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
        let directions = self.directions(index, ready);
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

    /// Model minus observation, one per observation, in the unit of the signals.
    #[must_use]
    pub fn signal_residuals(&self, values: &Values) -> Vec<f64> {
        let pairs = self.predicted(values).into_iter();
        let pairs = pairs.zip(&self.set.observations);
        pairs.map(|(p, o)| p - o.signal).collect()
    }

    /// Cosine of the incidence on the white reference at flat `index`, and its derivatives with respect to the tilt and the
    /// turn of the lamp.
    #[must_use]
    pub fn flat_cosine(&self, index: usize, values: &Values) -> [f64; 3] {
        let tilt = self.set.flats[index].theta_c + Angle::from_rad(values.tilt_offset);
        let alignment = Alignment::new(0.0, values.lamp_turn);
        let seen = alignment.with_lamp(self.set.rig.rig_directions(tilt));
        // Tilting rotates (x, y, z) about +y at the rate (z, 0, −x).
        [seen.incident.z, -seen.incident.x, lamp_rate(&seen).z]
    }

    /// Signal of the white reference that the model expects at flat `index`.
    #[must_use]
    pub fn flat_signal(&self, index: usize, values: &Values) -> f64 {
        let [cosine, ..] = self.flat_cosine(index, values);
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

#[cfg(test)]
#[path = "problem_tests.rs"]
mod tests;
