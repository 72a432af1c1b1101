//! The retro lobe: light that facet and riser reflect back towards the lamp.

use std::f64::consts::FRAC_1_PI;

use super::ray::{Back, Ray, Shared, Walls};
use super::shape::{Fixed, Shape};
use crate::model::register::Register;

/// Exponent above which the retro lobe is omitted, since it is below 1e-43 of its peak.
const EXPONENT_MAX: f64 = 100.0;

impl<R: Register> Ray<R> {
    /// 1/length of the projection on the plane across the ridges, from a least square of that length.
    #[inline(always)]
    fn per_length(&self, least_square: R) -> R {
        let square = self.e.fused(self.e, self.up * self.up);
        self.e.like(1.0) / square.larger(least_square).root()
    }

    /// Returns atan2(ω_e, max(0, ω_m)).
    #[inline(always)]
    pub(super) fn beta(&self) -> R {
        let angle = self.e.larger(-self.e).quadrant_angle(self.up);
        R::choose(self.on_riser, -angle, angle)
    }
}

/// (c) The retro lobe: `a` reaches the facet, `b` the riser.
#[inline(always)]
pub(super) fn retro<R: Register>(
    fixed: &Fixed,
    q: &Shape<R>,
    [a, b]: [&Ray<R>; 2],
    [wa, wb]: [&Walls<R>; 2],
    [beta_a, beta_b]: [R; 2],
    [ga, gb]: [&mut Back<R>; 2],
    shared: &mut Shared<R>,
) -> R {
    macro_rules! k {
        ($x:expr) => {
            q.r.like($x)
        };
    }
    let (zero, one, half, two) = (k!(0.0), k!(1.0), k!(0.5), k!(2.0));
    let (r, p) = (q.r, q.p);
    let spread = half * (a.up * a.up + b.rho * b.rho);
    let variance = q.alpha_u2.fused(spread, k!(fixed.cones));
    let least_square = k!(R::TINY * R::TINY);
    let per_v_u = one / variance.larger(least_square);
    let x = half * (a.u + b.u);
    let y = half * (beta_b - beta_a);
    let exponent_u = half * x * x * per_v_u;
    let exponent_v = half * y * y * q.per_v_v;
    let exponent = exponent_u + exponent_v;
    let reached = R::both(R::both(a.on_facet, b.on_riser), zero.below(r));
    let reached = R::both(reached, exponent.below(k!(EXPONENT_MAX)));
    if !R::any(reached) {
        return zero;
    }
    let tilt = -(half * (beta_a + beta_b));

    // 1/tan of the tilt from the sum of both directions' unit vectors, held within bounds.
    let [most, least] = fixed.per_tan;
    let (most, least) = (k!(most), k!(least));
    let (la, lb) = (a.per_length(least_square), b.per_length(least_square));
    let (along, up) = (-(a.e * la + b.e * lb), a.up * la + b.up * lb);
    let leans = zero.below(along);
    let raw = R::choose(leans, up * along.positive().per(), most);
    let per_tan = raw.smaller(most).larger(least);
    let moves = R::both(least.below(raw), raw.below(most));

    // Length of the pair of walls that reflects light back. If the facet limits it, its length less σ is the visible
    // length, without a difference.
    let by_facet = (p * per_tan).below(r);
    let hidden = zero.below(a.sigma);
    let cut = R::choose(by_facet, a.open, -a.sigma);
    let beside = R::choose(by_facet, a.open * per_tan, r - a.sigma * per_tan);
    let length = R::choose(hidden, beside, r);
    let to_p = R::choose(hidden, R::choose(by_facet, per_tan, zero), zero);
    let to_r = R::choose(hidden, R::choose(by_facet, zero, one), one);
    let to_sigma = R::choose(hidden, -per_tan, zero);
    // d(1/tan)/dtilt = −(1 + tan²)/tan².
    let to_tilt = R::choose(moves, -(cut * (one + per_tan * per_tan)), zero);
    let to_tilt = R::choose(hidden, to_tilt, zero);
    let on = R::both(reached, zero.below(length));

    let z = tilt * q.per_alpha_v;
    let (phi, bell) = z.normal_share();
    let amplitude2 = q.amplitude * q.amplitude;
    let gauss = exponent.falling() * (per_v_u.root() * q.root_per_v_v);
    let gauss = R::choose(on, gauss * k!(0.125 * FRAC_1_PI), zero);
    let bare = phi * b.rho * gauss * length;
    let to_product = amplitude2 * bare;
    let product = match (&wa.facet.parts, &wb.riser.parts) {
        (Some([fs, fp]), Some([rs, rp])) => {
            let h = half * to_product;
            ga.facet_cos = ga.facet_cos + h * (fs.cos * rs.value + fp.cos * rp.value);
            gb.riser_cos = gb.riser_cos + h * (rs.cos * fs.value + rp.cos * fp.value);
            let by_eta =
                fs.eta * rs.value + fp.eta * rp.value + rs.eta * fs.value + rp.eta * fp.value;
            let by_k = fs.k * rs.value + fp.k * rp.value + rs.k * fs.value + rp.k * fp.value;
            shared.eta = shared.eta + h * by_eta;
            shared.k = shared.k + h * by_k;
            half * (fs.value * rs.value + fp.value * rp.value)
        }
        _ => {
            let (facet, riser) = (wa.facet.f.value, wb.riser.f.value);
            ga.facet_f = to_product.fused(riser, ga.facet_f);
            gb.riser_f = to_product.fused(facet, gb.riser_f);
            facet * riser
        }
    };
    let value = to_product * product;
    shared.amplitude = shared.amplitude + two * q.amplitude * bare * product;
    // Length.
    let whole = amplitude2 * product * phi * gauss;
    let per_length = whole * b.rho;
    shared.p = per_length.fused(to_p, shared.p);
    shared.r = per_length.fused(to_r, shared.r);
    ga.sigma = per_length.fused(to_sigma, ga.sigma);
    // Φ(tilt/αv), the second dependence on the tilt.
    let slope = amplitude2 * product * b.rho * gauss * length * bell;
    let to_tilt = per_length * to_tilt + slope * q.per_alpha_v;
    shared.ln_alpha_v = shared.ln_alpha_v - slope * z;
    // ω_ρ of the leaving direction, −e.
    let mut to_rho = whole * length;
    // The two normal densities.
    let to_x = -(value * x * per_v_u);
    let to_v_u = value * (exponent_u - half) * per_v_u;
    let to_y = -(value * y * q.per_v_v);
    ga.u = half.fused(to_x, ga.u);
    gb.u = half.fused(to_x, gb.u);
    let to_spread = to_v_u * q.alpha_u2;
    shared.ln_alpha_u = shared.ln_alpha_u + two * to_spread * spread;
    ga.m = to_spread.fused(a.up, ga.m);
    to_rho = to_spread.fused(b.rho, to_rho);
    gb.e = gb.e - to_rho;
    let to_v_v = value * (exponent_v - half);
    shared.ln_alpha_v = shared.ln_alpha_v + two * to_v_v * q.share_v_v;
    // β = atan2(e, m).
    let to_beta_a = -(half * (to_y + to_tilt)) * la * la;
    let to_beta_b = half * (to_y - to_tilt) * lb * lb;
    ga.e = to_beta_a.fused(a.up, ga.e);
    ga.m = ga.m - to_beta_a * a.e;
    gb.e = to_beta_b.fused(b.up, gb.e);
    gb.m = gb.m - R::choose(b.on_facet, to_beta_b * b.e, zero);
    value
}
