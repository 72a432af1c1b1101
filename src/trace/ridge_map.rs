//! A measured height map of parallel ridges as a profile across them.
//!
//! Call [`RidgeMap::of`]. It finds the ridges' direction and period by their strongest waves, levels the map by the rule that
//! a ridge is as high as its neighbours, and takes the mean along the ridges; every ridge of the map stays as it is, so that
//! wear and burrs which differ from ridge to ridge are traced. What varies along the ridges is left out and told. A map
//! without one direction of ridges is refused. It knows no files: heights are handed in.

mod field;
mod gaps;
mod lines;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

use super::profile::{Profile, ProfileError};
use super::scene::{HeightMap, MapUnits};
use crate::model::LeftOut;
use crate::wording::percent;
use field::{Field, Wave, take_off_plane};
use lines::Lines;
#[cfg(test)]
pub(crate) use tests::map_of as height_map_of;

/// Ridges that a map shows at least: two could be anything.
const RIDGES_MIN: f64 = 3.0;
/// Samples per ridge at least: fewer do not show its shape.
const SAMPLES_MIN: f64 = 8.0;
/// Share of the heights' variance that ridges explain at least.
const EXPLAINED_MIN: f64 = 0.75;
/// Share of points without a height up to which a map is read.
const MISSING_MAX: f64 = 1.0 / 3.0;
/// Heights that stand off all around them by this share of the map's height are no part of a ridge.
const SPIKE: f64 = 0.3;
/// Share of such heights beyond which they are the map's noise.
const SPIKES_MAX: f64 = 0.05;
/// Directions that explain the variance as well as another within this may be the same.
const ALIKE: f64 = 0.05;

/// What was found in a height map; lengths in µm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RidgeFacts {
    /// Direction in the map, from along its rows of samples (u) to along its columns (v), in which the facets lean.
    pub lean_azimuth_deg: f64,
    /// Length of a ridge across, mean plane.
    pub period_um: f64,
    /// Width of a sample across the ridges.
    pub sample_um: f64,
    /// Whole ridges that are traced.
    pub ridges: usize,
    /// From the lowest to the highest point of the mean along the ridges.
    pub height_um: f64,
    /// Root mean square of what varies along a ridge (of the median line along them), the instrument's noise included.
    pub unevenness_um: f64,
    /// Share of the heights' variance that the mean along the ridges explains.
    pub explained: f64,
    /// Effective ridge angle: the median inclination, by area, of what leans to the facets' side.
    pub theta_r_deg: f64,
    /// How far the angle that light follows may be off at that angle: samples have a width, and heights noise (standard
    /// uncertainty).
    #[serde(default)]
    pub lobe_error_deg: f64,
    /// Share of the heights that are missing or stand off all around them (spikes): they take no part in the mean.
    #[serde(default)]
    pub filled_share: f64,
    /// Share of a ridge that no line along it shows, as where steep walls were not seen: bridged along the flanks beside it.
    #[serde(default, skip_serializing_if = "is_nothing")]
    pub unseen_share: f64,
}

/// Whether a share is 0.
fn is_nothing(share: &f64) -> bool {
    *share == 0.0
}

/// A profile across ridges, and what it was made of.
#[derive(Debug, Clone, PartialEq)]
pub struct RidgeMap {
    /// All ridges of the map, the mean along them, µm.
    pub profile: Profile,
    /// What was found.
    pub facts: RidgeFacts,
}

/// Why a height map is none of ridges.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RidgeMapError {
    /// Units that are none.
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
    /// Heights are missing.
    #[error("{missing} of {count} points have no height: fill them or cut them off first")]
    Missing {
        /// How many of them.
        missing: usize,
        /// How many points there are.
        count: usize,
    },
    /// A height that is none.
    #[error("row {row}, column {column}: the height is beyond 1e12 µm")]
    NotFinite {
        /// 1 for the first.
        row: usize,
        /// 1 for the first.
        column: usize,
    },
    /// The same height everywhere.
    #[error("the map is flat: there are no ridges on it")]
    Flat,
    /// No direction explains the heights.
    #[error(
        "the map is not made of parallel ridges: along the best direction found ({azimuth_deg:.1}° from its rows) they explain {:.0} % of its variance, {:.0} % are needed; take off form and waviness, cut it to the ridged part, or give a profile (two columns, v and height) instead",
        100.0 * .explained, 100.0 * EXPLAINED_MIN
    )]
    NotRidged {
        /// Direction across the ridges.
        azimuth_deg: f64,
        /// Share of the variance.
        explained: f64,
    },
    /// Hardly any ridge.
    #[error(
        "the map shows {ridges:.1} ridges of {period_um:.4} µm; {RIDGES_MIN} are needed: measure a wider piece, or give a profile (two columns, v and height) of one period instead"
    )]
    FewRidges {
        /// How many.
        ridges: f64,
        /// How long.
        period_um: f64,
    },
    /// Ridges of a few pixels.
    #[error(
        "a ridge of {period_um:.4} µm has {samples:.1} samples; {SAMPLES_MIN} are needed: measure with a finer pitch"
    )]
    Coarse {
        /// How long.
        period_um: f64,
        /// How many.
        samples: f64,
    },
    /// No side of the facets.
    #[error(
        "the ridges lean to both sides alike ({:.0} % to one of them), so they are not a sawtooth and the direction of +v is not known; give a profile (two columns, v and height) instead",
        100.0 * .share
    )]
    BothSides {
        /// Share of the length across that leans to the side of the facets.
        share: f64,
    },
    /// What the profile says.
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
        // The direction is found on heights that are everywhere, the mean is that of those seen.
        let unseen: Vec<bool> = match missing {
            0 => Vec::new(),
            _ => seen.heights.iter().map(|h| h.is_nan()).collect(),
        };
        let mut heights = seen.filled();
        for h in &mut heights {
            *h *= units.height_unit_um;
        }
        take_off_plane(&mut heights, columns, units.pitch_um);
        let field = Field {
            columns,
            rows,
            pitch: units.pitch_um,
            heights: &heights,
            unseen: &unseen,
        };
        let variance = heights.iter().map(|h| h * h).sum::<f64>() / heights.len() as f64;
        let span = heights.iter().fold(0.0f64, |a, h| a.max(h.abs()));
        let given = seen.heights.iter().fold(0.0f64, |a, h| a.max(h.abs())) * units.height_unit_um;
        // A plane leaves the rounding of its own numbers.
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
        let found: Vec<(Lines, Wave, f64)> = waves
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
            // Of ridges of a few samples most lies between the samples.
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
    /// What tracing on the mean along the ridges does without.
    #[must_use]
    pub fn left_out(&self) -> Vec<LeftOut> {
        let mut list = vec![
            LeftOut::new(
                "unevenness along the ridges of the height map",
                format!(
                    "the map is traced as the mean along its {} ridges: {:.3} µm root mean square are left of {:.3} µm of \
                     height, by which share of a ridge the edges of shadows move at most; its slopes are in the fitted roughness",
                    self.ridges, self.unevenness_um, self.height_um
                ),
                Some((self.unevenness_um / self.height_um).min(1.0)),
            ),
            LeftOut::new(
                "corners of the ridges that are sharper than a sample of the height map",
                format!(
                    "samples of {:.4} µm on ridges of {:.4} µm: no more of a ridge than one of them",
                    self.sample_um, self.period_um
                ),
                Some((self.sample_um / self.period_um).min(1.0)),
            ),
        ];
        if self.filled_share > 0.0 {
            let bridged = match self.unseen_share > 0.0 {
                true => format!(
                    "; {} of a ridge is seen nowhere along it, mostly on steep walls: the flanks beside it go on into it until \
                     half of it is left, and how far the answer moves if they go on until nothing is left is in the line \
                     `model` of the budget",
                    percent(self.unseen_share)
                ),
                false => String::new(),
            };
            list.push(LeftOut::new(
                "points of the height map that the instrument did not see",
                format!(
                    "{} of its heights are missing or spikes and take no part in the mean along the ridges{bridged}",
                    percent(self.filled_share)
                ),
                Some(self.filled_share),
            ));
        }
        list
    }
}
