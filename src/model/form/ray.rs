//! One direction on the walls of a ridge, and the way of its slopes back to the direction.
//!
//! Names are those of [`crate::model::sawtooth`].

use super::shape::{Fixed, Shape};
use crate::model::fresnel::Boundary;
use crate::model::register::Register;

/// Slopes of the sum with respect to one direction's numbers.
#[derive(Clone, Copy)]
pub(super) struct Back<R> {
    pub(super) u: R,
    pub(super) e: R,
    pub(super) m: R,
    pub(super) sigma: R,
    pub(super) x: R,
    pub(super) y: R,
    pub(super) a: R,
    pub(super) b: R,
    pub(super) facet_f: R,
    pub(super) riser_f: R,
    /// Led back to cos if the polarised parts are used.
    pub(super) facet_cos: R,
    pub(super) riser_cos: R,
}

/// Slopes of the sum with respect to the numbers that both directions share.
#[derive(Clone, Copy)]
pub(super) struct Shared<R> {
    pub(super) p: R,
    pub(super) r: R,
    pub(super) ln_alpha_u: R,
    pub(super) ln_alpha_v: R,
    pub(super) amplitude: R,
    pub(super) eta: R,
    pub(super) k: R,
}

/// One direction in the corner frame (see [`crate::model::sawtooth`]).
#[derive(Clone, Copy)]
pub(super) struct Ray<R: Register> {
    pub(super) u: R,
    pub(super) e: R,
    pub(super) m: R,
    /// max(0, ω_m) and max(0, −ω_e).
    pub(super) up: R,
    pub(super) rho: R,
    pub(super) per_m: R,
    pub(super) per_rho: R,
    pub(super) sigma: R,
    /// Visible facet length, p − σ without cancellation.
    pub(super) open: R,
    pub(super) x: R,
    pub(super) y: R,
    pub(super) on_facet: R::Choice,
    pub(super) on_riser: R::Choice,
    /// Whether e > 0, whether σ < p, and whether a hop over the riser ends on the facet.
    pub(super) hidden: R::Choice,
    pub(super) partly: R::Choice,
    pub(super) short: R::Choice,
}

/// The walls for one direction.
#[derive(Clone, Copy)]
pub(super) struct Walls<R> {
    pub(super) facet: Boundary<R>,
    pub(super) riser: Boundary<R>,
    /// T(ω_m) ω_m and T(ω_ρ) ω_ρ.
    pub(super) a: R,
    pub(super) b: R,
}

impl<R: Copy> Back<R> {
    #[inline(always)]
    pub(super) fn zero(zero: R) -> Self {
        Back {
            u: zero,
            e: zero,
            m: zero,
            sigma: zero,
            x: zero,
            y: zero,
            a: zero,
            b: zero,
            facet_f: zero,
            riser_f: zero,
            facet_cos: zero,
            riser_cos: zero,
        }
    }
}

impl<R: Copy> Shared<R> {
    #[inline(always)]
    pub(super) fn zero(zero: R) -> Self {
        Shared {
            p: zero,
            r: zero,
            ln_alpha_u: zero,
            ln_alpha_v: zero,
            amplitude: zero,
            eta: zero,
            k: zero,
        }
    }
}

impl<R: Register> Ray<R> {
    #[inline(always)]
    pub(super) fn new(q: &Shape<R>, w: &[R; 3]) -> Self {
        let zero = q.r.like(0.0);
        let (s, c) = (q.r, q.p);
        let e = w[1].fused(c, -(w[2] * s));
        let m = w[1].fused(s, w[2] * c);
        let (on_facet, on_riser, hidden) = (zero.below(m), e.below(zero), zero.below(e));
        let (up, rho) = (m.positive(), (-e).positive());
        let (per_m, per_rho) = (up.per(), rho.per());
        let sigma = s * e.positive() * per_m;
        let partly = sigma.below(c);
        let open = R::choose(hidden, (w[2] * per_m).positive(), c);
        let (over, under) = (s * rho, c * up);
        let short = over.below(under);
        Ray {
            u: w[0],
            e,
            m,
            up,
            rho,
            per_m,
            per_rho,
            sigma: R::choose(on_facet, sigma.smaller(c), c),
            open: R::choose(on_facet, open, zero),
            x: R::choose(on_riser, R::choose(short, over * per_m, c), zero),
            y: R::choose(on_riser, R::choose(short, s, under * per_rho), zero),
            on_facet,
            on_riser,
            hidden,
            partly,
            short,
        }
    }

    #[inline(always)]
    pub(super) fn walls(&self, fixed: &Fixed) -> Walls<R> {
        let one = self.u.like(1.0);
        let facet = self.up.wall(self.on_facet, fixed.eta, fixed.k);
        let riser = self.rho.wall(self.on_riser, fixed.eta, fixed.k);
        Walls {
            facet,
            riser,
            a: (one - facet.f.value) * self.up,
            b: (one - riser.f.value) * self.rho,
        }
    }

    /// Leads the slopes back from σ, x, y, a, b and the reflectances to e, m, p, r and the index.
    #[inline(always)]
    pub(super) fn lead_back(
        &self,
        q: &Shape<R>,
        walls: Option<&Walls<R>>,
        g: &mut Back<R>,
        shared: &mut Shared<R>,
    ) {
        let (zero, one) = (self.u.like(0.0), self.u.like(1.0));
        let (s, c) = (q.r, q.p);
        let whole = R::choose(self.hidden, R::choose(self.partly, zero, g.sigma), zero);
        shared.p = shared.p + R::choose(self.on_facet, whole, g.sigma);
        let slides = R::choose(self.hidden, R::choose(self.partly, g.sigma, zero), zero);
        let slides = R::choose(self.on_facet, slides, zero) * self.per_m;
        shared.r = slides.fused(self.e, shared.r);
        g.e = slides.fused(s, g.e);
        g.m = g.m - slides * self.sigma;
        let Some(walls) = walls else {
            return;
        };
        let (x, y) = (
            R::choose(self.on_riser, g.x, zero),
            R::choose(self.on_riser, g.y, zero),
        );
        let over = R::choose(self.short, x, zero) * self.per_m;
        shared.r = over.fused(self.rho, shared.r) + R::choose(self.short, y, zero);
        g.e = g.e - over * s;
        g.m = g.m - over * self.x;
        shared.p = shared.p + R::choose(self.short, zero, x);
        let under = R::choose(self.short, zero, y) * self.per_rho;
        let under = R::choose(self.on_facet, under, zero);
        shared.p = under.fused(self.m, shared.p);
        g.m = under.fused(c, g.m);
        g.e = under.fused(self.y, g.e);
        let (facet, riser) = (&walls.facet.f, &walls.riser.f);
        let riser_f = g.riser_f - g.b * self.rho;
        let to_rho = g.riser_cos + g.b * (one - riser.value) + riser_f * riser.cos;
        g.e = g.e - R::choose(self.on_riser, to_rho, zero);
        let facet_f = g.facet_f - g.a * self.up;
        let to_m = g.facet_cos + g.a * (one - facet.value) + facet_f * facet.cos;
        g.m = g.m + R::choose(self.on_facet, to_m, zero);
        shared.eta = shared.eta + riser_f * riser.eta + facet_f * facet.eta;
        shared.k = shared.k + riser_f * riser.k + facet_f * facet.k;
    }
}
