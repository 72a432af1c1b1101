//! The light of a rounded crest: an arc of the ridge's edge whose normals turn from the facet's to the riser's.
//!
//! The arc of radius R has R dψ of length at normals m(ψ) = cos ψ n + sin ψ v. Single reflection needs the density of
//! slopes integrated over the arc, ∫ D(h; m(ψ)) dψ. With δ = ψ_h − ψ, t = tan δ and a half vector h of components h_u
//! along the ridges and h_p across them, D = P(h_u √(1 + t²)/h_p, t) (1 + t²)²/h_p⁴ and dψ = dt/(1 + t²), so that
//!
//! ```text
//! J = h_p⁻⁴ ∫ P(…) (1 + t²) dt
//! ```
//!
//! For Beckmann slopes the integral is closed, with C = h_u²/(h_p² αu²), B = 1/αv² + C:
//!
//! ```text
//! J = e^−C/(π αu αv h_p⁴) [ √π/(2√B) erf(√B t) (1 + 1/(2B)) − t e^{−B t²}/(2B) ]
//! ```
//!
//! With tails it is a Gauss sum over the angle whose tangent is √B t.

use std::f64::consts::PI;

use super::slopes::Slopes;
use crate::model::gauss::LEGENDRE_16;
use crate::model::number::Number;

/// Largest |ψ_h − ψ| that is integrated, rad; beyond it the density of slopes is negligible.
const FARTHEST: f64 = 1.5;

/// Returns the range of the arc's normals ψ (rad) that lamp and camera both see: `theta_r` is the facet's, `i` and
/// `o` are the projected angles of lamp and camera from n, + towards v. It is empty if the second number is not above
/// the first.
pub(super) fn range<N: Number>(theta_r: N, i: N, o: N) -> (N, N) {
    let quarter = theta_r.like(0.5 * PI);
    let low = (theta_r - quarter).larger(i.larger(o) - quarter);
    let high = theta_r.smaller(i.smaller(o) + quarter);
    (low, high)
}

/// Returns J over the arc from ψ₁ to ψ₂ for a half vector (any length) with components along u, v, n; `tails` states
/// whether the slopes have any.
pub(super) fn lobe<N: Number>(h: [N; 3], arc: (N, N), slopes: &Slopes<N>, tails: bool) -> N {
    let one = h[0].like(1.0);
    let h2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
    let p2 = (h[1] * h[1] + h[2] * h[2]) / h2;
    let across2 = h[0] * h[0] / h2 / p2;
    let at = h[1].angle(h[2]);
    let c = across2 / slopes.u2;
    let b = one / slopes.v2 + c;
    let tangent = |psi: N| {
        let limit = psi.like(FARTHEST);
        let turn = (at - psi).smaller(limit).larger(-limit);
        let (s, c) = turn.sine_cosine();
        s / c
    };
    // ψ₂ is the nearer end of δ.
    let (from, to) = (tangent(arc.1), tangent(arc.0));
    let integral = if tails {
        let per_root = one / b.root();
        let angle = |t: N| (t / per_root).angle(one);
        let (low, high) = (angle(from), angle(to));
        let (middle, half) = ((low + high).times(0.5), (high - low).times(0.5));
        let mut sum = one.like(0.0);
        for (node, weight) in LEGENDRE_16 {
            for node in [node, -node] {
                let (s, c) = (middle + half.times(node)).sine_cosine();
                let t = per_root * s / c;
                let t2 = t * t;
                let density = slopes.relative(across2 * (one + t2), t2);
                sum = sum + (density * (one + t2) * per_root / (c * c)).times(weight);
            }
        }
        sum * half
    } else {
        let primitive = |t: N| {
            let root = b.root();
            let erf = (root * t).map(|x| {
                let slope = 2.0 / PI.sqrt() * (-x * x).exp();
                (libm::erf(x), slope)
            });
            let per_b = one / b.times(2.0);
            let bell = (-(b * t * t)).exponential();
            (erf / root).times(0.5 * PI.sqrt()) * (one + per_b) - t * bell * per_b
        };
        (primitive(to) - primitive(from)) * (-c).exponential()
    };
    (integral * slopes.norm() / (p2 * p2)).positive()
}
