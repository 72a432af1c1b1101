//! Converts a measured height map of parallel ridges to a profile across them.
//!
//! Call [`RidgeMap::of`]. It finds the direction and period of the ridges from their strongest
//! waves, levels the map by the rule that neighbouring ridges have equal height, and averages along
//! the ridges. Every ridge of the map is kept, so that wear and burrs that differ between ridges
//! are traced. Variations along the ridges are left out and reported. A map without a single
//! direction of ridges is refused. This module knows no files: the caller passes the heights in.

mod field;
mod gaps;
mod lines;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

use super::surface_profile::{ProfileError, SurfaceProfile};
use crate::model::LeftOut;
use crate::trace::scene::{HeightMap, MapUnits};
use crate::wording::percent;
use field::{SampledHeights, Wave, take_off_plane};
use lines::RidgeLines;
#[cfg(test)]
pub(crate) use tests::map_of as height_map_of;

/// Least number of ridges in a map: two could be a coincidence.
const RIDGES_MIN: f64 = 3.0;
/// Least number of samples per ridge: fewer do not resolve its shape.
const SAMPLES_MIN: f64 = 8.0;
/// Least fraction of the variance of the heights that the ridges explain.
const EXPLAINED_MIN: f64 = 0.75;
/// Largest fraction of missing points of a map.
const MISSING_MAX: f64 = 1.0 / 3.0;
/// Heights that differ from all neighbours by this fraction of the map's height are not part of a
/// ridge.
const SPIKE: f64 = 0.3;
/// Largest fraction of such heights; more are the noise of the map.
const SPIKES_MAX: f64 = 0.05;
/// Directions whose explained variances differ by less than this may be the same.
const ALIKE: f64 = 0.05;

/// Properties of a height map; lengths in µm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RidgeFacts {
    /// Azimuth in the map towards which the facets lean, from its rows of samples (u) towards its
    /// columns (v).
    pub lean_azimuth_deg: f64,
    /// Length of a ridge across, in the mean plane.
    pub period_um: f64,
    /// Width of a sample across the ridges.
    pub sample_um: f64,
    /// Number of whole ridges that are traced.
    pub ridges: usize,
    /// Height between the lowest and the highest point of the mean along the ridges.
    pub height_um: f64,
    /// Root mean square of the variation along a ridge (on the median line), including the
    /// instrument's noise.
    pub unevenness_um: f64,
    /// Fraction of the variance of the heights that the mean along the ridges explains.
    pub explained: f64,
    /// Effective ridge angle: the area-weighted median inclination of the surface on the facets'
    /// side.
    pub theta_r_deg: f64,
    /// Standard uncertainty of the angle of the lobe at that ridge angle, because of the samples'
    /// width and the heights' noise.
    #[serde(default)]
    pub lobe_error_deg: f64,
    /// Fraction of the heights that are missing or spikes; the mean does not use them.
    #[serde(default)]
    pub filled_share: f64,
    /// Fraction of a ridge that was not measured on any line along it, for example on steep walls:
    /// bridged by extending the adjacent flanks.
    #[serde(default, skip_serializing_if = "is_nothing")]
    pub unseen_share: f64,
}

/// Whether a fraction is 0.
fn is_nothing(share: &f64) -> bool {
    *share == 0.0
}

/// A profile across ridges, with its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct RidgeMap {
    /// All ridges of the map, averaged along them, µm.
    pub profile: SurfaceProfile,
    /// Properties of the map.
    pub facts: RidgeFacts,
}

/// Why a height map is not a map of ridges.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RidgeMapError {
    /// Invalid units.
    #[error("pitch and height unit of a map must be greater than 0 µm")]
    Units,
    /// Too few samples.
    #[error(
        "the map has {columns} × {rows} heights: a map of ridges needs 16 × 16 or more; give a profile (two columns, v and height) instead"
    )]
    Small {
        /// Along its rows.
        columns: usize,
        /// Along its columns.
        rows: usize,
    },
    /// Too many heights are missing.
    #[error("{missing} of {count} points have no height: fill them or crop the map first")]
    Missing {
        /// Number of missing points.
        missing: usize,
        /// Number of points.
        count: usize,
    },
    /// A height is out of range.
    #[error("row {row}, column {column}: the height is beyond 1e12 µm")]
    NotFinite {
        /// From 1.
        row: usize,
        /// From 1.
        column: usize,
    },
    /// All heights are equal.
    #[error("the map is flat: it has no ridges")]
    Flat,
    /// No direction explains the heights.
    #[error(
        "the map is not made of parallel ridges: in the best direction ({azimuth_deg:.1}° from its rows) they explain {:.0} % of its variance, but {:.0} % are needed; remove form and waviness, crop the map to the ridged part, or give a profile (two columns, v and height) instead",
        100.0 * .explained, 100.0 * EXPLAINED_MIN
    )]
    NotRidged {
        /// Direction across the ridges.
        azimuth_deg: f64,
        /// Fraction of the variance.
        explained: f64,
    },
    /// Too few ridges.
    #[error(
        "the map contains {ridges:.1} ridges of {period_um:.4} µm, but {RIDGES_MIN} are needed: measure a wider area, or give a profile (two columns, v and height) of one period instead"
    )]
    FewRidges {
        /// Number of ridges.
        ridges: f64,
        /// Length of a ridge.
        period_um: f64,
    },
    /// Too few samples per ridge.
    #[error(
        "a ridge of {period_um:.4} µm has {samples:.1} samples, but {SAMPLES_MIN} are needed: measure with a finer pitch"
    )]
    Coarse {
        /// Length of a ridge.
        period_um: f64,
        /// Number of samples.
        samples: f64,
    },
    /// The side of the facets is ambiguous.
    #[error(
        "the ridges lean about equally to both sides ({:.0} % to one of them), so they are not a sawtooth and the direction of +v is ambiguous; give a profile (two columns, v and height) instead",
        100.0 * .share
    )]
    BothSides {
        /// Fraction of the length across that leans to the facets' side.
        share: f64,
    },
    /// The resulting profile is invalid.
    #[error("the mean along the ridges: {0}")]
    Profile(#[from] ProfileError),
}

impl RidgeMap {
    /// Finds the ridges of a map.
    ///
    /// # Errors
    /// See [`RidgeMapError`].
    pub fn of(map: &HeightMap, units: MapUnits) -> Result<Self, RidgeMapError> {
        let good = |x: f64| x > 0.0 && x.is_finite();
        if !(units.pitch_um.iter().all(|p| good(*p)) && good(units.height_unit_um)) {
            return Err(RidgeMapError::Units);
        }
        let (columns, rows) = (map.columns, map.rows);
        if columns < 16 || rows < 16 || map.heights.len() != columns * rows {
            return Err(RidgeMapError::Small { columns, rows });
        }
        if let Some(at) = map
            .heights
            .iter()
            .position(|h| (h * units.height_unit_um).abs() >= 1e12)
        {
            return Err(RidgeMapError::NotFinite {
                row: at / columns + 1,
                column: at % columns + 1,
            });
        }
        let mut seen = std::borrow::Cow::Borrowed(map);
        let spikes = map.spikes(SPIKE);
        if !spikes.is_empty() && spikes.len() as f64 <= SPIKES_MAX * map.heights.len() as f64 {
            for n in spikes {
                seen.to_mut().heights[n] = f64::NAN;
            }
        }
        let (missing, count) = (seen.missing(), map.heights.len());
        if missing as f64 > MISSING_MAX * count as f64 {
            return Err(RidgeMapError::Missing { missing, count });
        }
        // The direction is found from interpolated heights, the mean from the measured ones only.
        let unseen: Vec<bool> = match missing {
            0 => Vec::new(),
            _ => seen.heights.iter().map(|h| h.is_nan()).collect(),
        };
        let mut heights = seen.filled();
        for h in &mut heights {
            *h *= units.height_unit_um;
        }
        take_off_plane(&mut heights, columns, units.pitch_um);
        let field = SampledHeights {
            columns,
            rows,
            pitch: units.pitch_um,
            heights: &heights,
            unseen: &unseen,
        };
        let variance = heights.iter().map(|h| h * h).sum::<f64>() / heights.len() as f64;
        let span = heights.iter().fold(0.0f64, |a, h| a.max(h.abs()));
        let given = seen.heights.iter().fold(0.0f64, |a, h| a.max(h.abs())) * units.height_unit_um;
        // A plane leaves only the rounding errors of its heights.
        if span <= 1e-12 * given || variance <= 0.0 {
            return Err(RidgeMapError::Flat);
        }
        let mut waves: Vec<(Wave, f64)> = Vec::new();
        for wave in field.strongest_waves() {
            let (wave, power) = field.sharpened(wave);
            if !waves.iter().any(|known| field.is_one(known.0, wave)) {
                waves.push((wave, power));
            }
        }
        let found: Vec<(RidgeLines, Wave, f64)> = waves
            .into_iter()
            .map(|(wave, power)| (field.aligned(wave), power))
            .map(|(wave, power)| (field.lines(wave, 1), wave, power))
            .collect();
        // Waves of one direction explain the same; the true one is the strongest.
        let most = found.iter().map(|f| f.0.explained);
        let most = most.fold(f64::NEG_INFINITY, f64::max);
        let best = found
            .into_iter()
            .filter(|f| f.0.explained >= most - ALIKE)
            .max_by(|a, b| a.2.total_cmp(&b.2));
        let Some((lines, wave, _)) = best else {
            return Err(RidgeMapError::Flat);
        };
        let across = wave[1].atan2(wave[0]);
        let period = 1.0 / wave[0].hypot(wave[1]);
        if lines.explained < EXPLAINED_MIN {
            // With few samples per ridge, most of the shape is between the samples.
            let samples = period / lines.width;
            if samples < SAMPLES_MIN && lines.explained > 0.4 * EXPLAINED_MIN {
                return Err(RidgeMapError::Coarse {
                    period_um: period,
                    samples,
                });
            }
            return Err(RidgeMapError::NotRidged {
                azimuth_deg: across.to_degrees(),
                explained: lines.explained,
            });
        }
        let mut made = field.fine_lines(wave).profile(&lines, period, across)?;
        made.facts.filled_share = missing as f64 / count as f64;
        Ok(made)
    }
}

impl RidgeFacts {
    /// Effects that tracing on the mean along the ridges leaves out.
    #[must_use]
    pub fn left_out(&self) -> Vec<LeftOut> {
        let mut list = vec![
            LeftOut::new(
                "unevenness along the ridges of the height map",
                format!(
                    "the map is traced as the mean along its {} ridges: {:.3} µm root mean square are left out of {:.3} µm of \
                     height, which is the fraction of a ridge by which the edges of shadows move at most; the slopes are part of the fitted roughness",
                    self.ridges, self.unevenness_um, self.height_um
                ),
                Some((self.unevenness_um / self.height_um).min(1.0)),
            ),
            LeftOut::new(
                "corners of the ridges sharper than a sample of the height map",
                format!(
                    "samples of {:.4} µm on ridges of {:.4} µm: at most one sample per ridge is affected",
                    self.sample_um, self.period_um
                ),
                Some((self.sample_um / self.period_um).min(1.0)),
            ),
        ];
        if self.filled_share > 0.0 {
            let bridged = match self.unseen_share > 0.0 {
                true => format!(
                    "; {} of a ridge is not measured anywhere along it, mostly on steep walls: the adjacent flanks are extended until \
                     half of the gap is left, and the change of the result if they are extended over the whole gap is in the line \
                     `model` of the budget",
                    percent(self.unseen_share)
                ),
                false => String::new(),
            };
            list.push(LeftOut::new(
                "missing points of the height map",
                format!(
                    "{} of its heights are missing or spikes and are not used for the mean along the ridges{bridged}",
                    percent(self.filled_share)
                ),
                Some(self.filled_share),
            ));
        }
        list
    }
}
