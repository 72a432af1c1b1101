//! Shapes of interfaces: the keys of each shape, and the surface that it builds.
//!
//! A key that a shape does not have is an error, and so is a missing required key. Called by
//! [`Scene::prepare`] for each interface.

use std::sync::Arc;

use serde::Deserialize;

use super::super::rng::{Purpose, RandomStream};
use super::{HeightMap, LeftOut, Scene, SceneError, positive, value};
use crate::trace::facets::scattering::Roughness;
use crate::trace::photons::interface::Relief;
use crate::trace::surfaces::beckmann;
use crate::trace::surfaces::beckmann::beckmann;
use crate::trace::surfaces::crystals;
use crate::trace::surfaces::crystals::crystals;
use crate::trace::surfaces::height_field::HeightField;
use crate::trace::surfaces::surface_profile::lowest_and_highest;
use crate::trace::surfaces::worn_ridges::WornRidges;
use crate::wording::{percent, significant};

/// One interface as written; the allowed keys depend on `shape`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InterfaceShape {
    /// `flat`, `beckmann`, `smith`, `ridges`, `profile`, `crystals` or `file`.
    pub shape: String,
    /// The medium below: `{ n, k, rho_d }` or a material's name.
    pub below: toml::Value,
    /// Thickness of the layer below, µm; required if it absorbs.
    pub thickness_um: Option<f64>,
    /// Beckmann α along u.
    pub alpha_u: Option<f64>,
    /// Beckmann α along v.
    pub alpha_v: Option<f64>,
    /// Seed of the surface.
    pub seed: Option<u64>,
    /// Cells per side of a random tile.
    pub cells: Option<usize>,
    /// Ridge angle, degrees.
    pub theta_r_deg: Option<f64>,
    /// Facet length of ridges, or the spacing of a file's samples, µm.
    pub pitch_um: Option<f64>,
    /// Radius of crests and valleys, µm.
    pub round_um: Option<f64>,
    /// The same as a fraction of the pitch.
    pub round: Option<f64>,
    /// Angle by which the risers are flatter than perpendicular to their facets, degrees.
    pub draft_deg: Option<f64>,
    /// Mean height of burrs on the crests, µm.
    pub burr_um: Option<f64>,
    /// Mean size of the crystals, µm.
    pub size_um: Option<f64>,
    /// Number of crystals per size².
    pub cover: Option<f64>,
    /// A file of heights.
    pub path: Option<String>,
    /// Micrometres per unit of the file's heights.
    pub height_unit_um: Option<f64>,
}

impl InterfaceShape {
    /// Whether the surface is random: one realisation of its statistics.
    pub(super) fn is_drawn(&self) -> bool {
        matches!(self.shape.as_str(), "beckmann" | "crystals")
            || self.burr_um.is_some_and(|burr| burr > 0.0)
    }
}

/// Default number of crystals per size²: almost the whole plane is covered.
const COVER: f64 = 3.0;

impl Scene {
    /// Cells per side and seed of a random tile.
    fn tile(&self, keys: &Keys<'_>) -> Result<(usize, u64), SceneError> {
        let cells = keys.shape.cells.unwrap_or(beckmann::CELLS);
        if !(16..=4096).contains(&cells) {
            return Err(value(&keys.name("cells"), cells, "must be from 16 to 4096"));
        }
        // Without a seed of its own, each interface derives a different one from the run's.
        let seed = keys.shape.seed.unwrap_or_else(|| {
            RandomStream::new(self.run.seed, Purpose::Surface, keys.number as u64).bits()
        });
        Ok((cells, seed))
    }

    /// Builds the relief of an interface and the roughness of its facets.
    pub(super) fn relief(
        &self,
        shape: &InterfaceShape,
        number: usize,
        load: &dyn Fn(&str) -> Result<HeightMap, String>,
        left_out: &mut Vec<LeftOut>,
    ) -> Result<Made, SceneError> {
        let keys = Keys { shape, number };
        match shape.shape.as_str() {
            "flat" => keys.only(&[]).map(|()| (Relief::Flat, None)),
            "smith" => smith(&keys),
            "beckmann" => self.beckmann(&keys, left_out),
            "crystals" => self.crystals(&keys, left_out),
            "ridges" => self.ridges(&keys, left_out),
            "profile" => profile(&keys, load, left_out),
            "file" => file(&keys, load, left_out),
            other => Err(value(
                &keys.name("shape"),
                format!("{other:?}"),
                "must be flat, beckmann, smith, ridges, profile, crystals or file",
            )),
        }
    }

    /// A height field with normally distributed slopes.
    fn beckmann(&self, keys: &Keys<'_>, left_out: &mut Vec<LeftOut>) -> Result<Made, SceneError> {
        keys.only(&["alpha_u", "alpha_v", "seed", "cells"])?;
        let Roughness { alpha_u, alpha_v } = keys.roughness()?;
        let (cells, seed) = self.tile(keys)?;
        let field = beckmann(cells, alpha_u, alpha_v, seed);
        left_out.extend(beckmann::few_cells(cells, keys.number));
        Ok((Relief::Field(Arc::new(field)), None))
    }

    /// A height field of etched crystals.
    fn crystals(&self, keys: &Keys<'_>, left_out: &mut Vec<LeftOut>) -> Result<Made, SceneError> {
        keys.only(&["size_um", "cover", "seed", "cells"])?;
        let size = keys.need("size_um", keys.shape.size_um)?;
        let cover = keys.need("cover", keys.shape.cover.or(Some(COVER)))?;
        if cover > 100.0 {
            return Err(value(&keys.name("cover"), cover, "must be 100 or less"));
        }
        let (cells, seed) = self.tile(keys)?;
        if crystals::count(cells, cover) == 0 {
            return Err(value(
                &keys.name("cover"),
                cover,
                "is less than half a crystal on the tile of (cells / 16)² sizes: raise cover or cells",
            ));
        }
        left_out.extend(crystals::rounded(cells, cover, keys.number));
        left_out.push(LeftOut {
            what: format!("overhangs of the crystals of interface {}", keys.number),
            why: "a height field has none: overhanging faces become vertical".to_owned(),
            cost: None,
        });
        let field = crystals(cells, size, cover, seed);
        Ok((Relief::Field(Arc::new(field)), None))
    }

    /// A sawtooth, possibly worn or with burrs.
    fn ridges(&self, keys: &Keys<'_>, left_out: &mut Vec<LeftOut>) -> Result<Made, SceneError> {
        keys.only(&[
            "theta_r_deg",
            "pitch_um",
            "round_um",
            "round",
            "draft_deg",
            "burr_um",
            "seed",
            "alpha_u",
            "alpha_v",
        ])?;
        let theta = keys.need("theta_r_deg", keys.shape.theta_r_deg)?;
        if theta > 85.0 {
            return Err(value(
                &keys.name("theta_r_deg"),
                theta,
                "must be 85 or less",
            ));
        }
        let pitch = keys.need("pitch_um", keys.shape.pitch_um)?;
        if keys.shape.round.is_some() && keys.shape.round_um.is_some() {
            let expected = "is round_um in units of the pitch: give only one of them";
            return Err(value(
                &keys.name("round"),
                keys.shape.round.unwrap_or(0.0),
                expected,
            ));
        }
        let round = match keys.shape.round {
            Some(share) => keys.none_or_more("round", share)? * pitch,
            None => keys.none_or_more("round_um", keys.shape.round_um.unwrap_or(0.0))?,
        };
        if round > 100.0 * pitch {
            let expected = "is more than 100 pitches: the ridges would vanish";
            return Err(value(&keys.name("round_um"), round, expected));
        }
        let draft = keys.none_or_more("draft_deg", keys.shape.draft_deg.unwrap_or(0.0))?;
        let burr = keys.none_or_more("burr_um", keys.shape.burr_um.unwrap_or(0.0))?;
        let ridges = WornRidges {
            theta_r: theta.to_radians(),
            pitch,
            round,
            draft: draft.to_radians(),
            burr,
            seed: keys.shape.seed.unwrap_or(self.run.seed),
        };
        let profile = ridges.profile().map_err(|source| SceneError::Profile {
            number: keys.number,
            source,
        })?;
        left_out.extend(ridges.burr_cut().map(|(most, mean)| LeftOut {
            what: format!("the tops of tall burrs of interface {}", keys.number),
            why: format!(
                "a burr must fit on its facet: burrs above {} µm are truncated, so their mean height is {} µm, not \
                 the {burr} µm of burr_um",
                significant(most),
                significant(mean)
            ),
            cost: None,
        }));
        Ok((
            Relief::Profile(Arc::new(profile)),
            keys.optional_roughness()?,
        ))
    }
}

/// A flat boundary with microfacets.
fn smith(keys: &Keys<'_>) -> Result<Made, SceneError> {
    keys.only(&["alpha_u", "alpha_v"])?;
    Ok((Relief::Flat, Some(keys.roughness()?)))
}

/// The profile in a file.
fn profile(
    keys: &Keys<'_>,
    load: &dyn Fn(&str) -> Result<HeightMap, String>,
    left_out: &mut Vec<LeftOut>,
) -> Result<Made, SceneError> {
    keys.only(&["path", "alpha_u", "alpha_v"])?;
    let map = keys.load(load)?;
    let profile = map.profile().map_err(|e| keys.file_error(e.to_string()))?;
    let unit = map.height_unit_um.unwrap_or(1.0);
    left_out.extend(reading(&map, keys.number));
    let steps = profile.pieces().iter().map(|p| p.to - p.from);
    let finest = steps.fold(f64::INFINITY, f64::min);
    left_out.extend(lost_digits(unit * map.last_digit(), finest, keys.number));
    Ok((
        Relief::Profile(Arc::new(profile)),
        keys.optional_roughness()?,
    ))
}

/// The height map in a file.
fn file(
    keys: &Keys<'_>,
    load: &dyn Fn(&str) -> Result<HeightMap, String>,
    left_out: &mut Vec<LeftOut>,
) -> Result<Made, SceneError> {
    keys.only(&["path", "pitch_um", "height_unit_um", "alpha_u", "alpha_v"])?;
    let map = keys.load(load)?;
    // The scene overrides the file.
    let pitch = match (keys.shape.pitch_um, map.pitch_um) {
        (None, Some(pitch_um)) => pitch_um,
        _ => [keys.need("pitch_um", keys.shape.pitch_um)?; 2],
    };
    if let Some([u, v]) = map.spacing
        && (u / v - 1.0).abs() > 0.01
    {
        return Err(keys.file_error(format!(
            "its points are spaced {} along x and {} along y, which one pitch_um cannot state: name the columns with \
             their units, for example x_um y_um z_um",
            significant(u),
            significant(v)
        )));
    }
    let unit = match (keys.shape.height_unit_um, map.height_unit_um) {
        (None, Some(unit_um)) => unit_um,
        _ => keys.need("height_unit_um", keys.shape.height_unit_um)?,
    };
    if map.missing_share() > MISSING_MAX {
        return Err(keys.file_error(format!(
            "{} of {} points have no height: fill them or crop the map first",
            map.missing(),
            map.heights.len()
        )));
    }
    let field = field_of(&map, pitch, unit).map_err(|r| keys.file_error(r.to_owned()))?;
    let (low, high) = field.range();
    let stored = f64::from(f32::EPSILON) * low.abs().max(high.abs());
    left_out.extend(lost_digits(
        stored.max(unit * map.last_digit()),
        pitch[0].min(pitch[1]),
        keys.number,
    ));
    left_out.extend(reading(&map, keys.number));
    left_out.extend(filled_gaps(map.missing_share()));
    let spikes = map.spikes(1.0).len();
    if spikes > 0 {
        left_out.push(LeftOut {
            what: format!("whether spikes of the map of interface {} are real", keys.number),
            why: format!(
                "{} from all neighbours by more than the map's height; they are traced as they are: if they are artefacts, \
                 remove them or mark them as missing (NaN)",
                match spikes {
                    1 => "1 height differs".to_owned(),
                    n => format!("{n} heights differ"),
                }
            ),
            cost: Some(spikes as f64 / map.heights.len() as f64),
        });
    }
    left_out.push(LeftOut {
        what: format!("the surface beyond the map of interface {}", keys.number),
        why: "the map is repeated; a wall arises where its opposite rims differ".to_owned(),
        cost: None,
    });
    Ok((Relief::Field(Arc::new(field)), keys.optional_roughness()?))
}

/// Largest fraction of missing points up to which a map is filled and traced.
const MISSING_MAX: f64 = 0.1;

/// Notes on how an ambiguous file was read.
fn reading(map: &HeightMap, number: usize) -> impl Iterator<Item = LeftOut> {
    let what = format!("another reading of the file of interface {number}");
    map.notes.iter().map(move |note| LeftOut {
        what: what.clone(),
        why: note.clone(),
        cost: None,
    })
}

/// The effect of missing points that were interpolated; `share` is their fraction.
fn filled_gaps(share: f64) -> Option<LeftOut> {
    (share > 0.0).then(|| LeftOut {
        what: "missing points of the height map".to_owned(),
        why: format!(
            "{} of its heights are missing and were interpolated linearly along their row or column; instruments miss \
             the steepest parts first",
            percent(share)
        ),
        cost: Some(share),
    })
}

/// Slope by the last digits of the heights that is not reported: six thousandths of a degree.
const LOST_SLOPE: f64 = 1e-4;

/// Reports heights that are known only to `digit_um`, which is a slope between samples `step_um`
/// apart.
fn lost_digits(digit_um: f64, step_um: f64, number: usize) -> Option<LeftOut> {
    let slope = digit_um / step_um;
    (slope > LOST_SLOPE).then(|| LeftOut {
        what: format!("the last digits of the heights of interface {number}"),
        why: format!(
            "the heights are so large that their last digit is {} µm, a slope of up to {}° between two samples: subtract a \
             constant from the heights, or remove points far above or below the rest",
            significant(digit_um),
            significant(slope.atan().to_degrees())
        ),
        cost: None,
    })
}

fn field_of(map: &HeightMap, pitch: [f64; 2], unit: f64) -> Result<HeightField, &'static str> {
    let (columns, rows) = (map.columns, map.rows);
    if columns == 0 || rows == 0 || map.heights.len() != columns * rows {
        return Err("the map is not a full rectangle of heights");
    }
    if columns.saturating_mul(rows) > 1 << 26 {
        return Err("the map has more than 67 million heights");
    }
    let filled = map.filled();
    if filled.iter().any(|h| h.is_nan()) {
        return Err("the map contains no heights");
    }
    if !filled.iter().all(|h| (h * unit).abs() < 1e12) {
        return Err("the map contains a height beyond 1e12 in the scene's unit");
    }
    // A field keeps seven digits of the relief, whatever the zero of its file.
    let (low, high) = lowest_and_highest(filled.iter().copied());
    let middle = 0.5 * (low + high);
    let mut heights = vec![0.0; columns * rows];
    for (n, h) in filled.iter().enumerate() {
        heights[(n % columns) * rows + n / columns] = (h - middle) * unit;
    }
    Ok(HeightField::new(
        columns, rows, pitch[0], pitch[1], &heights,
    ))
}

/// The relief of an interface and the roughness of its facets.
type Made = (Relief, Option<Roughness>);

/// The keys of one interface, with its number from the top.
struct Keys<'a> {
    shape: &'a InterfaceShape,
    number: usize,
}

/// On a rougher surface light passes from needle to needle until it is given up, and squares of
/// larger slopes overflow.
const ALPHA_MAX: f64 = 1e8;

impl Keys<'_> {
    fn name(&self, key: &str) -> String {
        format!("interface {}: {key}", self.number)
    }

    fn missing(&self, key: &'static str) -> SceneError {
        SceneError::Missing {
            number: self.number,
            shape: self.shape.shape.clone(),
            key,
        }
    }

    /// Returns the error of the file that `path` names.
    fn file_error(&self, reason: String) -> SceneError {
        SceneError::File {
            number: self.number,
            path: self.shape.path.clone().unwrap_or_default(),
            reason,
        }
    }

    /// Reads the file that `path` names.
    fn load(
        &self,
        load: &dyn Fn(&str) -> Result<HeightMap, String>,
    ) -> Result<HeightMap, SceneError> {
        let path = self.shape.path.as_deref();
        let path = path.ok_or_else(|| self.missing("path"))?;
        load(path).map_err(|reason| self.file_error(reason))
    }

    fn need(&self, key: &'static str, x: Option<f64>) -> Result<f64, SceneError> {
        let x = x.ok_or_else(|| self.missing(key))?;
        positive(&self.name(key), x)?;
        Ok(x)
    }

    fn roughness(&self) -> Result<Roughness, SceneError> {
        let alpha = |key: &'static str, x: Option<f64>| match self.need(key, x)? {
            alpha if alpha <= ALPHA_MAX => Ok(alpha),
            alpha => Err(value(&self.name(key), alpha, "must be at most 1e8")),
        };
        Ok(Roughness {
            alpha_u: alpha("alpha_u", self.shape.alpha_u)?,
            alpha_v: alpha("alpha_v", self.shape.alpha_v)?,
        })
    }

    /// The roughness, if given; only one of the two keys is an error.
    fn optional_roughness(&self) -> Result<Option<Roughness>, SceneError> {
        match (self.shape.alpha_u, self.shape.alpha_v) {
            (None, None) => Ok(None),
            _ => self.roughness().map(Some),
        }
    }

    fn none_or_more(&self, key: &'static str, x: f64) -> Result<f64, SceneError> {
        if x >= 0.0 && x.is_finite() {
            Ok(x)
        } else {
            Err(value(&self.name(key), x, "must be 0 or more"))
        }
    }

    /// Refuses keys that the shape does not have.
    fn only(&self, known: &[&str]) -> Result<(), SceneError> {
        let s = self.shape;
        let given = [
            ("alpha_u", s.alpha_u.is_some()),
            ("alpha_v", s.alpha_v.is_some()),
            ("seed", s.seed.is_some()),
            ("cells", s.cells.is_some()),
            ("theta_r_deg", s.theta_r_deg.is_some()),
            ("pitch_um", s.pitch_um.is_some()),
            ("round_um", s.round_um.is_some()),
            ("round", s.round.is_some()),
            ("draft_deg", s.draft_deg.is_some()),
            ("burr_um", s.burr_um.is_some()),
            ("size_um", s.size_um.is_some()),
            ("cover", s.cover.is_some()),
            ("path", s.path.is_some()),
            ("height_unit_um", s.height_unit_um.is_some()),
        ];
        match given.iter().find(|(key, is)| *is && !known.contains(key)) {
            Some((key, _)) => Err(SceneError::Foreign {
                number: self.number,
                shape: s.shape.clone(),
                key,
            }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ridges of 20 steps of 1 µm that fall by 10°, in µm above `offset_um`.
    fn sawtooth(offset_um: f64) -> Vec<f64> {
        let fall = 10f64.to_radians().tan();
        let ridge = (0..20).map(|n| offset_um - fall * f64::from(n));
        ridge.collect()
    }

    fn prepared(shape: &str, map: &HeightMap) -> (f64, Vec<LeftOut>) {
        let text = format!("[[interface]]\n{shape}\npath = \"a.csv\"\nbelow = \"Au550\"\n");
        let scene = Scene::parse(&text).unwrap();
        let ready = scene.prepare(&|_| Ok(map.clone())).unwrap();
        let lost = ready.left_out.into_iter();
        let lost = lost.filter(|l| l.what.starts_with("the last digits"));
        (ready.ridge_angles[0].theta_r_deg, lost.collect())
    }

    #[test]
    fn the_zero_of_a_files_heights_has_no_effect_until_digits_are_lost() {
        let field = |offset_um: f64, tower_um: f64| {
            let mut heights: Vec<f64> = sawtooth(offset_um).repeat(5);
            heights[0] += tower_um;
            let map = HeightMap::new(1, heights);
            prepared(
                "shape = \"file\"\npitch_um = 1.0\nheight_unit_um = 1.0",
                &map,
            )
        };
        let profile = |offset_um: f64| {
            let mut rows: Vec<f64> = Vec::new();
            for (v, z) in (0..).map(f64::from).zip(sawtooth(offset_um)) {
                rows.extend([v, z]);
            }
            rows.extend([20.0, offset_um]);
            let map = HeightMap::new(2, rows);
            prepared("shape = \"profile\"", &map)
        };
        for offset_um in [0.0, 25e3, 1e6, -1e8] {
            for (angle_deg, lost) in [field(offset_um, 0.0), profile(offset_um)] {
                assert!((angle_deg - 10.0).abs() < 2e-3, "{offset_um}: {angle_deg}");
                assert!(lost.is_empty(), "{offset_um}: {lost:?}");
            }
        }
        // 9e11 has steps of 1e-4 µm; with a tower of 10 mm, the field's seven digits resolve 5e-4
        // µm.
        for (_, lost) in [field(9e11, 0.0), profile(9e11), field(0.0, 1e4)] {
            assert_eq!(lost.len(), 1);
        }
    }
}
