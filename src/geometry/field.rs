//! The field of a near camera or lamp: what the mean over all pixels of a frame averages over.
//!
//! The half vector turns over such a field, by a large part of a narrow lobe's width. [`Field::views`] sums a lobe over the
//! field by Gauss–Legendre nodes along columns and rows.
//!
//! *Number of nodes.* Over a piece along which the half vector turns by r lobe widths to either side, 1.7 + 2.35 r nodes sum a
//! lobe within [`SUMMED_WITHIN`] of its top, wherever that lies. A wide lobe therefore needs few nodes, and the cost of a fit grows with
//! their square: one number of nodes for all lobes is too slow for wide ones and too coarse for narrow ones.

use super::{Directions, Imaging};
use crate::units::Angle;

/// Error of a lobe's sum over a field, as a share of the lobe's top.
pub const SUMMED_WITHIN: f64 = 3e-4;
/// Nodes along one axis at most.
pub const NODES_MAX: usize = 36;

/// A frame of a near camera or lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    /// Where its pixels look.
    pub imaging: Imaging,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Field {
    /// The directions over which the mean of all pixels averages at a recorded tilt, and their weights: the fraction of the
    /// pixels times the irradiance there on a surface facing the lamp, relative to the centre of tilt. They sum lobes of the
    /// width `alpha` and wider ones.
    #[must_use]
    pub fn views(&self, theta_c: Angle, alpha: f64) -> Vec<(Directions, f64)> {
        let place = |[a, b]: [f64; 2]| {
            let column = 0.5 * (1.0 + a) * self.width as f64;
            let row = 0.5 * (1.0 + b) * self.height as f64;
            self.imaging.place(column, row, theta_c)
        };
        let turns = self.imaging.half_vector_turns(theta_c, &place);
        let [columns, rows] = turns.map(|turn| nodes_due(turn / alpha));
        nodes(columns, rows)
            .map(|(at, share)| {
                let (directions, irradiance) = self.imaging.at(place(at), theta_c);
                (directions, share * irradiance)
            })
            .collect()
    }
}

/// Nodes that sum a lobe over a piece of the field along which the half vector turns by `widths` lobe widths to either side.
fn nodes_due(widths: f64) -> usize {
    let due = (1.7 + 2.35 * widths).ceil() as usize;
    due.min(NODES_MAX)
}

/// Places from −1 to 1 along columns and rows and their shares, by Gauss–Legendre nodes along both.
pub fn nodes(columns: usize, rows: usize) -> impl Iterator<Item = ([f64; 2], f64)> {
    let (first, second) = (legendre(columns), legendre(rows));
    first.into_iter().flat_map(move |(a, wa)| {
        let row: Vec<_> = second.iter().map(|(b, wb)| ([a, *b], wa * wb)).collect();
        row
    })
}

/// The zeros of Legendre's polynomial of a degree, by Newton's steps from Tricomi's estimate, and the weights of their rule,
/// which add up to 1.
fn legendre(degree: usize) -> Vec<(f64, f64)> {
    let n = degree as f64;
    let at = |k: usize| {
        let mut x = (std::f64::consts::PI * (k as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..8 {
            let (mut before, mut value) = (1.0, x);
            for j in 2..=degree {
                let j = j as f64;
                (before, value) = (
                    value,
                    ((2.0 * j - 1.0) * x * value - (j - 1.0) * before) / j,
                );
            }
            slope = n * (x * value - before) / (x * x - 1.0);
            x -= value / slope;
        }
        (x, 1.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..degree).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::RigGeometry;

    fn field(camera_mm: f64, light_mm: f64) -> Field {
        Field {
            imaging: Imaging {
                rig: RigGeometry::IN_PLANE,
                pixel_mm: [0.4, 0.4],
                tilt_centre_px: [64.0, 50.0],
                principal_point_px: [64.0, 50.0],
                rotation_axis_px: [58.0, 54.0],
                camera_mm: Some(camera_mm),
                light_mm: Some(light_mm),
            },
            width: 128,
            height: 100,
        }
    }

    /// The mean of a light over the pixels, each in 4 × 4 parts.
    fn by_pixels(field: &Field, theta_c: Angle, light: &dyn Fn(&Directions) -> f64) -> f64 {
        let parts = 4;
        let (columns, rows) = (field.width * parts, field.height * parts);
        let at = |k: usize| (k as f64 + 0.5) / parts as f64;
        let lit = (0..columns * rows).map(|k| {
            let place = field
                .imaging
                .place(at(k % columns), at(k / columns), theta_c);
            let (directions, irradiance) = field.imaging.at(place, theta_c);
            irradiance * light(&directions)
        });
        lit.sum::<f64>() / (columns * rows) as f64
    }

    fn by_views(
        field: &Field,
        theta_c: Angle,
        alpha: f64,
        light: &dyn Fn(&Directions) -> f64,
    ) -> f64 {
        let views = field.views(theta_c, alpha);
        views.iter().map(|(d, weight)| weight * light(d)).sum()
    }

    #[test]
    fn the_views_of_a_near_rig_sum_a_lobe_as_its_pixels_do() {
        let theta_c = Angle::from_deg(10.0);
        let near = field(150.0, 150.0);
        for alpha in [0.02, 0.05, 0.1, 0.3] {
            // About a direction a third of the way to the field's edge.
            let lobe = |d: &Directions| {
                let h = (d.incident + d.outgoing).normalize();
                let (x, y) = (h.x / h.z - 0.3, h.y / h.z + 0.05);
                (-(x * x + y * y) / (alpha * alpha)).exp()
            };
            let whole = by_pixels(&near, theta_c, &lobe);
            let off = by_views(&near, theta_c, alpha, &lobe) - whole;
            assert!(
                whole > 2e-3 && off.abs() < SUMMED_WITHIN,
                "{alpha}: {off} {whole}"
            );
        }
        let counts = [0.02, 0.05, 0.1, 0.3].map(|alpha| near.views(theta_c, alpha).len());
        assert_eq!(counts, [396, 80, 30, 9]);
        let far = field(1000.0, 1000.0);
        assert_eq!(far.views(theta_c, 0.05).len(), 9);
    }

    #[test]
    fn the_nodes_due_sum_a_lobe_wherever_it_lies() {
        for widths in [0.0, 0.1, 0.3, 0.7, 1.0, 1.8, 3.0, 6.0] {
            let rule = legendre(nodes_due(widths));
            let fine = legendre(120);
            for step in -40..=40 {
                let centre = f64::from(step) / 20.0;
                let lobe = |(x, w): &(f64, f64)| w * (-((x - centre) * widths).powi(2)).exp();
                let off = rule.iter().map(lobe).sum::<f64>() - fine.iter().map(lobe).sum::<f64>();
                assert!(off.abs() < SUMMED_WITHIN, "{widths} {centre} {off}");
            }
        }
    }

    #[test]
    fn nodes_integrate_polynomials_up_to_twice_their_number() {
        for degree in [2, 6, 7, 13, 36] {
            let rule = legendre(degree);
            assert!((rule.iter().map(|(_, w)| w).sum::<f64>() - 1.0).abs() < 1e-13);
            let power = 2 * degree as i32 - 2;
            let sum: f64 = rule.iter().map(|(x, w)| w * x.powi(power)).sum();
            let due = 1.0 / f64::from(power + 1);
            assert!((sum / due - 1.0).abs() < 1e-11, "{degree} {sum} {due}");
        }
    }

    #[test]
    fn views_average_a_smooth_light_over_the_field() {
        let near = field(300.0, 250.0);
        let theta_c = Angle::from_deg(10.0);
        let light = |d: &Directions| (-((d.incident.x - 0.3) / 0.08).powi(2)).exp() + d.outgoing.y;
        let off = by_views(&near, theta_c, 0.05, &light) / by_pixels(&near, theta_c, &light);
        assert!((off - 1.0).abs() < 2e-4, "{off}");
    }
}
