//! Replaces outlier pixels (cosmic rays, dust) in frames whose pixels differ in their directions.
//!
//! Near the lamp or the camera a lobe varies over the field, so the mean of a part of the frame is no reference for its pixels:
//! it would make outliers of the lobe's flanks, which hold most of the light. A pixel is compared with the means of opposite
//! neighbours instead, which contain no slope. An outlier is replaced by their median: without the pixel, the field would lose
//! one of its directions.

use super::region::NOWHERE;
use super::sensor::{Sensor, median};
use crate::robust::MEDIAN_OF_ABS;

/// Pixels further than this from their neighbours are outliers.
const OUTLIER_SIGMAS: f64 = 8.0;
/// Columns and rows to one of two opposite neighbours.
const OPPOSITE: [(isize, isize); 4] = [(1, 0), (0, 1), (1, 1), (1, -1)];

/// The values of a frame with what decides whether they are outliers.
pub(super) struct Despiking<'a> {
    /// Counts above dark over response; NaN for a pixel that is left out.
    pub(super) values: Vec<f64>,
    pub(super) labels: &'a [u16],
    /// Part of the frame that a pixel is in; outliers are relative to the scatter of their part.
    pub(super) part: &'a (dyn Fn(usize) -> usize + Sync),
    pub(super) parts: usize,
    pub(super) response: &'a (dyn Fn(usize) -> f64 + Sync),
    pub(super) sensor: &'a Sensor,
}

impl Despiking<'_> {
    /// Returns the values with outliers replaced by the median of their neighbours.
    pub(super) fn despiked(self) -> Vec<f64> {
        let around: Vec<Option<f64>> = (0..self.values.len()).map(|p| self.around(p)).collect();
        let mut distances = vec![Vec::new(); self.parts];
        for (pixel, around) in around.iter().enumerate() {
            if let Some(around) = around {
                distances[(self.part)(pixel)].push((self.values[pixel] - around).abs());
            }
        }
        let usual: Vec<f64> = distances
            .iter_mut()
            .map(|d| median(d) / MEDIAN_OF_ABS)
            .collect();
        let mut despiked = self.values.clone();
        for (pixel, around) in around.into_iter().enumerate() {
            let Some(around) = around else {
                continue;
            };
            let response = (self.response)(pixel);
            // Counts without scatter differ by steps of the converter.
            let noise = self.sensor.variance_dn2(around * response).sqrt() / response;
            let reach = OUTLIER_SIGMAS * usual[(self.part)(pixel)].max(noise);
            if (self.values[pixel] - around).abs() > reach {
                despiked[pixel] = around;
            }
        }
        despiked
    }

    /// Returns the median of the means of opposite neighbours in the same segment.
    fn around(&self, pixel: usize) -> Option<f64> {
        if self.labels[pixel] == NOWHERE || self.values[pixel].is_nan() {
            return None;
        }
        let (width, height) = (self.sensor.width as isize, self.sensor.height as isize);
        let (column, row) = (pixel as isize % width, pixel as isize / width);
        let value = |dx: isize, dy: isize| {
            let (x, y) = (column + dx, row + dy);
            let inside = (0..width).contains(&x) && (0..height).contains(&y);
            let there = inside.then_some((y * width + x) as usize)?;
            let counts = self.labels[there] == self.labels[pixel];
            Some(self.values[there]).filter(|v| counts && !v.is_nan())
        };
        let mut means = [0.0; OPPOSITE.len()];
        let mut count = 0;
        for (dx, dy) in OPPOSITE {
            if let (Some(one), Some(other)) = (value(dx, dy), value(-dx, -dy)) {
                means[count] = 0.5 * (one + other);
                count += 1;
            }
        }
        (count > 0).then(|| median(&mut means[..count]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EDGE: usize = 32;

    fn sensor() -> Sensor {
        Sensor {
            width: EDGE,
            height: EDGE,
            gain_dn: 2.0,
            read_dn: 4.0,
            black_dn: 0.0,
            saturation_dn: 65535.0,
            bit_depth: None,
            count_max: u16::MAX,
        }
    }

    fn despiked(values: Vec<f64>) -> Vec<f64> {
        Despiking {
            values,
            labels: &[0; EDGE * EDGE],
            part: &|pixel| pixel / (EDGE * EDGE / 4),
            parts: 4,
            response: &|_| 1.0,
            sensor: &sensor(),
        }
        .despiked()
    }

    /// A lobe a few pixels wide on a dark background.
    fn lobe(pixel: usize) -> f64 {
        let (x, y) = ((pixel % EDGE) as f64 - 11.0, (pixel / EDGE) as f64 - 18.0);
        200.0 + 30_000.0 * (-(x * x + y * y) / 50.0).exp()
    }

    #[test]
    fn a_lobe_in_a_corner_of_a_dark_field_stays() {
        let clean: Vec<f64> = (0..EDGE * EDGE).map(lobe).collect();
        let sum: f64 = clean.iter().sum();
        let after: f64 = despiked(clean).iter().sum();
        assert!((after / sum - 1.0).abs() < 1e-3, "{after} {sum}");
    }

    #[test]
    fn hits_get_the_value_of_their_neighbours() {
        let mut hit: Vec<f64> = (0..EDGE * EDGE).map(lobe).collect();
        // In the dark, on the flank, side by side, and at the edge.
        let places = [
            5,
            18 * EDGE + 16,
            18 * EDGE + 17,
            25 * EDGE + 25,
            EDGE * EDGE - 9,
        ];
        for place in places {
            hit[place] += 20_000.0;
        }
        let after = despiked(hit);
        for place in places {
            assert!(
                (after[place] / lobe(place) - 1.0).abs() < 0.1,
                "{place}: {}",
                after[place]
            );
        }
    }
}
