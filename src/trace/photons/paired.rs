//! Polarised light and scalar light on the same path.
//!
//! The difference of a polarised and a scalar computation is small where it matters; the noise of
//! two separate runs would hide it. [`Paired`] carries both on one path, so that their common noise
//! cancels in the difference. Branches are drawn by the mean of both probabilities, so that neither
//! weight can exceed twice its fraction: each of the two results is unbiased.

use pulp::Simd;

use super::light::{ELEMENTS_MAX, Leaving, PhotonState, Polarised, ScalarState, Turn};
use crate::model::lanes::Lane;
use crate::model::polarisation::Channel;
use crate::trace::vec3::V3;

/// A Mueller matrix and a scalar weight. A bin holds the matrix, the scalar, and m00 minus the
/// scalar (which gives its standard error although both are strongly correlated).
#[derive(Debug, Clone, Copy)]
pub struct Paired {
    polarised: Polarised,
    scalar: ScalarState,
}

/// Index of the scalar weight in a bin.
pub const SCALAR: usize = Polarised::ELEMENTS;
/// Index of m00 minus the scalar weight.
pub const DIFFERENCE: usize = SCALAR + 1;

impl PhotonState for Paired {
    const ELEMENTS: usize = DIFFERENCE + 1;

    fn launch(s: &V3) -> Self {
        Paired {
            polarised: Polarised::launch(s),
            scalar: ScalarState::launch(s),
        }
    }
    #[inline]
    fn weight(&self) -> f64 {
        0.5 * (self.polarised.weight() + self.scalar.weight())
    }
    #[inline]
    fn power(&self, stokes: &[f64; 4]) -> f64 {
        self.polarised.power(stokes)
    }
    #[inline]
    fn meet(&mut self, k: &V3, m: &V3) {
        self.polarised.meet(k, m);
    }
    #[inline]
    fn share(&self, channel: &Channel) -> f64 {
        0.5 * (self.polarised.share(channel) + self.scalar.share(channel))
    }
    #[inline]
    fn pass(&mut self, channel: &Channel, factor: f64) {
        self.polarised.pass(channel, factor);
        self.scalar.pass(channel, factor);
    }
    fn depolarise(&mut self, s: &V3) {
        self.polarised.depolarise(s);
    }
    #[inline]
    fn scale(&mut self, factor: f64) {
        self.polarised.scale(factor);
        self.scalar.scale(factor);
    }
    #[inline]
    fn leave(&mut self, k: &V3, straight: &V3) {
        self.polarised.leave(k, straight);
    }
    #[inline]
    fn turn(&mut self, turn: &Turn) {
        self.polarised.turn(turn);
    }
    #[inline]
    fn add_to(&self, bin: &mut [f64]) {
        self.polarised.add_to(&mut bin[..SCALAR]);
        self.scalar.add_to(&mut bin[SCALAR..DIFFERENCE]);
        bin[DIFFERENCE] += self.polarised.weight() - self.scalar.weight();
    }
    #[inline(always)]
    fn leaves_each<S: Simd>(hits: &Leaving<S>, numbers: &mut [Lane<S>; ELEMENTS_MAX]) -> Lane<S> {
        ScalarState::leaves_each(hits, numbers);
        let scalar = numbers[0];
        let power = Polarised::leaves_each(hits, numbers);
        numbers[SCALAR] = scalar;
        numbers[DIFFERENCE] = numbers[0] - scalar;
        power
    }
}
