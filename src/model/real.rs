//! The deviations of real samples from an ideal sawtooth.

/// Number of the deviations.
pub const DEVIATIONS: usize = 4;

/// The deviations of real samples from an ideal [`Surface`](super::Surface); also the derivatives with respect to them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Real<N = f64> {
    /// Share τ of the body's light that leaves uniformly over the ridges, 0 to 1.
    pub translucency: N,
    /// Tail ι of the slopes: 0 Beckmann, 1 GGX.
    pub tail: N,
    /// Radius of the crests over the facet's length.
    pub crest: N,
    /// Share of the surface that is flat between the ridges. It stays the last field: the form is linear in it, so that its
    /// derivative needs no variable ([`super::extended::partials`]).
    pub land: N,
}

impl<N> Real<N> {
    /// Makes one of a list, in the order of the fields.
    #[must_use]
    pub fn from_array([translucency, tail, crest, land]: [N; DEVIATIONS]) -> Self {
        Real {
            translucency,
            tail,
            crest,
            land,
        }
    }

    /// Returns the fields as a list.
    #[must_use]
    pub fn into_array(self) -> [N; DEVIATIONS] {
        [self.translucency, self.tail, self.crest, self.land]
    }
}

impl Real {
    /// Adds `weight` times another one.
    pub fn add(&mut self, weight: f64, other: &Real) {
        let (own, other) = (self.into_array(), other.into_array());
        *self = Real::from_array(std::array::from_fn(|j| own[j] + weight * other[j]));
    }

    /// An ideal sawtooth.
    pub const NONE: Real = Real {
        translucency: 0.0,
        tail: 0.0,
        crest: 0.0,
        land: 0.0,
    };
}
