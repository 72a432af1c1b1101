//! The hand-written gradients against the crate num-dual, over all reference cases.

use nalgebra::{Const, Vector3};
use num_dual::{Derivative, DualNum, DualSVec64};

use super::extended::{self, Parameters, Terms, Walls};
use super::fresnel::{Reflectances, Slopes};
use super::number::Number;
use super::prepared::{OpticsTable, Partials, Prepared};
use super::real::{DEVIATIONS, Real};
use super::{Optics, Surface, Variant, paper};
use crate::cases::reference::{PRINTED_BRDF, ReferenceTable, directions_of, surface_of};
use crate::geometry::{Cones, Directions, Pose, RigGeometry};
use crate::units::Angle;

/// θr, αu, αv, ρd, A, n, k, then the components of ω_i and of ω_o.
type D = DualSVec64<13>;

impl Number for D {
    type Choice = bool;

    fn like(self, value: f64) -> Self {
        D::from_re(value)
    }
    fn below(self, other: Self) -> bool {
        self.re < other.re
    }
    fn choose(choice: bool, yes: Self, no: Self) -> Self {
        if choice { yes } else { no }
    }
    fn map(self, f: impl Fn(f64) -> (f64, f64)) -> Self {
        let (value, slope) = f(self.re);
        (self - self.re) * slope + value
    }
    fn map2(self, other: Self, f: impl Fn(f64, f64) -> (f64, f64, f64)) -> Self {
        let (value, first, second) = f(self.re, other.re);
        (self - self.re) * first + (other - other.re) * second + value
    }
    fn mirrored(self, eta: Self, k: Self) -> (Self, Self) {
        let r = Reflectances::at(self.re, eta.re, k.re);
        let lift = |x: Slopes| {
            (self - self.re) * x.cos + (eta - eta.re) * x.eta + (k - k.re) * x.k + x.value
        };
        (lift(r.s), lift(r.p))
    }
    // num-dual's own rules, in place of the trait's.
    fn root(self) -> Self {
        DualNum::sqrt(&self)
    }
    fn exponential(self) -> Self {
        DualNum::exp(&self)
    }
    fn sine_cosine(self) -> (Self, Self) {
        DualNum::sin_cos(&self)
    }
    fn angle(self, x: Self) -> Self {
        DualNum::atan2(&self, x)
    }
}

fn variable(value: f64, index: usize) -> D {
    D::new(
        value,
        Derivative::derivative_generic(Const::<13>, Const::<1>, index),
    )
}

struct Case {
    incident: [f64; 3],
    outgoing: [f64; 3],
    surface: Surface,
    optics: Optics,
    /// Relative condition number of the value, at least 1.
    condition: f64,
}

fn by_num_dual(variant: Variant, c: &Case) -> [f64; 14] {
    let q = Parameters {
        theta_r: variable(c.surface.theta_r, 0),
        alpha_u: variable(c.surface.alpha_u, 1),
        alpha_v: variable(c.surface.alpha_v, 2),
        rho_d: variable(c.surface.rho_d, 3),
        real: Real::from_array([D::from_re(0.0); DEVIATIONS]),
        amplitude: variable(c.surface.amplitude, 4),
        eta: variable(c.optics.eta, 5),
        k: variable(c.optics.k, 6),
    };
    let (widening, walls) = (
        c.optics.cones.widening(),
        Walls::smooth(&OpticsTable::new(&c.optics)),
    );
    let terms = Terms {
        body: true,
        ..Terms::of(&Real::NONE, &c.optics, &Real::default())
    };
    if c.incident[2] <= 0.0 || c.outgoing[2] <= 0.0 {
        return [0.0; 14];
    }
    let i = [0, 1, 2].map(|j| variable(c.incident[j], 7 + j));
    let o = [0, 1, 2].map(|j| variable(c.outgoing[j], 10 + j));
    let result = match variant {
        Variant::Paper => paper::radiance_of(i, o, &q, widening),
        Variant::Sawtooth => extended::radiance_of(i, o, &q, terms, &walls, widening),
    };
    let eps = result.eps.unwrap_generic(Const::<13>, Const::<1>);
    let mut all = [0.0; 14];
    all[0] = result.re;
    for j in 0..13 {
        all[j + 1] = eps[j];
    }
    all
}

fn by_hand(variant: Variant, c: &Case) -> [f64; 14] {
    let p: Partials =
        Prepared::new(variant, &c.surface, &OpticsTable::new(&c.optics)).partials(&Directions {
            incident: Vector3::from(c.incident),
            outgoing: Vector3::from(c.outgoing),
        });
    let mut all = [
        p.value,
        p.theta_r,
        p.alpha_u,
        p.alpha_v,
        p.rho_d,
        p.amplitude,
        p.eta,
        p.k,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    ];
    all[8..11].copy_from_slice(&p.incident);
    all[11..14].copy_from_slice(&p.outgoing);
    all
}

fn agree(variant: Variant, c: &Case, label: &str) {
    let (a, b) = (by_hand(variant, c), by_num_dual(variant, c));
    // Natural size of each derivative: the value over the parameter; over 1 for directions.
    let s = &c.surface;
    let scales = [
        1.0, 1.0, s.alpha_u, s.alpha_v, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0,
    ];
    // The fast form omits retro lobes below 1e-43 of their peak.
    let floor = if variant == Variant::Sawtooth {
        1e-35
    } else {
        1e-290
    };
    for j in 0..14 {
        let allowed =
            512.0 * f64::EPSILON * c.condition * (b[j].abs() + b[0].abs() / scales[j]) + floor;
        assert!(
            (a[j] - b[j]).abs() <= allowed,
            "{variant:?} {label}, derivative {j}: {} against {} (allowed {allowed:e})",
            a[j],
            b[j]
        );
    }
}

#[test]
fn gradients_agree_over_the_brdf_reference_cases() {
    let table = ReferenceTable::read(PRINTED_BRDF);
    for (n, row) in table.rows().enumerate() {
        let c = row.case();
        // At index 1 exactly, at the critical angle and at a ridge angle of 90° a derivative is infinite.
        if (c.eta == 1.0 && c.k == 0.0) || c.theta_r > 1.5 {
            continue;
        }
        let (surface, optics) = surface_of(&c);
        let d = directions_of(&c);
        let case = Case {
            incident: d.incident.into(),
            outgoing: d.outgoing.into(),
            surface,
            optics,
            condition: 1.0 + row.number("cond"),
        };
        agree(Variant::Paper, &case, &format!("row {n}"));
    }
}

#[test]
fn gradients_agree_over_the_closed_form_cases() {
    for (n, line) in include_str!("../../tests/data/sawtooth-closed-form.csv")
        .lines()
        .skip(1)
        .enumerate()
    {
        let x: Vec<f64> = line.split(',').map(|f| f.parse().unwrap()).collect();
        let rig = RigGeometry {
            theta_l: Angle::from_deg(x[7]),
            cones: Cones::of_lamp(Angle::from_deg(x[8])),
            ..RigGeometry::IN_PLANE
        };
        let d = rig.directions(Pose::from_deg(x[9], x[10]));
        let case = Case {
            incident: d.incident.into(),
            outgoing: d.outgoing.into(),
            surface: Surface {
                theta_r: x[0].to_radians(),
                alpha_u: x[1],
                alpha_v: x[2],
                amplitude: x[3],
                rho_d: x[4],
            },
            optics: Optics {
                eta: x[5],
                k: x[6],
                theta_l: x[7].to_radians(),
                cones: Cones::of_lamp(Angle::from_deg(x[8])),
            },
            condition: 100.0,
        };
        for variant in [Variant::Paper, Variant::Sawtooth] {
            agree(variant, &case, &format!("row {n}"));
        }
    }
}
