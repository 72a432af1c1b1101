//! What a smooth facet does to the lamp's light, all but chance: directions, shares, Mueller matrices, bins.
//!
//! All photons that come from the lamp onto one triangle meet the same facet in the same direction: an [`Incidence`].
//! Of those that go one way each, and weigh 1 on it, a [`Facet`] is kept per triangle: enough to count light that leaves
//! at once without looking at the triangle again.

use super::grid::Finder;
use super::height_field::Side;
use super::light::{Light, Turn};
use super::vec3::{V3, combine, dot};
use super::walk::Walk;
use crate::model::polarisation::{Boundary, Channel, Split};

/// Least cosine of incidence: rounding at grazing must not turn light away.
pub(super) const GRAZING: f64 = 1e-12;

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
    /// Power of the lamp's light that it is.
    pub power: f64,
    /// The bin of its direction.
    pub bin: usize,
}

/// One way on from a facet, for light that leaves at once.
#[derive(Debug, Clone, Copy)]
pub struct Passage {
    /// What the boundary does, over the chance of this way.
    pub channel: Channel,
    /// From the frame of the hit to that of the exit.
    pub leave: Turn,
    /// Power of the lamp's light that goes this way.
    pub power: f64,
    /// The bin of the direction of exit.
    pub bin: u32,
}

/// Both ways on from a facet.
#[derive(Debug, Clone, Copy)]
pub struct Facet {
    /// From the frame of launch to that of the hit.
    pub turn: Turn,
    /// Chance of a photon to be reflected: what unpolarised light would be.
    pub share: f64,
    /// Whether light is refracted.
    pub enters: bool,
    /// Reflection.
    pub reflected: Passage,
    /// Refraction.
    pub refracted: Passage,
}

impl<'a> Incidence<'a> {
    /// On a facet with upward normal `m` that faces the lamp.
    #[inline(always)]
    #[must_use]
    pub fn of<L: Light>(walk: &'a Walk<'a>, m: &V3) -> Self {
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

    /// Direction of the refracted light, where there is any.
    #[inline(always)]
    fn refracted(&self) -> V3 {
        let ratio = self.split.ratio;
        let along = ratio * self.cos - self.split.cos_refracted;
        combine(ratio, &self.walk.k, along, &self.m)
    }

    /// Whether light is refracted: not into a metal, nor under total reflection.
    #[inline(always)]
    #[must_use]
    pub fn enters(&self) -> bool {
        self.split.cos_refracted > 0.0
    }

    /// Channel and direction of the way on to a side.
    #[inline(always)]
    #[must_use]
    pub fn way(&self, side: Side) -> (&Channel, V3) {
        match side {
            Side::Above => (&self.split.reflected, self.reflected()),
            Side::Below => (&self.split.refracted, self.refracted()),
        }
    }

    /// Light that has just gone a way.
    #[inline(always)]
    #[must_use]
    pub fn after<L: Light>(&self, channel: &Channel) -> L {
        L::after_hit(&self.turn, &self.s, channel, 1.0)
    }

    /// `factor` of the light that goes to a side, where it leaves at once.
    #[inline(always)]
    #[must_use]
    pub fn leaves<L: Light>(&self, side: Side, factor: f64, bins: &Finder) -> Exit<L> {
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

    /// Whether what is not reflected is absorbed.
    #[inline(always)]
    #[must_use]
    pub fn absorbs(&self) -> bool {
        self.boundary.is_metal()
    }

    /// The way on to a side, of `factor` times what its channel lets pass.
    #[inline(always)]
    fn passage<L: Light>(&self, side: Side, factor: f64, bins: &Finder) -> Passage {
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
        Passage {
            leave,
            power: self.after::<L>(&channel).power(&self.walk.stokes),
            bin: bins.bin(side, &k) as u32,
            channel,
        }
    }

    /// What is kept of it for photons that go one way each.
    #[inline(always)]
    #[must_use]
    pub fn facet<L: Light>(&self, bins: &Finder) -> Facet {
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
            Passage {
                channel: Channel::NONE,
                power: 0.0,
                ..reflected
            }
        };
        Facet {
            turn: self.turn,
            share,
            enters,
            reflected,
            refracted,
        }
    }
}

impl Facet {
    /// Light that has just gone a way and leaves at once, in the frame of its exit.
    #[inline(always)]
    #[must_use]
    pub fn leaving<L: Light>(&self, way: &Passage) -> L {
        // Of what leaves, the frame of the hit is no longer asked for.
        let mut light = L::after_hit(&self.turn, &super::vec3::UP, &way.channel, 1.0);
        light.turn(&way.leave);
        light
    }
}
