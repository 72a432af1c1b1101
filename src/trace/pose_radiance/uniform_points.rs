//! Points that are uniformly distributed over the surface of a profile.

use crate::trace::surfaces::surface_profile::{ProfileSpot, SurfaceProfile};

/// Points that are uniformly distributed over the surface of a profile.
#[derive(Debug, Clone)]
pub(super) struct UniformPoints {
    /// Length of the profile up to the end of each piece.
    up_to: Vec<f64>,
    /// Length of the profile over its period.
    pub(super) per_period: f64,
}

impl UniformPoints {
    pub fn over(profile: &SurfaceProfile) -> Self {
        let lengths = profile
            .pieces()
            .iter()
            .map(|p| (p.to - p.from).hypot(p.z_to - p.z_from));
        let up_to: Vec<f64> = lengths
            .scan(0.0, |sum, length| {
                *sum += length;
                Some(*sum)
            })
            .collect();
        let all = up_to.last().copied().unwrap_or(0.0);
        UniformPoints {
            per_period: all / profile.period(),
            up_to,
        }
    }

    /// The point for a number from 0 to 1.
    pub fn at(&self, profile: &SurfaceProfile, share: f64) -> ProfileSpot {
        let last = self.up_to.len() - 1;
        let length = share * self.up_to[last];
        let piece = self.up_to.partition_point(|end| *end <= length).min(last);
        let p = &profile.pieces()[piece];
        let before = if piece == 0 {
            0.0
        } else {
            self.up_to[piece - 1]
        };
        let part = ((length - before) / (self.up_to[piece] - before)).clamp(0.0, 1.0);
        let v = p.from + part * (p.to - p.from);
        ProfileSpot {
            piece,
            v,
            z: p.height(v),
        }
    }
}
