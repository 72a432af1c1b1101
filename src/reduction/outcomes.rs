//! Every frame of a series → what a reduction needs of it, each frame read once.
//!
//! [`calibration`] reads darks and flats, [`outcomes`] reads samples: what the cache has is not read again. Samples are
//! measured with the counts as they are, since the camera's curve is known only once all poses were compared; the sums are
//! corrected for it later.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use super::cache::Kept;
use super::calibration::{Preparation, Prepared, prepare};
use super::calibration_sums::{Calibration, CalibrationSums};
use super::detector::{self, Detector, Exposures};
use super::flats::Judged;
use super::load::{Calls, is_of_counts, load_once};
use super::measure::{FrameOutcome, MeasurementContext};
use super::region::Segments;
use super::register::{self, Picture};
use super::series_context::SeriesContext;
use super::{FrameSource, ReductionError};
use crate::frame::{Frame, FrameKind};

/// The calibration of a series, from the cache or from its darks and flats; `judged` are flats that are left out for their
/// level, where the camera's curve decides that.
pub(super) fn calibration(
    calls: &Calls<'_>,
    series: &SeriesContext,
    kept: &mut Kept,
    judged: Option<Judged>,
) -> Result<Calibration, ReductionError> {
    let keys = series.keys(calls.source, judged.as_ref());
    for key in &keys {
        if let Some(sums) = kept.calibration(key) {
            let key = key.clone();
            return Ok(Calibration { key, sums, judged });
        }
    }
    let how = Preparation {
        uniform: series.uniform,
        detector: None,
        judged: judged.clone(),
    };
    let prepared = Arc::new(prepare(calls, &series.viewing, &how)?);
    let exposures = exposures_of_flats(calls, series, &prepared)?;
    calls.held.clear();
    let rig = calls.source.manifest().rig_geometry();
    let sums = CalibrationSums::of(&prepared, series, &rig, judged.as_ref(), exposures);
    let sums = Arc::new(sums);
    let key = keys[usize::from(prepared.flats.levels.is_empty())].clone();
    let rows = calls.source.rows();
    let frames = [FrameKind::Dark, FrameKind::Flat].map(|kind| series.ids_of(rows, kind));
    kept.keep_calibration(&key, frames, &sums);
    kept.save();
    kept.keep_planes(&key, &prepared);
    Ok(Calibration { key, sums, judged })
}

/// The calibration pixel by pixel, read again where only its sums are kept.
pub(super) fn planes(
    calls: &Calls<'_>,
    series: &SeriesContext,
    kept: &mut Kept,
    calibration: &Calibration,
) -> Result<Arc<Prepared>, ReductionError> {
    if let Some(planes) = kept.planes(&calibration.key) {
        return Ok(planes);
    }
    let how = Preparation {
        uniform: series.uniform,
        detector: None,
        judged: calibration.judged.clone(),
    };
    let prepared = Arc::new(prepare(calls, &series.viewing, &how)?);
    calls.held.clear();
    kept.keep_planes(&calibration.key, &prepared);
    Ok(prepared)
}

fn exposures_of_flats(
    calls: &Calls<'_>,
    series: &SeriesContext,
    prepared: &Prepared,
) -> Result<Vec<(Vec<i64>, Exposures)>, ReductionError> {
    let rows = calls.source.rows();
    let groups = detector::groups(rows, &prepared.sensor);
    let groups = groups
        .par_iter()
        .filter(|group| rows[group[0]].kind == FrameKind::Flat);
    groups
        .map(|group| {
            calls.check_cancel()?;
            let frames: Vec<(f64, Arc<Frame>)> = (group.iter())
                .filter_map(|index| {
                    let frame = load_once(calls, *index, &prepared.sensor).ok()?;
                    Some((rows[*index].exposure_s, frame))
                })
                .collect();
            Ok((
                group.iter().map(|index| series.ids[*index]).collect(),
                exposures_of(prepared, &frames),
            ))
        })
        .collect()
}

fn exposures_of(prepared: &Prepared, frames: &[(f64, Arc<Frame>)]) -> Exposures {
    let frames: Vec<(f64, &Frame)> = frames.iter().map(|(s, frame)| (*s, &**frame)).collect();
    detector::read_exposures(&prepared.sensor, &prepared.darks, &frames)
}

/// What is wanted of the sample frames.
#[derive(Clone, Copy, Default)]
pub(super) struct Wanted<'a> {
    /// Sums over these segments, kept by this name.
    pub(super) sums: Option<(&'a Segments, &'a str)>,
    /// Pictures, which determine the placement of a board.
    pub(super) pictures: bool,
}

/// Frames that are read together.
struct Unit {
    frames: Vec<usize>,
    /// Whether their exposures are compared.
    compared: bool,
}

/// What came of a unit.
#[derive(Default)]
struct UnitResult {
    outcomes: Vec<(usize, FrameOutcome)>,
    pictures: Vec<(usize, Option<Picture>)>,
    exposures: Option<(Vec<usize>, Exposures)>,
    /// Whether every frame could be read.
    is_readable: bool,
}

/// What was computed of all sample frames.
pub(super) struct Outcomes {
    /// Key of the calibration and part by which the cache has the outcomes.
    key: String,
    part: String,
    segments: usize,
    /// Sample frames that could not be read, which no cache keeps.
    unread: HashMap<usize, FrameOutcome>,
    pub(super) pictures: Vec<(usize, Arc<Option<Picture>>)>,
    /// The visits that are compared, flats included, in the order of the list.
    exposures: Vec<Arc<Exposures>>,
}

impl Outcomes {
    /// Calls `each` with the outcome of every sample frame, those that could not be read first, the others in the order of the
    /// list.
    pub(super) fn each(
        &self,
        calls: &Calls<'_>,
        series: &SeriesContext,
        kept: &Kept,
        mut each: impl FnMut(usize, &FrameOutcome),
    ) -> Result<(), ReductionError> {
        let samples = calls.rows_of(FrameKind::Sample);
        for index in &samples {
            if let Some(outcome) = self.unread.get(index) {
                each(*index, outcome);
            }
        }
        let read = samples.iter().filter(|i| !self.unread.contains_key(i));
        let ids: Vec<i64> = read.map(|index| series.ids[*index]).collect();
        kept.each_outcome(
            (&self.key, &self.part, self.segments),
            &ids,
            |id, outcome| {
                each(series.places[&id], outcome);
            },
        )
    }
}

/// Reads and measures what the cache lacks. Visits of the sample are kept under the key of `base`, whose darks they rest on.
pub(super) fn outcomes(
    calls: &Calls<'_>,
    series: &SeriesContext,
    kept: &mut Kept,
    (base, calibration): (&Calibration, &Calibration),
    wanted: Wanted<'_>,
) -> Result<Outcomes, ReductionError> {
    let rows = calls.source.rows();
    let sensor = calibration.sums.sensor(calls.source);
    let groups = detector::groups(rows, &sensor);
    let shown: Vec<&Vec<usize>> = detector::shown(&groups).collect();
    let ids = |group: &[usize]| -> Vec<i64> { group.iter().map(|i| series.ids[*i]).collect() };
    let of_sample = |group: &&Vec<usize>| rows[group[0]].kind == FrameKind::Sample;
    let lacks_exposures = |group: &&Vec<usize>| !kept.has_exposures(&base.key, &ids(group));
    let all: Vec<&Vec<usize>> = match kept.is_stored() {
        true => groups.iter().collect(),
        false => shown.clone(),
    };
    let mut units: Vec<Unit> = (all.into_iter().filter(of_sample).filter(lacks_exposures))
        .map(|group| Unit {
            frames: group.clone(),
            compared: true,
        })
        .collect();
    let mut grouped = vec![false; rows.len()];
    for frame in units.iter().flat_map(|unit| &unit.frames) {
        grouped[*frame] = true;
    }
    let samples = calls.rows_of(FrameKind::Sample);
    let lacks = |index: usize| {
        let id = series.ids[index];
        let sums = wanted.sums.is_some_and(|(segments, part)| {
            !kept.has_outcome(&calibration.key, part, id, segments.len())
        });
        let picture = wanted.pictures && kept.picture(&base.key, id).is_none();
        (sums, picture)
    };
    let lacking: Vec<(bool, bool)> = (0..rows.len()).map(lacks).collect();
    let singles = samples.iter();
    let singles = singles.filter(|i| !grouped[**i] && lacking[**i] != (false, false));
    units.extend(singles.map(|index| Unit {
        frames: vec![*index],
        compared: false,
    }));
    let mut unread: HashMap<usize, FrameOutcome> = HashMap::new();
    let mut unread_visits: HashMap<Vec<usize>, Arc<Exposures>> = HashMap::new();
    if !units.is_empty() {
        let prepared = planes(calls, series, kept, calibration)?;
        let reader = Reader {
            calls,
            prepared: &prepared,
            wanted,
            far: series.viewing.is_far(),
            lacks: &lacking,
        };
        // In parts, so that what was computed is kept where it is cancelled.
        let mut stopped = None;
        for units in units.chunks(UNITS_AT_ONCE) {
            let results = units.par_iter().map(|unit| reader.read(unit));
            let results: Vec<Result<UnitResult, ReductionError>> = results.collect();
            for result in results {
                // What the others read is kept, also where one of them was cancelled.
                let result = match result {
                    Ok(result) => result,
                    Err(error) => {
                        stopped.get_or_insert(error);
                        continue;
                    }
                };
                for (index, outcome) in result.outcomes {
                    match (&outcome, wanted.sums) {
                        (FrameOutcome::LeftOut(why), _) if !is_of_counts(why) => {
                            unread.insert(index, outcome);
                        }
                        (_, Some((_, part))) => {
                            let id = series.ids[index];
                            kept.keep_outcome(&calibration.key, part, id, outcome);
                        }
                        _ => {}
                    }
                }
                for (index, picture) in result.pictures {
                    if !unread.contains_key(&index) {
                        kept.keep_picture(&base.key, series.ids[index], picture);
                    }
                }
                if let Some((group, exposures)) = result.exposures {
                    let exposures = Arc::new(exposures);
                    match result.is_readable {
                        true => kept.keep_exposures(&base.key, ids(&group), &exposures),
                        false => drop(unread_visits.insert(group, exposures)),
                    }
                }
            }
            kept.save();
            if let Some(error) = stopped.take() {
                return Err(error);
            }
        }
    }
    let pictures = samples
        .iter()
        .filter(|_| wanted.pictures)
        .filter_map(|index| Some((*index, kept.picture(&base.key, series.ids[*index])?)));
    let mut exposures = Vec::new();
    for group in &shown {
        let ids = ids(group);
        let of_flats = || {
            let mut flats = base.sums.exposures.iter();
            let same = flats.find(|(frames, _)| *frames == ids);
            same.map(|(_, exposures)| Arc::new(exposures.clone()))
        };
        let visit = match unread_visits.get(*group) {
            Some(visit) => Some(Arc::clone(visit)),
            None => kept.exposures(&base.key, &ids)?.or_else(of_flats),
        };
        exposures.extend(visit);
    }
    Ok(Outcomes {
        key: calibration.key.clone(),
        part: wanted
            .sums
            .map_or_else(String::new, |(_, part)| part.to_owned()),
        segments: wanted.sums.map_or(0, |(segments, _)| segments.len()),
        unread,
        pictures: pictures.collect(),
        exposures,
    })
}

/// Units that are read before their results are kept.
const UNITS_AT_ONCE: usize = 64;

/// Reads units of frames.
struct Reader<'a> {
    calls: &'a Calls<'a>,
    prepared: &'a Prepared,
    wanted: Wanted<'a>,
    far: bool,
    /// Whether sums and picture are lacking, by place in the list.
    lacks: &'a [(bool, bool)],
}

impl Reader<'_> {
    fn read(&self, unit: &Unit) -> Result<UnitResult, ReductionError> {
        let (calls, prepared) = (self.calls, self.prepared);
        let rows = calls.source.rows();
        let mut result = UnitResult {
            is_readable: true,
            ..UnitResult::default()
        };
        let mut compared: Vec<(f64, Arc<Frame>)> = Vec::new();
        // Not between the frames of a unit: those that were read would be read again.
        calls.check_cancel()?;
        for index in &unit.frames {
            let (sums, picture) = self.lacks[*index];
            let frame = match load_once(calls, *index, &prepared.sensor) {
                Ok(frame) => frame,
                Err(why) => {
                    result.is_readable &= is_of_counts(&why);
                    result.outcomes.push((*index, FrameOutcome::LeftOut(why)));
                    if picture {
                        result.pictures.push((*index, None));
                    }
                    continue;
                }
            };
            if let (true, Some((segments, _))) = (sums, self.wanted.sums) {
                let context = MeasurementContext {
                    calls: *calls,
                    sensor: &prepared.sensor,
                    darks: &prepared.darks,
                    response: &prepared.flats.response,
                    segments,
                    far: self.far,
                };
                let outcome = match context.measure(*index, &frame) {
                    Ok(sums) => FrameOutcome::Reduced(sums),
                    Err(why) => FrameOutcome::LeftOut(why),
                };
                result.outcomes.push((*index, outcome));
            }
            if picture {
                let dark = prepared.darks.at(rows[*index].exposure_s);
                let response = &prepared.flats.response;
                let picture = register::picture(&frame, &dark, &prepared.sensor, response);
                result.pictures.push((*index, picture));
            }
            if unit.compared {
                compared.push((rows[*index].exposure_s, frame));
            }
        }
        if unit.compared {
            let exposures = exposures_of(prepared, &compared);
            result.exposures = Some((unit.frames.clone(), exposures));
        }
        Ok(result)
    }
}

/// Compares the exposures of all visits for the camera's curve.
pub(super) fn detector(
    source: &dyn FrameSource,
    calibration: &Calibration,
    outcomes: &Outcomes,
) -> Arc<Detector> {
    let visits: Vec<&Exposures> = outcomes.exposures.iter().map(|e| &**e).collect();
    let sums = &calibration.sums;
    Arc::new(detector::compare(
        source.manifest(),
        source.rows(),
        &sums.sensor(source),
        sums.n_darks > 0,
        &visits,
    ))
}
