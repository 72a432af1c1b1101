//! The analysis of the triangles of a height field before the first photon: which are lit, and which light is certainly free.

use std::marker::PhantomData;
use std::ops::Range;

use super::{Fate, Start};
use crate::trace::counting::grid::BinFinder;
use crate::trace::counting::tally::TallyBatch;
use crate::trace::facets::lanes::{CELLS, FacetLanes, Question};
use crate::trace::photons::light::PhotonState;
use crate::trace::photons::walk::{Method, Walk};
use crate::trace::surfaces::height_field::{HeightField, Side};
use crate::trace::vec3::V3;
use crate::trace::visibility::swept_visibility;

/// The analysis of every triangle.
pub(super) struct TriangleAnalysis<'a> {
    pub(super) walk: &'a Walk<'a>,
    pub(super) field: &'a HeightField,
    pub(super) bins: BinFinder,
    pub(super) to_lamp: V3,
    pub(super) single: bool,
    pub(super) smooth: bool,
    /// Whether the light that is not reflected is absorbed.
    pub(super) absorbs: bool,
    /// Whether it is worth finding more free light than the horizon slopes do.
    pub(super) thorough: bool,
}

/// Some cells to analyse. A type instead of a closure, because a closure of this size is not
/// inlined and would not be compiled for the wider instructions.
pub(super) struct Cells<'a, L> {
    pub(super) analysis: &'a TriangleAnalysis<'a>,
    pub(super) cells: Range<usize>,
    pub(super) batch: &'a mut TallyBatch,
    pub(super) starts: &'a mut Vec<(Start, f64)>,
    pub(super) light: PhantomData<L>,
}

impl<L: PhotonState> pulp::WithSimd for Cells<'_, L> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let question = Question {
            walk: self.analysis.walk,
            field: self.analysis.field,
            smooth: self.analysis.smooth,
            counts: self.analysis.walk.method == Method::Split,
        };
        let mut both = [FacetLanes::ROOM; 2];
        for first in self.cells.clone().step_by(CELLS) {
            FacetLanes::of::<L, S>(simd, &mut both, question, first);
            for lane in 0..CELLS.min(self.cells.end - first) {
                for (upper, facets) in [(false, &both[0]), (true, &both[1])] {
                    let start =
                        self.analysis
                            .at::<L>(first + lane, upper, facets, lane, self.batch);
                    if let Some(start) = start {
                        self.starts.push(start);
                    }
                }
            }
        }
    }
}

impl TriangleAnalysis<'_> {
    /// A triangle as a start, and its area projected along the light divided by its horizontal
    /// cell's area; `None` if it faces away or nothing of it is sampled. The known part of its
    /// light is counted.
    #[inline(always)]
    fn at<L: PhotonState>(
        &self,
        cell: usize,
        upper: bool,
        facets: &FacetLanes,
        lane: usize,
        batch: &mut TallyBatch,
    ) -> Option<(Start, f64)> {
        let (nx, ny) = self.field.cells();
        let facing = facets.facing(lane);
        if facing <= 0.0 {
            return None;
        }
        let (i, j) = (cell / ny, cell % ny);
        let lit = self.is_free(i, j, upper, Side::Above, &self.to_lamp, self.thorough);
        // A triangle that is not completely lit needs photons in any case; split photons then
        // follow both branches.
        let thorough = self.thorough && (lit || self.walk.method == Method::Analog);
        let free = |side: Side, k: &V3| self.is_free(i, j, upper, side, k, thorough);
        let mut start = Start {
            cell: cell as u32,
            upper,
            lit,
            reflected: Fate::Open,
            refracted: Fate::Open,
        };
        if !self.smooth {
            return Some((start, facing));
        }
        let away = facets.direction(Side::Above, lane);
        if away[2] > 0.0 && free(Side::Above, &away) {
            start.reflected = Fate::Free;
        }
        // No light is refracted into a metal or under total reflection.
        let into = facets.direction(Side::Below, lane);
        if !facets.enters(lane) {
            start.refracted = Fate::Done;
        } else if self.single && into[2] < 0.0 && free(Side::Below, &into) {
            start.refracted = Fate::Free;
        }
        if start.lit && self.walk.method == Method::Split {
            let weight = facing / (nx * ny) as f64;
            for (side, fate) in [
                (Side::Above, &mut start.reflected),
                (Side::Below, &mut start.refracted),
            ] {
                if *fate == Fate::Free {
                    let power = facets.power(side, lane);
                    let bin = facets.bin(side, lane, &self.bins);
                    batch.count_numbers::<L>(facets.numbers(side, lane), power, bin, side);
                    *fate = Fate::Done;
                    if self.absorbs {
                        batch.absorb(weight - power);
                    }
                }
            }
            if start.reflected == Fate::Done && start.refracted == Fate::Done {
                return None;
            }
        }
        Some((start, facing))
    }

    /// By the cell's horizon slope, or if worthwhile by a test of everything in the light's way.
    #[inline(always)]
    fn is_free(&self, i: usize, j: usize, upper: bool, side: Side, k: &V3, thorough: bool) -> bool {
        let (_, ny) = self.field.cells();
        self.field
            .horizon(side)
            .towards(k)
            .clears(i * ny + j, f64::NEG_INFINITY)
            || (thorough && swept_visibility::is_free(self.field, i, j, upper, side, k))
    }
}
