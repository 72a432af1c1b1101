//! First hits on a height field: where the lamp's light falls, evenly, and what follows without chance.
//!
//! [`FirstHits::new`] looks at every triangle once. Photons start on the triangles themselves, spaced evenly in
//! their area projected along the light, so that none is spent on finding the surface; a start in
//! the shadow is dropped. All lit area together is the tile's, whatever the relief, so the number of
//! photons that this stands for is known exactly.
//!
//! Triangles that the lamp lights wholly and whose reflected (or refracted) light leaves for
//! certain ([`super::escape`]) need no photons for that: all of their light goes one way. It is
//! counted once and for all, and photons start only where something is left to chance.

use rayon::prelude::*;

use super::beam;
use super::grid::Grid;
use super::height_field::{Flight, HeightField, Side, Spot};
use super::light::Light;
use super::rng::Stream;
use super::surface::{Place, Relief};
use super::tally::{Batch, Known};
use super::vec3::{V3, dot, scaled, unit};
use super::walk::{Method, Waiting, Walk, Ways};

/// A triangle on which photons start.
#[derive(Debug, Clone, Copy)]
struct Start {
    cell: u32,
    upper: bool,
    lit: bool,
    ways: Ways,
}

/// Where photons start on a field, for one direction of light.
#[derive(Debug)]
pub struct FirstHits<'a> {
    field: &'a HeightField,
    to_lamp: V3,
    starts: Vec<Start>,
    /// Projected areas of the starts up to and including each, in cells.
    until: Vec<f64>,
    /// For equal steps of projected area, the start to look from.
    guide: Vec<u32>,
    /// What needs no photon, per photon of the whole run.
    pub known: Known,
}

/// Cells whose known light one thread adds up.
const CHUNK: usize = 1 << 13;

impl<'a> FirstHits<'a> {
    /// Looks at all triangles of the first interface; `None` where it is not a height field, or where light
    /// falls so flat that most starts would lie in the shadow.
    #[must_use]
    pub fn new<L: Light>(walk: &'a Walk<'a>, grid: Grid) -> Option<Self> {
        let interface = &walk.stack.interfaces[0];
        let Relief::Field(field) = &interface.relief else {
            return None;
        };
        let (nx, ny) = field.cells();
        let cells = nx * ny;
        let single = walk.stack.interfaces.len() == 1;
        let chunks: Vec<(Vec<(Start, f64)>, Known)> = (0..cells.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let mut batch = Batch::new::<L>(grid);
                let mut starts = Vec::new();
                for cell in chunk * CHUNK..((chunk + 1) * CHUNK).min(cells) {
                    for upper in [false, true] {
                        look_at::<L>(walk, field, single, cell, upper, &mut starts, &mut batch);
                    }
                }
                let mut known = Known::new(grid, L::ELEMENTS);
                known.take(&mut batch);
                (starts, known)
            })
            .collect();
        let mut known = Known::new(grid, L::ELEMENTS);
        let mut starts = Vec::with_capacity(chunks.iter().map(|c| c.0.len()).sum());
        let mut until = Vec::with_capacity(starts.capacity());
        let mut sum = 0.0;
        for (chunk, part) in chunks {
            known.add(&part);
            for (start, area) in chunk {
                sum += area;
                until.push(sum);
                starts.push(start);
            }
        }
        // Lit area is the tile's; what lies in the shadow is spent in vain.
        if sum > 4.0 * cells as f64 {
            return None;
        }
        Some(FirstHits {
            field,
            to_lamp: scaled(-1.0, &walk.k),
            guide: guide(&until),
            until,
            starts,
            known,
        })
    }

    /// Share of the light that is left to chance (a little more where starts lie in the shadow).
    #[must_use]
    pub fn share(&self) -> f64 {
        let (nx, ny) = self.field.cells();
        self.until.last().copied().unwrap_or(0.0) / (nx * ny) as f64
    }

    /// Starts the photons of a batch that stands for `photons` of them: one at random in each of so many equal
    /// strata of the projected area. (Evenly spaced ones would do a little better, but a batch then has two
    /// degrees of freedom, and batches that fall on each other by chance spoil the errors of all bins at
    /// once.) `stream` gives each start its random numbers; `go_on` is asked before each. `false` where it
    /// was told to stop.
    pub fn batch<L: Light>(
        &self,
        walk: &Walk<'_>,
        photons: u64,
        stream: impl Fn(u64) -> Stream,
        go_on: impl Fn(u64) -> bool,
        waiting: &mut Waiting<L>,
        batch: &mut Batch,
    ) -> bool {
        let (nx, ny) = self.field.cells();
        let spacing = (nx * ny) as f64 / photons as f64;
        let Some(&end) = self.until.last() else {
            return true;
        };
        let strata = (end / spacing).ceil() as u64;
        for n in 0..strata {
            if !go_on(n) {
                return false;
            }
            let mut random = stream(n);
            let position = (n as f64 + random.uniform()) * spacing;
            if position >= end {
                break;
            }
            let at = self.find(position, end);
            let start = &self.starts[at];
            let before = if at == 0 { 0.0 } else { self.until[at - 1] };
            let along = ((position - before) / (self.until[at] - before)).clamp(0.0, 1.0);
            let spot = self.spot(start, along, random.uniform(), ny);
            let lit =
                start.lit || self.field.onward(&spot, Side::Above, &self.to_lamp) == Flight::Free;
            if lit {
                walk.photon_at(Place::Field(spot), start.ways, &mut random, waiting, batch);
            }
        }
        true
    }

    /// The start that holds a position below `end`.
    fn find(&self, position: f64, end: f64) -> usize {
        let step = (position / end * self.guide.len() as f64) as usize;
        let mut at = self.guide[step.min(self.guide.len() - 1)] as usize;
        while at + 1 < self.until.len() && self.until[at] <= position {
            at += 1;
        }
        at
    }

    /// A uniform point of a triangle from two numbers in [0, 1].
    fn spot(&self, start: &Start, a: f64, b: f64, ny: usize) -> Spot {
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

/// For equal steps of the sum, the first place whose sum passes the step's start.
fn guide(until: &[f64]) -> Vec<u32> {
    let Some(&end) = until.last() else {
        return Vec::new();
    };
    let steps = until.len();
    let mut at = 0;
    (0..steps)
        .map(|step| {
            let start = end * step as f64 / steps as f64;
            while at + 1 < until.len() && until[at] <= start {
                at += 1;
            }
            at as u32
        })
        .collect()
}

/// Counts what is known of a triangle, and lists it where something is left to chance.
fn look_at<L: Light>(
    walk: &Walk<'_>,
    field: &HeightField,
    single: bool,
    cell: usize,
    upper: bool,
    starts: &mut Vec<(Start, f64)>,
    batch: &mut Batch,
) {
    let (nx, ny) = field.cells();
    let (sx, sy) = field.slopes(cell / ny, cell % ny, upper);
    let k = &walk.k;
    // Area projected along the light over that of a horizontal triangle.
    let facing = 0.5 * (-k[0] * sx - k[1] * sy + k[2]) / k[2];
    if facing <= 0.0 {
        return;
    }
    let m = unit(&[-sx, -sy, 1.0]);
    let cos = -dot(k, &m);
    if cos <= 0.0 {
        return;
    }
    let mut ways = Ways::BOTH;
    let to_lamp = scaled(-1.0, k);
    // By its cell's escape slope, or else by a look at what lies in its way.
    let free = |side: Side, k: &V3| {
        field.escape(side).clears(cell, k)
            || beam::is_free(field, cell / ny, cell % ny, upper, side, k)
    };
    let lit = free(Side::Above, &to_lamp);
    if lit && walk.method == Method::Split {
        let boundary = &walk.stack.interfaces[0].from_above;
        let split = boundary.at(cos);
        let away = super::vec3::combine(1.0, k, 2.0 * cos, &m);
        let reflected = away[2] > 0.0 && free(Side::Above, &away);
        let mut refracted = false;
        if single && split.cos_refracted > 0.0 {
            let ratio = boundary.snell_ratio();
            let into = super::vec3::combine(ratio, k, ratio * cos - split.cos_refracted, &m);
            refracted = into[2] < 0.0 && free(Side::Below, &into);
        }
        let weight = facing / (nx * ny) as f64;
        let certain = Ways {
            reflected,
            refracted,
        };
        walk.known::<L>(&m, weight, certain, batch);
        // Nothing is refracted into a metal or under total reflection.
        let enters = split.cos_refracted > 0.0;
        ways = Ways {
            reflected: !reflected,
            refracted: enters && !refracted,
        };
        if !ways.reflected && !ways.refracted {
            return;
        }
    }
    let start = Start {
        cell: cell as u32,
        upper,
        lit,
        ways,
    };
    starts.push((start, facing));
}
