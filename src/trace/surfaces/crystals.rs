//! Sandpaper: simulated crystals on a plane (Wang et al. 2017, Fig. 6), as a height field.
//!
//! Call [`crystals`]. A crystal is a cuboid of random proportions and random orientation, with its
//! centre at a random height around the plane. The surface is the highest crystal at each position,
//! or the plane where there is none. A height field has no overhangs: overhanging faces become
//! vertical.

use super::height_field::HeightField;
use crate::model::LeftOut;
use crate::trace::rng::{Purpose, RandomStream};
use crate::trace::vec3::{V3, cross, dot, unit};

/// Cells per mean diameter of a crystal.
pub const CELLS_PER_SIZE: f64 = 16.0;

/// Range of the edges of a crystal, divided by its mean size.
const EDGE: (f64, f64) = (0.5, 1.3);

struct Crystal {
    centre: V3,
    axes: [V3; 3],
    halves: [f64; 3],
    reach: f64,
}

impl Crystal {
    fn random(side: f64, size: f64, random: &mut RandomStream) -> Self {
        let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
        let centre = [
            between(0.0, side),
            between(0.0, side),
            size * between(-0.25, 0.25),
        ];
        let halves = [(); 3].map(|()| 0.5 * size * between(EDGE.0, EDGE.1));
        // An orientation uniform over the rotations: z uniform on the sphere, x around it.
        let z = between(-1.0, 1.0);
        let (s, c) = between(0.0, std::f64::consts::TAU).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        let third = [r * c, r * s, z];
        let helper = if z.abs() < 0.9 {
            [0.0, 0.0, 1.0]
        } else {
            [1.0, 0.0, 0.0]
        };
        let a = unit(&cross(&third, &helper));
        let b = cross(&third, &a);
        let (s, c) = between(0.0, std::f64::consts::TAU).sin_cos();
        let first = crate::trace::vec3::combine(c, &a, s, &b);
        let second = cross(&third, &first);
        Crystal {
            centre,
            axes: [first, second, third],
            halves,
            reach: dot(&halves, &halves).sqrt(),
        }
    }

    /// Height of its upper side at an offset from its centre; `None` outside it.
    fn top(&self, x: f64, y: f64) -> Option<f64> {
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        for (axis, half) in self.axes.iter().zip(self.halves) {
            let flat = axis[0] * x + axis[1] * y;
            if axis[2].abs() < 1e-9 {
                if flat.abs() > half {
                    return None;
                }
                continue;
            }
            let (a, b) = ((-half - flat) / axis[2], (half - flat) / axis[2]);
            low = low.max(a.min(b));
            high = high.min(a.max(b));
        }
        (low <= high).then_some(self.centre[2] + high)
    }
}

/// Number of crystals on a tile of `cells` × `cells` with `cover` crystals per size².
#[must_use]
pub fn count(cells: usize, cover: f64) -> u64 {
    (cover * (cells as f64 / CELLS_PER_SIZE).powi(2)).round() as u64
}

/// Reported if the integer number of crystals deviates from the requested cover.
#[must_use]
pub fn rounded(cells: usize, cover: f64, interface: usize) -> Option<LeftOut> {
    const REPORTED_MIN: f64 = 0.01;
    let of = count(cells, cover) as f64 / (cells as f64 / CELLS_PER_SIZE).powi(2);
    let off = (of / cover - 1.0).abs();
    (off > REPORTED_MIN).then(|| {
        LeftOut::new(
            format!("the fraction of a crystal in the cover of interface {interface}"),
            format!(
                "there are {} crystals on the tile, which is a cover of {of:.4}; more cells approximate it better",
                count(cells, cover)
            ),
            None,
        )
    })
}

/// A tile of `cells` × `cells` with crystals of mean size `size` (a length), `cover` of them per
/// size². Equal seeds give equal tiles.
#[must_use]
pub fn crystals(cells: usize, size: f64, cover: f64, seed: u64) -> HeightField {
    let cell = size / CELLS_PER_SIZE;
    let side = cells as f64 * cell;
    let mut heights = vec![0.0f64; cells * cells];
    for n in 0..count(cells, cover) {
        let mut random = RandomStream::new(seed, Purpose::Surface, n + 1);
        let crystal = Crystal::random(side, size, &mut random);
        let around = |centre: f64| {
            let first = ((centre - crystal.reach) / cell).floor() as i64;
            let last = ((centre + crystal.reach) / cell).ceil() as i64;
            first..=last
        };
        for i in around(crystal.centre[0]) {
            for j in around(crystal.centre[1]) {
                let (x, y) = (i as f64 * cell, j as f64 * cell);
                if let Some(top) = crystal.top(x - crystal.centre[0], y - crystal.centre[1]) {
                    let (a, b) = (i.rem_euclid(cells as i64), j.rem_euclid(cells as i64));
                    let height = &mut heights[a as usize * cells + b as usize];
                    *height = height.max(top);
                }
            }
        }
    }
    HeightField::new(cells, cells, cell, cell, &heights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crystals_are_above_the_plane_and_not_above_their_size() {
        let field = crystals(128, 10.0, 1.0, 4);
        let (lowest, highest) = field.range();
        assert_eq!(lowest, 0.0);
        // Half the space diagonal of the largest crystal above the highest centre.
        let largest = 0.25 * 10.0 + 0.5 * 10.0 * EDGE.1 * 3f64.sqrt();
        assert!(highest > 3.0 && highest <= largest, "{highest}");
        assert_eq!(field.range(), crystals(128, 10.0, 1.0, 4).range());
        assert_ne!(field.range(), crystals(128, 10.0, 1.0, 5).range());
    }

    #[test]
    fn a_crystal_lying_flat_has_a_flat_top() {
        let crystal = Crystal {
            centre: [0.0, 0.0, 1.0],
            axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            halves: [2.0, 3.0, 0.5],
            reach: 4.0,
        };
        assert_eq!(crystal.top(1.9, -2.9), Some(1.5));
        assert_eq!(crystal.top(2.1, 0.0), None);
    }
}
