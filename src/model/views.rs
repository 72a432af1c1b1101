//! The mean of a radiance over the directions that one observation of a near rig averages, several at once.

use pulp::{Arch, Simd, WithSimd};

use super::Gradient;
use super::form::{self, Half, NUMBERS, Shape};
use super::lanes::{Lane, Numbers, WIDEST};
use super::prepared::Prepared;
use crate::geometry::Directions;

/// Components of both directions, and the weight.
const COLUMNS: usize = 7;
/// Radiance and slopes: θr, ln αu, ln αv, ρd, A, n, k, tilt, turn.
const SUMS: usize = 10;

/// Weighted directions in the rig's frame, by columns.
#[derive(Debug, Clone)]
pub struct Views {
    columns: Numbers,
    padded: usize,
}

impl Views {
    /// Takes directions with their weights.
    #[must_use]
    pub fn new(views: &[(Directions, f64)]) -> Self {
        // Whole registers on any machine.
        let padded = views.len().next_multiple_of(WIDEST);
        let mut columns = Numbers::zeros(COLUMNS * padded);
        for n in 0..padded {
            // What fills the last register has no weight.
            let (Directions { incident, outgoing }, weight) = views
                .get(n)
                .map_or((views[0].0, 0.0), |(directions, weight)| {
                    (*directions, *weight)
                });
            let row = [
                incident.x, incident.y, incident.z, outgoing.x, outgoing.y, outgoing.z, weight,
            ];
            for (column, x) in row.into_iter().enumerate() {
                columns[column * padded + n] = x;
            }
        }
        Views { columns, padded }
    }
}

/// Sine and cosine of the rotations from the rig's frame at the recorded tilt to the sample.
#[derive(Debug, Clone, Copy)]
pub struct Rotation {
    /// Of the tilt offset.
    pub tilt: (f64, f64),
    /// Of the azimuth of v.
    pub turn: (f64, f64),
}

impl Prepared {
    /// Returns the weighted sum of radiance and derivatives over `views`, with the digits of [`super::lanes`]: 2e-7 of the
    /// radiance, a thousandth of what the number of views leaves.
    #[must_use]
    pub fn over_views(&self, views: &Views, rotation: Rotation) -> Gradient {
        let sum = Arch::new().dispatch(OverViews {
            prepared: self,
            views,
            rotation,
        });
        let [
            value,
            theta_r,
            ln_alpha_u,
            ln_alpha_v,
            rho_d,
            amplitude,
            eta,
            k,
            theta_c,
            phi_s,
        ] = sum;
        let surface = self.surface();
        Gradient {
            value,
            theta_r: if self.is_turned() { -theta_r } else { theta_r },
            alpha_u: ln_alpha_u / surface.alpha_u,
            alpha_v: ln_alpha_v / surface.alpha_v,
            rho_d,
            amplitude,
            eta,
            k,
            theta_c,
            phi_s,
            ..Gradient::ZERO
        }
    }
}

struct OverViews<'a> {
    prepared: &'a Prepared,
    views: &'a Views,
    rotation: Rotation,
}

impl WithSimd for OverViews<'_> {
    type Output = [f64; SUMS];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; SUMS] {
        macro_rules! k {
            ($x:expr) => {
                Lane::splat(simd, $x)
            };
        }
        let (prepared, padded) = (self.prepared, self.views.padded);
        let column = |n: usize| &self.views.columns[n * padded..(n + 1) * padded];
        let columns: [&[f64]; COLUMNS] = [
            column(0),
            column(1),
            column(2),
            column(3),
            column(4),
            column(5),
            column(6),
        ];
        let mut numbers = [k!(0.0); NUMBERS];
        for (to, x) in numbers.iter_mut().zip(prepared.numbers()) {
            *to = k!(*x);
        }
        let shape = Shape::of(&numbers, k!(prepared.surface().amplitude));
        let (fixed, body) = (prepared.table().fixed(), prepared.has_body());
        let Rotation { tilt, turn } = self.rotation;
        // θr < 0 is the surface rotated by 180°.
        let side = if prepared.is_turned() { -1.0 } else { 1.0 };
        let (so, co) = (k!(tilt.0), k!(tilt.1));
        let (sp, cp) = (k!(side * turn.0), k!(side * turn.1));
        let mut sums = [k!(0.0); SUMS];
        for at in 0..padded / Lane::<S>::WIDTH {
            // The tilt rotates (x, y, z) about +y towards +x; (u, v) are (x, y) seen from the azimuth of v.
            macro_rules! rotated {
                ($x:expr) => {{
                    let (x, z) = (
                        Lane::load(simd, columns[$x], at),
                        Lane::load(simd, columns[$x + 2], at),
                    );
                    let y = Lane::load(simd, columns[$x + 1], at);
                    let (x, z) = (x.mul_add(co, z * so), z.mul_add(co, -(x * so)));
                    (x, [x.mul_add(sp, -(y * cp)), x.mul_add(cp, y * sp), z])
                }};
            }
            let ((xi, i), (xo, o)) = (rotated!(0), rotated!(3));
            let half = Half::of_directions(&i, &o, fixed);
            let g = form::radiance(prepared.variant(), body, fixed, &shape, &half, &i, &o);
            // The tilt rotates a rig direction (x, y, z) at the rate (z, 0, −x); the rotation of the sample rotates (u, v)
            // at the rate (v, −u).
            macro_rules! slopes {
                ($w:expr, $g:expr, $x:expr) => {
                    (
                        $w[2] * ($g[0] * sp + $g[1] * cp) - $x * $g[2],
                        $w[1] * $g[0] - $w[0] * $g[1],
                    )
                };
            }
            let (tilt_i, turn_i) = slopes!(i, g.incident, xi);
            let (tilt_o, turn_o) = slopes!(o, g.outgoing, xo);
            let parts = [
                g.value,
                g.theta_r,
                g.ln_alpha_u,
                g.ln_alpha_v,
                g.rho_d,
                g.amplitude,
                g.eta,
                g.k,
                tilt_i + tilt_o,
                turn_i + turn_o,
            ];
            let weight = Lane::load(simd, columns[6], at);
            for (sum, part) in sums.iter_mut().zip(parts) {
                *sum = weight.mul_add(part, *sum);
            }
        }
        let mut all = [0.0; SUMS];
        for (to, sum) in all.iter_mut().zip(sums) {
            let mut lanes = [0.0; WIDEST];
            sum.store(&mut lanes[..Lane::<S>::WIDTH], 0);
            *to = lanes.iter().sum();
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Cones, RigGeometry};
    use crate::model::prepared::OpticsTable;
    use crate::model::{Optics, Surface, Variant};
    use crate::units::Angle;

    /// Directions of a near camera and lamp over a field, at a tilt.
    fn field(tilt: Angle) -> Vec<(Directions, f64)> {
        let rig = RigGeometry::IN_PLANE;
        let mut views = Vec::new();
        for n in 0..21 {
            let (x, y) = (
                f64::from(n % 7) * 0.02 - 0.06,
                f64::from(n / 7) * 0.05 - 0.05,
            );
            let mut directions = rig.rig_directions(tilt);
            for w in [&mut directions.incident, &mut directions.outgoing] {
                w.x += x;
                w.y += y;
                *w = w.normalize();
            }
            views.push((directions, 0.03 + 0.001 * f64::from(n)));
        }
        views
    }

    #[test]
    fn a_sum_in_registers_is_the_sum_of_the_single_views() {
        let mut lit = 0;
        for (variant, eta, k, rho_d) in [
            (Variant::Sawtooth, 1.5, 0.0, 0.3),
            (Variant::Sawtooth, 2.9, 3.1, 0.0),
            (Variant::Paper, 1.5, 0.0, 0.2),
            (Variant::Paper, 2.9, 3.1, 0.0),
        ] {
            let optics = Optics {
                eta,
                k,
                theta_l: RigGeometry::IN_PLANE.theta_l.rad(),
                cones: Cones::of_lamp(Angle::from_deg(0.5)),
            };
            let table = OpticsTable::new(&optics);
            for n in 0..72 {
                let surface = Surface {
                    theta_r: (f64::from(n % 9) * 6.0 - 20.0).to_radians(),
                    alpha_u: 0.08,
                    alpha_v: 0.15,
                    rho_d,
                    amplitude: 0.9,
                };
                let prepared = Prepared::new(variant, &surface, &table);
                let views = field(Angle::from_deg(f64::from(n % 8) * 14.0 - 50.0));
                let rotation = Rotation {
                    tilt: 0.01_f64.sin_cos(),
                    turn: (0.4 * f64::from(n)).sin_cos(),
                };
                let found = prepared.over_views(&Views::new(&views), rotation);
                let (so, co) = rotation.tilt;
                let (sin, cos) = rotation.turn;
                let mut expected = Gradient::ZERO;
                for (directions, weight) in &views {
                    let on_sample = |w: nalgebra::Vector3<f64>| {
                        let (x, y, z) = (w.x * co + w.z * so, w.y, w.z * co - w.x * so);
                        nalgebra::Vector3::new(x * sin - y * cos, x * cos + y * sin, z)
                    };
                    let directions = Directions {
                        incident: on_sample(directions.incident),
                        outgoing: on_sample(directions.outgoing),
                    };
                    let one = prepared.partials(&directions).on_rig(&directions, sin, cos);
                    expected.add(*weight, &one);
                }
                lit += u32::from(expected.value > 1e-3);
                let list = |g: &Gradient| {
                    [
                        g.value,
                        g.theta_r,
                        g.alpha_u,
                        g.alpha_v,
                        g.rho_d,
                        g.amplitude,
                        g.eta,
                        g.k,
                        g.theta_c,
                        g.phi_s,
                    ]
                };
                for (a, b) in list(&found).into_iter().zip(list(&expected)) {
                    let scale = b.abs() + expected.value.abs() + 1e-6;
                    assert!((a - b).abs() < 1e-6 * scale, "{variant:?} {n}: {a} {b}");
                }
            }
        }
        assert!(lit > 120, "{lit}");
    }
}
