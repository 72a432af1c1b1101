//! The response of a smooth facet to the lamp's light: directions, fractions, Mueller matrices and
//! bins, without random numbers.
//!
//! All photons from the lamp onto one triangle hit the same facet in the same direction: an
//! [`Incidence`]. For photons that take one branch each with weight 1, a [`FacetResponse`] is
//! stored per triangle: enough to count light that leaves at once without visiting the triangle
//! again.

use crate::model::polarisation::{Boundary, Channel, Split};
use crate::trace::counting::grid::BinFinder;
use crate::trace::photons::light::{PhotonState, Turn};
use crate::trace::photons::walk::Walk;
use crate::trace::surfaces::height_field::Side;
use crate::trace::vec3::{V3, combine, dot};

/// Smallest cosine of incidence: rounding at grazing incidence must not reverse the light.
pub(in crate::trace) const GRAZING: f64 = 1e-12;

/// The lamp's light on a smooth facet of the first interface.
#[derive(Clone, Copy)]
pub struct Incidence<'a> {
    walk: &'a Walk<'a>,
    boundary: &'a Boundary,
    m: V3,
    cos: f64,
    split: Split,
    turn: Turn,
    /// s of the frame of the hit.
    s: V3,
}

/// Light that has left the surface.
#[derive(Debug, Clone, Copy)]
pub struct Exit<L> {
    /// In the frame of its exit.
    pub light: L,
    /// Fraction of the lamp's power.
    pub power: f64,
    /// The bin of its direction.
    pub bin: usize,
}

/// One branch of light from a facet that leaves at once.
#[derive(Debug, Clone, Copy)]
pub struct FacetBranch {
    /// The boundary's matrix divided by the probability of this branch.
    pub channel: Channel,
    /// Rotation from the frame of the hit to that of the exit.
    pub leave: Turn,
    /// Fraction of the lamp's power in this branch.
    pub power: f64,
    /// The bin of the exit direction.
    pub bin: u32,
}

/// Both branches of a facet.
#[derive(Debug, Clone, Copy)]
pub struct FacetResponse {
    /// Rotation from the frame of launch to that of the hit.
    pub turn: Turn,
    /// Probability that a photon is reflected: the reflected fraction of unpolarised light.
    pub share: f64,
    /// Whether light is refracted.
    pub enters: bool,
    /// The reflected branch.
    pub reflected: FacetBranch,
    /// The refracted branch.
    pub refracted: FacetBranch,
}

impl<'a> Incidence<'a> {
    /// Light on a facet with the upward normal `m` that faces the lamp.
    #[inline(always)]
    #[must_use]
    pub fn of<L: PhotonState>(walk: &'a Walk<'a>, m: &V3) -> Self {
        let boundary = &walk.stack.interfaces[0].from_above;
        let cos = (-dot(&walk.k, m)).max(GRAZING);
        let (turn, s) = if L::HAS_FRAME {
            Turn::to_hit(&walk.k, m, &walk.s)
        } else {
            (Turn::NONE, walk.s)
        };
        Incidence {
            walk,
            boundary,
            m: *m,
            cos,
            split: boundary.at(cos),
            turn,
            s,
        }
    }

    /// Direction of the reflected light.
    #[inline(always)]
    fn reflected(&self) -> V3 {
        combine(1.0, &self.walk.k, 2.0 * self.cos, &self.m)
    }

    /// Direction of the refracted light, if there is any.
    #[inline(always)]
    fn refracted(&self) -> V3 {
        let ratio = self.split.ratio;
        let along = ratio * self.cos - self.split.cos_refracted;
        combine(ratio, &self.walk.k, along, &self.m)
    }

    /// Whether light is refracted: not into a metal, and not under total reflection.
    #[inline(always)]
    #[must_use]
    pub fn enters(&self) -> bool {
        self.split.cos_refracted > 0.0
    }

    /// Channel and direction of the branch to a side.
    #[inline(always)]
    #[must_use]
    pub fn way(&self, side: Side) -> (&Channel, V3) {
        match side {
            Side::Above => (&self.split.reflected, self.reflected()),
            Side::Below => (&self.split.refracted, self.refracted()),
        }
    }

    /// Light just after the hit, in a branch.
    #[inline(always)]
    #[must_use]
    pub fn after<L: PhotonState>(&self, channel: &Channel) -> L {
        L::after_hit(&self.turn, &self.s, channel, 1.0)
    }

    /// `factor` of the light to a side that leaves at once.
    #[inline(always)]
    #[must_use]
    pub fn leaves<L: PhotonState>(&self, side: Side, factor: f64, bins: &BinFinder) -> Exit<L> {
        let (channel, k) = self.way(side);
        let mut light = L::after_hit(&self.turn, &self.s, channel, factor);
        let power = light.power(&self.walk.stokes);
        if L::HAS_FRAME {
            light.turn(&Turn::to_exit(&k, &self.s, &self.walk.s));
        }
        Exit {
            light,
            power,
            bin: bins.bin(side, &k),
        }
    }

    /// Whether the light that is not reflected is absorbed.
    #[inline(always)]
    #[must_use]
    pub fn absorbs(&self) -> bool {
        self.boundary.is_metal()
    }

    /// The branch to a side, with `factor` times its channel's transmission.
    #[inline(always)]
    fn passage<L: PhotonState>(&self, side: Side, factor: f64, bins: &BinFinder) -> FacetBranch {
        let (channel, k) = self.way(side);
        let channel = Channel {
            s: factor * channel.s,
            p: factor * channel.p,
            re: factor * channel.re,
            im: factor * channel.im,
        };
        let leave = if L::HAS_FRAME {
            Turn::to_exit(&k, &self.s, &self.walk.s)
        } else {
            Turn::NONE
        };
        FacetBranch {
            leave,
            power: self.after::<L>(&channel).power(&self.walk.stokes),
            bin: bins.bin(side, &k) as u32,
            channel,
        }
    }

    /// The stored response for photons that take one branch each.
    #[inline(always)]
    #[must_use]
    pub fn facet<L: PhotonState>(&self, bins: &BinFinder) -> FacetResponse {
        let enters = self.enters();
        let share = if enters || self.absorbs() {
            self.split.reflected.unpolarised()
        } else {
            1.0
        };
        let reflected = self.passage::<L>(Side::Above, 1.0 / share, bins);
        let refracted = if enters {
            self.passage::<L>(Side::Below, 1.0 / (1.0 - share), bins)
        } else {
            FacetBranch {
                channel: Channel::NONE,
                power: 0.0,
                ..reflected
            }
        };
        FacetResponse {
            turn: self.turn,
            share,
            enters,
            reflected,
            refracted,
        }
    }
}

impl FacetResponse {
    /// Light in a branch that leaves at once, in the frame of its exit.
    #[inline(always)]
    #[must_use]
    pub fn leaving<L: PhotonState>(&self, way: &FacetBranch) -> L {
        // The frame of the hit is not needed for light that leaves.
        let mut light = L::after_hit(&self.turn, &crate::trace::vec3::UP, &way.channel, 1.0);
        light.turn(&way.leave);
        light
    }
}
