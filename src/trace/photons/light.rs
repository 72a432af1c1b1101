//! The state of light that a photon carries: a Mueller matrix, or one number in the scalar mode.
//!
//! [`PhotonState`] is implemented for each mode, so that each compiles to its own loop:
//! [`Polarised`] holds the Mueller matrix from the frame of launch to the current frame, and that
//! frame's s; [`ScalarState`] holds a weight. The signs are those of
//! [`crate::model::polarisation`].
//!
//! *Conditioning.* Rotations use the cosine and sine of twice an angle, as (c² − d²)/(c² + d²) and
//! 2cd/(c² + d²): no angle is computed or halved. If a ray meets its normal within 1e-12 rad, the
//! frame of the hit is left unchanged: r_p = −r_s there to 1e-24, so the choice has no effect.

use pulp::Simd;

use crate::model::lanes::Lane;
use crate::model::polarisation::Channel;
use crate::trace::vec3::{V3, cross, dot, scaled};

/// A rotation of a ray's frame about the ray: cos and sin of twice its angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn<T = f64> {
    pub(in crate::trace) cos: T,
    pub(in crate::trace) sin: T,
}

/// Below this sin² of the angle between ray and normal, every frame is a frame of the hit: the two
/// channels differ by less than rounding.
pub(in crate::trace) const STRAIGHT: f64 = 1e-24;

impl Turn {
    /// No rotation.
    pub const NONE: Turn = Turn { cos: 1.0, sin: 0.0 };

    /// The rotation to the frame with s' = c s + d p, for c² + d² = `square`.
    #[inline(always)]
    fn new(c: f64, d: f64, square: f64) -> Self {
        let inverse = 1.0 / square;
        Turn {
            cos: (c * c - d * d) * inverse,
            sin: 2.0 * c * d * inverse,
        }
    }

    /// The rotation of a ray along `k`, whose frame has the given `s`, to the frame of a hit with
    /// normal `m`; also returns the s of that frame.
    #[inline(always)]
    #[must_use]
    pub fn to_hit(k: &V3, m: &V3, s: &V3) -> (Self, V3) {
        // With s ⟂ k: (k × m)·s and (k × m)·(k × s) = m·s.
        let s_hit = cross(k, m);
        let (c, d) = (dot(&s_hit, s), dot(m, s));
        let square = c * c + d * d;
        if square > STRAIGHT {
            let s_hit = scaled(1.0 / square.sqrt(), &s_hit);
            (Turn::new(c, d, square), s_hit)
        } else {
            (Turn::NONE, *s)
        }
    }

    /// The rotation of a ray along `k`, whose frame has the given `s`, to the frame (z × k, k × s)
    /// of an exit direction; for a vertical direction, to the frame with s = `straight`.
    #[inline(always)]
    #[must_use]
    pub fn to_exit(k: &V3, s: &V3, straight: &V3) -> Self {
        // s_out = z × k; its sign has no effect on a Stokes vector.
        let s_out = [-k[1], k[0], 0.0];
        let square = s_out[0] * s_out[0] + s_out[1] * s_out[1];
        let (s_out, square) = if square > STRAIGHT {
            (s_out, square)
        } else {
            (*straight, 1.0)
        };
        Turn::new(dot(&s_out, s), dot(&s_out, &cross(k, s)), square)
    }

    /// Rotates a Q and a U.
    #[inline(always)]
    pub(in crate::trace) fn apply(&self, q: &mut f64, u: &mut f64) {
        (*q, *u) = (self.cos * *q + self.sin * *u, self.cos * *u - self.sin * *q);
    }
}

/// The operations of the walk on the light that a photon carries.
pub trait PhotonState: Copy + Send + Sync {
    /// Number of elements of a direction bin: 16 or 1.
    const ELEMENTS: usize;
    /// Whether it has a frame that rotations affect.
    const HAS_FRAME: bool = true;

    /// Makes unit light in a direction whose frame has this s (unit, perpendicular to it).
    fn launch(s: &V3) -> Self;
    /// Present weight of light that was unpolarised at launch: m00.
    fn weight(&self) -> f64;
    /// Present power for a Stokes vector at launch.
    fn power(&self, stokes: &[f64; 4]) -> f64;
    /// Rotates to the frame of a hit with normal `m` of a ray along `k`.
    fn meet(&mut self, k: &V3, m: &V3);
    /// Power that a channel transmits, for unpolarised light at launch; after
    /// [`PhotonState::meet`].
    fn share(&self, channel: &Channel) -> f64;
    /// Applies a channel times `factor`; after [`PhotonState::meet`].
    fn pass(&mut self, channel: &Channel, factor: f64);
    /// Removes the polarisation: diffuse light.
    fn depolarise(&mut self, s: &V3);
    /// Multiplies all elements.
    fn scale(&mut self, factor: f64);
    /// Rotates to the frame (z × k, k × s) of an exit direction; for a vertical one, to the frame
    /// with s = `straight`.
    fn leave(&mut self, k: &V3, straight: &V3);
    /// Rotates its frame; the caller keeps track of the frame's s.
    fn turn(&mut self, turn: &Turn);
    /// Adds itself to a bin of `ELEMENTS` numbers, row by row.
    fn add_to(&self, bin: &mut [f64]);

    /// Unit light after its first hit: rotated from the frame of launch to that of the hit, whose s
    /// is given, then through a channel times `factor`.
    #[inline(always)]
    fn after_hit(turn: &Turn, s: &V3, channel: &Channel, factor: f64) -> Self {
        let mut light = Self::launch(s);
        light.turn(turn);
        light.pass(channel, factor);
        light
    }

    /// The same for a register of hits, rotated further to the frame of exit: returns the power,
    /// and in the first [`PhotonState::ELEMENTS`] of `numbers` the values that
    /// [`PhotonState::add_to`] would add.
    fn leaves_each<S: Simd>(hits: &Leaving<S>, numbers: &mut [Lane<S>; ELEMENTS_MAX]) -> Lane<S>;
}

/// Largest number of elements of all kinds of light.
pub const ELEMENTS_MAX: usize = 18;

/// A register of hits whose light leaves in one branch.
#[derive(Clone, Copy)]
pub struct Leaving<S: Simd> {
    pub(in crate::trace) zero: Lane<S>,
    pub(in crate::trace) half: Lane<S>,
    /// Rotations from the frame of launch to that of the hit.
    pub(in crate::trace) turn: Turn<Lane<S>>,
    /// Rotations from the frame of the hit to that of the exit.
    pub(in crate::trace) leave: Turn<Lane<S>>,
    pub(in crate::trace) channel: Channel<Lane<S>>,
    pub(in crate::trace) factor: Lane<S>,
    /// Stokes vector of the lamp.
    pub(in crate::trace) stokes: [Lane<S>; 4],
}

/// A Mueller matrix by rows, and s of the current frame.
#[derive(Debug, Clone, Copy)]
pub struct Polarised {
    rows: [[f64; 4]; 4],
    s: V3,
}

impl PhotonState for Polarised {
    const ELEMENTS: usize = 16;

    fn launch(s: &V3) -> Self {
        let mut rows = [[0.0; 4]; 4];
        for (i, row) in rows.iter_mut().enumerate() {
            row[i] = 1.0;
        }
        Polarised { rows, s: *s }
    }

    #[inline]
    fn weight(&self) -> f64 {
        self.rows[0][0]
    }

    #[inline]
    fn power(&self, stokes: &[f64; 4]) -> f64 {
        let r = &self.rows[0];
        r[0] * stokes[0] + r[1] * stokes[1] + r[2] * stokes[2] + r[3] * stokes[3]
    }

    #[inline]
    fn meet(&mut self, k: &V3, m: &V3) {
        let (turn, s) = Turn::to_hit(k, m, &self.s);
        self.turn(&turn);
        self.s = s;
    }

    #[inline]
    fn share(&self, channel: &Channel) -> f64 {
        let (a, b) = (0.5 * (channel.s + channel.p), 0.5 * (channel.s - channel.p));
        a * self.rows[0][0] + b * self.rows[1][0]
    }

    #[inline]
    fn pass(&mut self, channel: &Channel, factor: f64) {
        let half = 0.5 * factor;
        let (a, b) = (
            half * (channel.s + channel.p),
            half * (channel.s - channel.p),
        );
        let (c, s) = (factor * channel.re, factor * channel.im);
        let [r0, r1, r2, r3] = self.rows;
        for j in 0..4 {
            self.rows[0][j] = a * r0[j] + b * r1[j];
            self.rows[1][j] = b * r0[j] + a * r1[j];
            self.rows[2][j] = c * r2[j] + s * r3[j];
            self.rows[3][j] = c * r3[j] - s * r2[j];
        }
    }

    fn depolarise(&mut self, s: &V3) {
        for row in &mut self.rows[1..] {
            *row = [0.0; 4];
        }
        self.s = *s;
    }

    #[inline]
    fn scale(&mut self, factor: f64) {
        for row in &mut self.rows {
            for x in row {
                *x *= factor;
            }
        }
    }

    #[inline]
    fn leave(&mut self, k: &V3, straight: &V3) {
        self.turn(&Turn::to_exit(k, &self.s, straight));
    }

    #[inline(always)]
    fn turn(&mut self, turn: &Turn) {
        let [_, q, u, _] = &mut self.rows;
        for (q, u) in q.iter_mut().zip(u) {
            turn.apply(q, u);
        }
    }

    /// Half of the elements of the rotated identity are zero.
    #[inline(always)]
    fn after_hit(turn: &Turn, s: &V3, channel: &Channel, factor: f64) -> Self {
        let half = 0.5 * factor;
        let (a, b) = (
            half * (channel.s + channel.p),
            half * (channel.s - channel.p),
        );
        let (re, im) = (factor * channel.re, factor * channel.im);
        let Turn { cos, sin } = *turn;
        Polarised {
            rows: [
                [a, b * cos, b * sin, 0.0],
                [b, a * cos, a * sin, 0.0],
                [0.0, -re * sin, re * cos, im],
                [0.0, im * sin, -im * cos, re],
            ],
            s: *s,
        }
    }

    #[inline]
    fn add_to(&self, bin: &mut [f64]) {
        for (b, x) in bin.iter_mut().zip(self.rows.iter().flatten()) {
            *b += x;
        }
    }

    #[inline(always)]
    fn leaves_each<S: Simd>(hits: &Leaving<S>, numbers: &mut [Lane<S>; ELEMENTS_MAX]) -> Lane<S> {
        let Leaving {
            zero,
            half,
            turn,
            leave,
            channel,
            factor,
            stokes,
        } = *hits;
        let half = half * factor;
        let (a, b) = (
            half * (channel.s + channel.p),
            half * (channel.s - channel.p),
        );
        let (re, im) = (factor * channel.re, factor * channel.im);
        let (q, u) = (
            [b, a * turn.cos, a * turn.sin, zero],
            [zero, -re * turn.sin, re * turn.cos, im],
        );
        let rows = [
            a,
            b * turn.cos,
            b * turn.sin,
            zero,
            leave.cos * q[0],
            leave.cos * q[1] + leave.sin * u[1],
            leave.cos * q[2] + leave.sin * u[2],
            leave.sin * u[3],
            -(leave.sin * q[0]),
            leave.cos * u[1] - leave.sin * q[1],
            leave.cos * u[2] - leave.sin * q[2],
            leave.cos * u[3],
            zero,
            im * turn.sin,
            -im * turn.cos,
            re,
        ];
        numbers[..rows.len()].copy_from_slice(&rows);
        let [m00, m01, m02, m03] = [rows[0], rows[1], rows[2], rows[3]];
        m00 * stokes[0] + m01 * stokes[1] + m02 * stokes[2] + m03 * stokes[3]
    }
}

/// A weight: light whose polarisation is not followed.
#[derive(Debug, Clone, Copy)]
pub struct ScalarState(f64);

impl PhotonState for ScalarState {
    const ELEMENTS: usize = 1;
    const HAS_FRAME: bool = false;

    fn launch(_: &V3) -> Self {
        ScalarState(1.0)
    }
    #[inline]
    fn weight(&self) -> f64 {
        self.0
    }
    #[inline]
    fn power(&self, stokes: &[f64; 4]) -> f64 {
        self.0 * stokes[0]
    }
    #[inline]
    fn meet(&mut self, _: &V3, _: &V3) {}
    #[inline]
    fn share(&self, channel: &Channel) -> f64 {
        self.0 * channel.unpolarised()
    }
    #[inline]
    fn pass(&mut self, channel: &Channel, factor: f64) {
        self.0 *= factor * channel.unpolarised();
    }
    fn depolarise(&mut self, _: &V3) {}
    #[inline]
    fn scale(&mut self, factor: f64) {
        self.0 *= factor;
    }
    #[inline]
    fn leave(&mut self, _: &V3, _: &V3) {}
    #[inline]
    fn turn(&mut self, _: &Turn) {}
    #[inline]
    fn add_to(&self, bin: &mut [f64]) {
        bin[0] += self.0;
    }

    #[inline(always)]
    fn leaves_each<S: Simd>(hits: &Leaving<S>, numbers: &mut [Lane<S>; ELEMENTS_MAX]) -> Lane<S> {
        let Channel { s, p, .. } = hits.channel;
        numbers[0] = hits.factor * (hits.half * (s + p));
        numbers[0] * hits.stokes[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::polarisation::{Boundary, Mueller};
    use crate::model::single_bounce::{Scattering, mueller_brdf};
    use crate::trace::vec3::{combine, unit};

    /// One reflection off a facet, from frame to frame, compared with the closed form of the single
    /// bounce.
    #[test]
    fn frames_rotate_as_in_the_closed_form_of_the_single_bounce() {
        for (theta_i, theta_s, phi_s) in [(0.5, 0.9, 0.8), (1.2, 0.3, -2.0), (0.7, 0.7, 0.0)] {
            let k_in = [f64::sin(theta_i), 0.0, -f64::cos(theta_i)];
            let k_out = [
                f64::sin(theta_s) * f64::cos(phi_s),
                f64::sin(theta_s) * f64::sin(phi_s),
                f64::cos(theta_s),
            ];
            let m = unit(&combine(1.0, &k_out, -1.0, &k_in));
            let mut light = Polarised::launch(&[0.0, 1.0, 0.0]);
            light.meet(&k_in, &m);
            let split = Boundary::new(1.0, 0.18, 3.4).at(dot(&m, &k_out));
            light.pass(&split.reflected, 1.0);
            light.leave(&k_out, &[0.0, 1.0, 0.0]);
            let scattering = Scattering {
                theta_i,
                theta_s,
                phi_s,
            };
            let expected = mueller_brdf(&scattering, 1.0, 0.18, 3.4).unwrap();
            let ratio = light.rows[0][0] / expected.0[(0, 0)];
            for i in 0..4 {
                for j in 0..4 {
                    let difference = light.rows[i][j] - ratio * expected.0[(i, j)];
                    assert!(difference.abs() < 1e-14, "{i}{j}");
                }
            }
        }
    }

    #[test]
    fn a_hit_in_one_step_equals_a_hit_in_three_steps() {
        let s = [0.0, 1.0, 0.0];
        let k = [-0.6, 0.0, -0.8];
        let m = unit(&[0.2, -0.3, 1.0]);
        for boundary in [Boundary::new(1.0, 1.5, 0.0), Boundary::new(1.0, 0.2, 3.0)] {
            let channel = boundary.at(-dot(&k, &m)).reflected;
            let mut whole = Polarised::launch(&s);
            whole.meet(&k, &m);
            whole.pass(&channel, 1.25);
            let (turn, s_hit) = Turn::to_hit(&k, &m, &s);
            let short = Polarised::after_hit(&turn, &s_hit, &channel, 1.25);
            assert_eq!((short.rows, short.s), (whole.rows, whole.s));
        }
    }

    #[test]
    fn a_vertical_exit_has_the_given_frame() {
        let s = [0.0, 1.0, 0.0];
        let mut light = Polarised::launch(&s);
        let split = Boundary::new(1.0, 1.5, 0.0).at(1.0);
        light.meet(&[0.0, 0.0, -1.0], &[0.0, 0.0, 1.0]);
        light.pass(&split.reflected, 1.0);
        light.leave(&[0.0, 0.0, 1.0], &s);
        let expected = Mueller(split.reflected.mueller().0);
        for i in 0..4 {
            for j in 0..4 {
                assert!((light.rows[i][j] - expected.0[(i, j)]).abs() < 1e-16);
            }
        }
    }
}
