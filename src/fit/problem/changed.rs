//! The same problem with other free quantities, priors, weights, corrections or terms.

use std::sync::Arc;

use super::{Problem, Quantity, Values, views};
use crate::fit::known::priors;
use crate::fit::loss::Loss;
use crate::model::extended::Walls;
use crate::observation::{ObservationSet, Prior};

impl<'a> Problem<'a> {
    /// Sets other free quantities.
    #[must_use]
    pub fn with_free(mut self, free: Vec<Quantity>) -> Self {
        self.priors = priors(self.set, &free, &self.stated);
        self.free = free;
        self
    }

    /// Holds the index at its nominal value.
    pub(in crate::fit) fn with_nominal_index(&self) -> Self {
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

    /// Omits the facets' reflection.
    #[must_use]
    pub fn without_lobe(mut self) -> Self {
        self.lobe = false;
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

    /// Returns the same problem for other signals of the same poses and flats.
    pub(in crate::fit) fn with_signals_of<'s>(&self, set: &'s ObservationSet) -> Problem<'s>
    where
        'a: 's,
    {
        let mut problem: Problem<'s> = self.clone();
        problem.set = set;
        problem
    }

    /// Returns the same problem for a rig with the lamp at another place; `set` must differ in nothing else.
    pub(in crate::fit) fn seen_by<'s>(&self, set: &'s ObservationSet) -> Problem<'s>
    where
        'a: 's,
    {
        Problem {
            set,
            views: views(set),
            ..self.clone()
        }
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

    /// Sets factors of the closed form, applied before the correction, one per observation.
    #[must_use]
    pub fn with_factor(mut self, factor: Vec<f64>) -> Self {
        self.factor = factor;
        self
    }
}
