//! Light of an unpolarised lamp: one Stokes vector instead of a Mueller matrix.
//!
//! If the lamp is unpolarised and the camera insensitive to polarisation, the next bounces need
//! only the first column of the Mueller matrix, at a quarter of the work.

use pulp::Simd;

use super::light::{ELEMENTS_MAX, Leaving, PhotonState, Turn};
use crate::model::lanes::Lane;
use crate::model::polarisation::Channel;
use crate::trace::vec3::V3;

/// The Stokes vector (I, Q, U, V) of light that was launched unpolarised with I = 1, and s of its
/// frame. Signs are those of [`crate::model::polarisation`].
#[derive(Debug, Clone, Copy)]
pub struct StokesState {
    i: f64,
    q: f64,
    u: f64,
    v: f64,
    s: V3,
}

impl PhotonState for StokesState {
    const ELEMENTS: usize = 4;

    fn launch(s: &V3) -> Self {
        StokesState {
            i: 1.0,
            q: 0.0,
            u: 0.0,
            v: 0.0,
            s: *s,
        }
    }

    fn weight(&self) -> f64 {
        self.i
    }

    fn power(&self, stokes: &[f64; 4]) -> f64 {
        self.i * stokes[0]
    }

    fn meet(&mut self, k: &V3, m: &V3) {
        let (turn, s) = Turn::to_hit(k, m, &self.s);
        self.turn(&turn);
        self.s = s;
    }

    fn share(&self, channel: &Channel) -> f64 {
        0.5 * ((channel.s + channel.p) * self.i + (channel.s - channel.p) * self.q)
    }

    fn pass(&mut self, channel: &Channel, factor: f64) {
        let half = 0.5 * factor;
        let (a, b) = (
            half * (channel.s + channel.p),
            half * (channel.s - channel.p),
        );
        let (c, s) = (factor * channel.re, factor * channel.im);
        (self.i, self.q) = (a * self.i + b * self.q, b * self.i + a * self.q);
        (self.u, self.v) = (c * self.u + s * self.v, c * self.v - s * self.u);
    }

    fn depolarise(&mut self, s: &V3) {
        (self.q, self.u, self.v) = (0.0, 0.0, 0.0);
        self.s = *s;
    }

    fn scale(&mut self, factor: f64) {
        self.i *= factor;
        self.q *= factor;
        self.u *= factor;
        self.v *= factor;
    }

    fn leave(&mut self, k: &V3, straight: &V3) {
        self.turn(&Turn::to_exit(k, &self.s, straight));
    }

    fn turn(&mut self, turn: &Turn) {
        turn.apply(&mut self.q, &mut self.u);
    }

    fn add_to(&self, bin: &mut [f64]) {
        for (sum, x) in bin.iter_mut().zip([self.i, self.q, self.u, self.v]) {
            *sum += x;
        }
    }

    #[inline(always)]
    fn leaves_each<S: Simd>(hits: &Leaving<S>, numbers: &mut [Lane<S>; ELEMENTS_MAX]) -> Lane<S> {
        let (channel, half) = (hits.channel, hits.half * hits.factor);
        let q = half * (channel.s - channel.p);
        numbers[0] = half * (channel.s + channel.p);
        numbers[1] = hits.leave.cos * q;
        numbers[2] = -(hits.leave.sin * q);
        numbers[3] = hits.zero;
        numbers[0] * hits.stokes[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::polarisation::Boundary;
    use crate::trace::photons::light::Polarised;
    use crate::trace::rng::{Purpose, RandomStream};
    use crate::trace::vec3::{dot, unit};

    #[test]
    fn it_equals_the_first_column_of_the_mueller_matrix_along_a_path() {
        let mut random = RandomStream::new(3, Purpose::Photon, 0);
        let metal = Boundary::new(1.0, 2.9, 3.1);
        let s = [1.0, 0.0, 0.0];
        let mut k = [0.0, 0.0, -1.0];
        let (mut matrix, mut vector) = (Polarised::launch(&s), StokesState::launch(&s));
        for bounce in 0..6 {
            let mut draw = || random.uniform() - 0.5;
            let m = unit(&[draw() - k[0], draw() - k[1], draw() - k[2]]);
            let cos = -dot(&k, &m);
            let channel = metal.at(cos).reflected;
            matrix.meet(&k, &m);
            vector.meet(&k, &m);
            assert!((matrix.share(&channel) - vector.share(&channel)).abs() < 1e-15);
            matrix.pass(&channel, 1.1);
            vector.pass(&channel, 1.1);
            k = crate::trace::vec3::combine(1.0, &k, 2.0 * cos, &m);
            if bounce == 3 {
                matrix.scale(0.7);
                vector.scale(0.7);
            }
        }
        matrix.leave(&k, &s);
        vector.leave(&k, &s);
        let (mut whole, mut column) = ([0.0; 16], [0.0; 4]);
        matrix.add_to(&mut whole);
        vector.add_to(&mut column);
        for (row, x) in column.iter().enumerate() {
            assert!((whole[4 * row] - x).abs() < 1e-15, "{row}");
        }
        assert!(column[1].abs().max(column[2].abs()) > 1e-3);
    }
}
