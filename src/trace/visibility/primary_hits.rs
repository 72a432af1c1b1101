//! Primary hits on a height field: where the lamp's light falls, evenly sampled, and the part of
//! the result that is known without sampling.
//!
//! [`PrimaryHits::new`] analyses every triangle once. Photons start on the triangles themselves,
//! evenly spaced in their area projected along the light, so that none is spent on finding the
//! surface; a start in the shadow is dropped. The total lit area is that of the tile, whatever the
//! relief, so the number of photons that it represents is known exactly.
//!
//! A smooth triangle reflects all light in one direction and refracts all in one direction
//! ([`crate::trace::facets::response`]). If the lamp illuminates it completely and the outgoing light is
//! certainly free ([`super::horizon_slopes`], [`super::swept_visibility`]), the only random choice
//! is which branch a photon takes with [`Method::Analog`]: it is counted without being followed.
//! With [`Method::Split`] such light needs no photons: it is counted once, and photons start only
//! where the result depends on sampling.

mod analysis;

use std::marker::PhantomData;

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::trace::counting::grid::{BinFinder, DirectionGrid};
use crate::trace::counting::tally::{AnalyticPart, TallyBatch};
use crate::trace::facets::response::{FacetResponse, Incidence};
use crate::trace::photons::interface::{Relief, ReliefPoint};
use crate::trace::photons::light::PhotonState;
use crate::trace::photons::walk::{Method, Waiting, Walk};
use crate::trace::rng::RandomStream;
use crate::trace::surfaces::height_field::{FieldSpot, Flight, HeightField, Side};
use crate::trace::vec3::{V3, scaled, unit};
use analysis::{Cells, TriangleAnalysis};

/// A triangle on which photons start.
#[derive(Debug, Clone, Copy)]
struct Start {
    cell: u32,
    upper: bool,
    /// Completely and certainly lit.
    lit: bool,
    reflected: Fate,
    refracted: Fate,
}

/// Knowledge of the light that leaves a triangle in one branch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    /// All of it is free.
    Free,
    /// It must be followed.
    Open,
    /// There is none, or it has already been counted.
    Done,
}

/// The starts of photons on a field for one direction of light.
#[derive(Debug)]
pub struct PrimaryHits<'a> {
    field: &'a HeightField,
    bins: BinFinder,
    to_lamp: V3,
    /// Whether facets are mirrors: a triangle then sends all light in the same directions.
    smooth: bool,
    starts: Vec<Start>,
    /// Responses of the starts, if photons take one branch each and are numerous enough.
    facets: Vec<FacetResponse>,
    /// Cumulative projected areas of the starts, in cells.
    until: Vec<f64>,
    /// The part of the result that needs no photons, per photon of the whole run.
    pub known: AnalyticPart,
}

/// The analysis of the triangles was stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stopped;

/// Cells whose analytic light one thread sums.
const CHUNK: usize = 1 << 14;
/// Cells between two calls of the callback; chunks are multiples of it.
const ASKED: usize = 1 << 10;
/// Least number of photons per triangle for which it is worth finding the light that is certainly
/// free, if photons are followed one by one.
const WORTH_A_LOOK: u64 = 8;
/// Least number of photons per start for which its response is stored.
const WORTH_KEEPING: u64 = 2;
/// Largest number of stored responses (200 bytes each).
const KEPT_MAX: usize = 1 << 20;

impl<'a> PrimaryHits<'a> {
    /// Analyses all triangles of the first interface for a run with this number of photons; `None`
    /// if it is not a height field, or if the light is so grazing that most starts would be in the
    /// shadow. `go_on` is called from time to time, from any thread, with the finished fraction.
    ///
    /// # Errors
    /// [`Stopped`] if `go_on` returned false.
    pub fn new<L: PhotonState>(
        walk: &'a Walk<'a>,
        grid: DirectionGrid,
        photons: u64,
        go_on: &(dyn Fn(f64) -> bool + Sync),
    ) -> Result<Option<Self>, Stopped> {
        let interface = &walk.stack.interfaces[0];
        let Relief::Field(field) = &interface.relief else {
            return Ok(None);
        };
        let (nx, ny) = field.cells();
        let cells = nx * ny;
        let analysis = TriangleAnalysis {
            walk,
            field,
            bins: grid.finder(),
            to_lamp: scaled(-1.0, &walk.k),
            single: walk.stack.interfaces.len() == 1,
            smooth: interface.roughness.is_none() && interface.diffuse.is_none(),
            absorbs: interface.from_above.is_metal(),
            thorough: walk.method == Method::Split || photons / WORTH_A_LOOK >= 2 * cells as u64,
        };
        let known = Mutex::new(AnalyticPart::new(grid, L::ELEMENTS));
        let done = AtomicUsize::new(0);
        let chunks: Result<Vec<Vec<(Start, f64)>>, Stopped> = (0..cells.div_ceil(CHUNK))
            .into_par_iter()
            .map_init(
                || TallyBatch::new::<L>(grid),
                |batch, chunk| {
                    let mut starts = Vec::with_capacity(2 * CHUNK);
                    for first in (chunk * CHUNK..((chunk + 1) * CHUNK).min(cells)).step_by(ASKED) {
                        let done = done.fetch_add(ASKED, Ordering::Relaxed);
                        if !go_on(done as f64 / cells as f64) {
                            return Err(Stopped);
                        }
                        // Compiled for each vector instruction set; the bits are the same with all
                        // of them.
                        field.arch().dispatch(Cells {
                            analysis: &analysis,
                            cells: first..(first + ASKED).min(cells),
                            batch,
                            starts: &mut starts,
                            light: PhantomData::<L>,
                        });
                    }
                    // Adding in fixed point is exact: the order of the chunks does not matter.
                    known
                        .lock()
                        .expect("no thread panics while it adds")
                        .take(batch);
                    Ok(starts)
                },
            )
            .collect();
        let chunks = chunks?;
        let count = chunks.iter().map(Vec::len).sum();
        let (mut starts, mut until) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let mut area = 0.0;
        for (start, facing) in chunks.into_iter().flatten() {
            area += facing;
            until.push(area);
            starts.push(start);
        }
        // The lit area is that of the tile; starts in the shadow are wasted.
        if area > 4.0 * cells as f64 {
            return Ok(None);
        }
        let mut primary_hits = PrimaryHits {
            field,
            bins: analysis.bins,
            to_lamp: analysis.to_lamp,
            smooth: analysis.smooth,
            starts,
            facets: Vec::new(),
            until,
            known: known.into_inner().expect("no thread panics while it adds"),
        };
        let expected = (photons as f64 * primary_hits.share()) as u64;
        let worth_it = count <= KEPT_MAX && expected / WORTH_KEEPING >= count as u64;
        if analysis.smooth && walk.method == Method::Analog && worth_it {
            primary_hits.facets = primary_hits
                .starts
                .par_iter()
                .map(|start| {
                    primary_hits
                        .incidence::<L>(walk, start)
                        .facet::<L>(&primary_hits.bins)
                })
                .collect();
        }
        Ok(Some(primary_hits))
    }

    /// Fraction of the light that is sampled (slightly more if starts are in the shadow).
    #[must_use]
    pub fn share(&self) -> f64 {
        let (nx, ny) = self.field.cells();
        self.until.last().copied().unwrap_or(0.0) / (nx * ny) as f64
    }

    /// Starts the photons of a batch that represents `photons` of them: one at random in each of
    /// this number of equal strata of the projected area. (Evenly spaced starts would be slightly
    /// better, but a batch would then have two degrees of freedom, and batches that coincide by
    /// chance spoil the errors of all bins at once.) `stream` gives each start its random numbers;
    /// `go_on` is called before each. Returns `false` if it was stopped.
    pub fn batch<L: PhotonState>(
        &self,
        walk: &Walk<'_>,
        photons: u64,
        stream: impl Fn(u64) -> RandomStream,
        go_on: impl Fn(u64) -> bool,
        waiting: &mut Waiting<L>,
        batch: &mut TallyBatch,
    ) -> bool {
        let Some(&end) = self.until.last() else {
            return true;
        };
        let (nx, ny) = self.field.cells();
        let spacing = (nx * ny) as f64 / photons as f64;
        let mut at = 0;
        for n in 0..(end / spacing).ceil() as u64 {
            if batch.given_up || !go_on(n) {
                return false;
            }
            let mut random = stream(n);
            let position = (n as f64 + random.uniform()) * spacing;
            if position >= end {
                break;
            }
            at = first_beyond(&self.until, at, position);
            let start = &self.starts[at];
            let place = |random: &mut RandomStream| {
                let before = if at == 0 { 0.0 } else { self.until[at - 1] };
                let along = ((position - before) / (self.until[at] - before)).clamp(0.0, 1.0);
                self.spot(start, along, random.uniform())
            };
            if start.lit && self.smooth && walk.method == Method::Analog {
                self.one_way(walk, at, place, &mut random, waiting, batch);
                continue;
            }
            let spot = place(&mut random);
            let (lamp, crossed) = (&self.to_lamp, &mut batch.work);
            let lit =
                start.lit || self.field.onward(&spot, Side::Above, lamp, crossed) == Flight::Free;
            if !lit {
                continue;
            }
            if !self.smooth {
                walk.photon_at(ReliefPoint::Field(spot), &mut random, waiting, batch);
            } else if walk.method == Method::Analog {
                self.one_way(walk, at, |_| spot, &mut random, waiting, batch);
            } else {
                self.both_ways(walk, at, &spot, &mut random, waiting, batch);
            }
        }
        !batch.given_up
    }

    /// The response of a triangle: from the table, or computed into `room`.
    #[inline(always)]
    fn facet_at<'r, L: PhotonState>(
        &'r self,
        walk: &Walk<'_>,
        at: usize,
        room: &'r mut Option<FacetResponse>,
    ) -> &'r FacetResponse {
        match self.facets.get(at) {
            Some(facet) => facet,
            None => room.insert(
                self.incidence::<L>(walk, &self.starts[at])
                    .facet::<L>(&self.bins),
            ),
        }
    }

    /// A photon that is reflected, refracted or absorbed; its position on the triangle is computed
    /// only if needed.
    #[inline(always)]
    fn one_way<L: PhotonState>(
        &self,
        walk: &Walk<'_>,
        at: usize,
        place: impl FnOnce(&mut RandomStream) -> FieldSpot,
        random: &mut RandomStream,
        waiting: &mut Waiting<L>,
        batch: &mut TallyBatch,
    ) {
        let start = &self.starts[at];
        let mut computed = None;
        let facet = self.facet_at::<L>(walk, at, &mut computed);
        let (way, fate, side) = if random.uniform() < facet.share {
            (&facet.reflected, start.reflected, Side::Above)
        } else if facet.enters {
            (&facet.refracted, start.refracted, Side::Below)
        } else {
            // The branch is drawn by unpolarised light, the loss is that of the lamp's: both are
            // correct on average.
            let reflected = facet.reflected.power * facet.share;
            return batch.absorb((1.0 - reflected) / (1.0 - facet.share));
        };
        if fate == Fate::Free {
            let light: L = facet.leaving(way);
            return batch.count(&light, way.power, way.bin as usize, side, 1);
        }
        let spot = place(random);
        let incidence = self.incidence::<L>(walk, start);
        let (_, k) = incidence.way(side);
        let light = incidence.after(&way.channel);
        self.follow(walk, light, k, side, spot, random, waiting, batch);
    }

    /// A photon whose two branches are both followed if they are open.
    fn both_ways<L: PhotonState>(
        &self,
        walk: &Walk<'_>,
        at: usize,
        spot: &FieldSpot,
        random: &mut RandomStream,
        waiting: &mut Waiting<L>,
        batch: &mut TallyBatch,
    ) {
        let start = &self.starts[at];
        let incidence = self.incidence::<L>(walk, start);
        for (side, fate) in [
            (Side::Above, start.reflected),
            (Side::Below, start.refracted),
        ] {
            match fate {
                Fate::Done => {}
                Fate::Free => {
                    let exit = incidence.leaves::<L>(side, 1.0, &self.bins);
                    batch.count(&exit.light, exit.power, exit.bin, side, 1);
                }
                Fate::Open => {
                    let (channel, k) = incidence.way(side);
                    let light = incidence.after(channel);
                    self.follow(walk, light, k, side, *spot, random, waiting, batch);
                }
            }
        }
        if incidence.absorbs() && start.reflected != Fate::Done {
            let (channel, _) = incidence.way(Side::Above);
            let light: L = incidence.after(channel);
            batch.absorb(1.0 - light.power(&walk.stokes));
        }
    }

    /// Follows light from its start.
    #[expect(clippy::too_many_arguments, reason = "a photon's state and its tools")]
    fn follow<L: PhotonState>(
        &self,
        walk: &Walk<'_>,
        light: L,
        k: V3,
        side: Side,
        spot: FieldSpot,
        random: &mut RandomStream,
        waiting: &mut Waiting<L>,
        batch: &mut TallyBatch,
    ) {
        // The reflection is negligible (index 1, or exactly Brewster's angle).
        if light.weight() > f64::MIN_POSITIVE {
            walk.go_on(
                light,
                k,
                side,
                ReliefPoint::Field(spot),
                random,
                waiting,
                batch,
            );
        }
    }

    fn incidence<'b, L: PhotonState>(&self, walk: &'b Walk<'b>, start: &Start) -> Incidence<'b> {
        let (_, ny) = self.field.cells();
        let cell = start.cell as usize;
        let (sx, sy) = self.field.slopes(cell / ny, cell % ny, start.upper);
        Incidence::of::<L>(walk, &unit(&[-sx, -sy, 1.0]))
    }

    /// A uniformly distributed point of a triangle from two numbers in [0, 1].
    fn spot(&self, start: &Start, a: f64, b: f64) -> FieldSpot {
        let (_, ny) = self.field.cells();
        let r = a.sqrt();
        // Barycentric (1 − r, r(1 − b), r b) on the corners (0,0), (1,1), and (1,0) or (0,1).
        let (far, side) = (r * (1.0 - b), r * b);
        let (x, y) = if start.upper {
            (far, far + side)
        } else {
            (far + side, far)
        };
        let cell = start.cell as usize;
        self.field
            .spot_at(cell / ny, cell % ny, start.upper, x.min(1.0), y.min(1.0))
    }
}

/// Index from `at` on of the first cumulative sum above a position; the last one if there is none.
#[inline(always)]
fn first_beyond(sums: &[f64], at: usize, position: f64) -> usize {
    let last = sums.len() - 1;
    let (mut below, mut step) = (at, 1);
    if sums[below] > position {
        return below;
    }
    // In growing steps, because the next start is close.
    loop {
        let next = (below + step).min(last);
        if sums[next] > position || next == last {
            return below + 1 + sums[below + 1..next].partition_point(|s| *s <= position);
        }
        (below, step) = (next, 2 * step);
    }
}
