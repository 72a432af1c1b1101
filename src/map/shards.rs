//! A part of a map's tiles, fitted apart, and the map that all parts make, bit for bit.
//!
//! Every part reads all frames and determines what the pixels share: equal frames give equal numbers on equal processors, and
//! [`merged`] refuses parts that differ in any. Borders and defects depend on the whole map, so the merge finds them.

use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::basis::{Basis, finished};
use super::folder::StageTimes;
use super::layers::Answer;
use super::signals::planes::TILE;
use super::summary::Timing;
use super::tiles::{Tiles, fit_tiles, tiles_of};
use super::{Map, MapError, MapOptions, Progress, prepared};
use crate::reduction::FrameSource;
use crate::shard::Shard;

/// A fitted part of a map.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct MapPart {
    basis: Basis,
    /// Numbers of the tiles with their pixels.
    tiles: Vec<(usize, Vec<Answer>)>,
    evaluations: f64,
    timing: Timing,
}

/// Why there is no part of a map, or no map of the parts.
#[derive(Debug, thiserror::Error)]
pub enum PartError {
    /// The map failed.
    #[error(transparent)]
    Map(#[from] MapError),
    /// There are fewer tiles than shards.
    #[error("there are only {most} tiles of {TILE} pixels")]
    TooMany {
        /// Tiles of the map.
        most: usize,
    },
    /// The parts were made from other frames or on processors that round differently.
    #[error(
        "shard {0} found other shared quantities than shard 1: it read other frames, or ran on a processor that rounds differently; map it again from the same frames on a machine like that of shard 1"
    )]
    Other(usize),
    /// A tile is in no part or in two.
    #[error("the shards do not contain each tile once: map them again with one program")]
    Tiles,
}

/// Fits the tiles of a shard.
///
/// # Errors
/// [`PartError::TooMany`] before any frame is read; otherwise as [`super::map`].
pub fn part(
    source: &dyn FrameSource,
    options: &MapOptions,
    shard: Shard,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<MapPart, PartError> {
    let camera = &source.manifest().camera;
    let most = (camera.width_px as usize * camera.height_px as usize).div_ceil(TILE);
    if shard.of > most as u64 {
        return Err(PartError::TooMany { most });
    }
    let stages = StageTimes::start();
    let progress = |p: Progress| {
        stages.note(p.stage);
        progress(p);
    };
    let never = || false;
    let (planes, settled, basis) = prepared(source, options, &never, &progress, cancel)?;
    let fitted = fit_tiles(&planes, &settled, shard, &never, &progress, cancel)?;
    let pixels = |tile| planes.range(tile).map(|pixel| fitted.layers.get(pixel));
    let own = tiles_of(&planes, shard);
    let tiles = own.into_iter().map(|tile| (tile, pixels(tile).collect()));
    Ok(MapPart {
        basis,
        tiles: tiles.collect(),
        evaluations: fitted.evaluations,
        timing: stages.timing(),
    })
}

/// Makes the map of all parts, by the number of the shard. The seconds of each step are the sum over the shards.
///
/// # Errors
/// [`PartError`].
pub fn merged(parts: Vec<MapPart>) -> Result<(Map, Timing), PartError> {
    let mut parts = parts.into_iter();
    let first = parts.next().ok_or(PartError::Tiles)?;
    let mut layers = first.basis.layers();
    let pixels = layers.flags.len();
    let mut fitted = vec![false; pixels.div_ceil(TILE)];
    let (mut evaluations, mut timing) = (first.evaluations, first.timing);
    let mut tiles = first.tiles;
    for (n, part) in parts.enumerate() {
        if part.basis != first.basis {
            return Err(PartError::Other(n + 2));
        }
        tiles.extend(part.tiles);
        // Whole numbers: their sum does not depend on the order.
        evaluations += part.evaluations;
        timing = timing.plus(&part.timing);
    }
    for (tile, answers) in tiles {
        let start = tile * TILE;
        let is_free = fitted.get(tile) == Some(&false);
        if !is_free || answers.len() != TILE.min(pixels - start) {
            return Err(PartError::Tiles);
        }
        fitted[tile] = true;
        for (pixel, answer) in (start..).zip(&answers) {
            layers.put(pixel, answer);
        }
    }
    if fitted.contains(&false) {
        return Err(PartError::Tiles);
    }
    let map = finished(
        first.basis,
        Tiles {
            layers,
            evaluations,
            pixels,
        },
    )?;
    Ok((map, timing))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::map::layers::FEW_OBSERVATIONS;
    use crate::series::Series;

    fn series() -> Series {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
        Series::open(&folder).unwrap()
    }

    /// The only part of a map of 128 × 128 pixels, none of which was fitted: four tiles.
    fn whole(birge: f64) -> MapPart {
        let tile = |tile| (tile, vec![Answer::none(FEW_OBSERVATIONS, tile); TILE]);
        MapPart {
            basis: Basis::empty(series().manifest(), birge),
            tiles: (0..4).map(tile).collect(),
            evaluations: 0.0,
            timing: Timing::default(),
        }
    }

    #[test]
    fn a_part_keeps_every_bit_of_what_the_pixels_share() {
        let part = whole(1.5);
        let bytes = postcard::to_allocvec(&part).unwrap();
        let again: MapPart = postcard::from_bytes(&bytes).unwrap();
        assert!(again.basis == part.basis);
        assert_eq!(format!("{:?}", again.basis), format!("{:?}", part.basis));
    }

    #[test]
    fn more_shards_than_tiles_are_refused_before_a_frame_is_read() {
        let (options, never) = (MapOptions::default(), AtomicBool::new(false));
        let shard = Shard { number: 1, of: 5 };
        let refused = part(&series(), &options, shard, &|_| {}, &never);
        assert!(matches!(refused, Err(PartError::TooMany { most: 4 })));
    }

    #[test]
    fn parts_of_other_frames_and_tiles_that_are_missing_or_double_are_refused() {
        let with = |change: &dyn Fn(&mut MapPart)| {
            let mut part = whole(1.5);
            change(&mut part);
            part
        };
        let missing = with(&|part| drop(part.tiles.pop()));
        let double = with(&|part| part.tiles[0].0 = part.tiles[1].0);
        let beyond = with(&|part| part.tiles[0].0 = usize::MAX / TILE);
        let short = with(&|part| part.tiles[0].1.truncate(1));
        for parts in [
            vec![],
            vec![missing],
            vec![double],
            vec![beyond],
            vec![short],
            vec![whole(1.5), whole(1.5)],
        ] {
            assert!(matches!(merged(parts), Err(PartError::Tiles)));
        }
        let other = vec![whole(1.5), whole(1.5f64.next_up())];
        assert!(matches!(merged(other), Err(PartError::Other(2))));
        // All tiles are there, but no pixel was fitted.
        let none = merged(vec![whole(1.5)]);
        assert!(matches!(
            none,
            Err(PartError::Map(MapError::NothingFitted { .. }))
        ));
    }
}
