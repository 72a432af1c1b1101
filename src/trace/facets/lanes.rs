//! Smooth facets in SIMD lanes: computes [`super::response`] for both triangles of [`CELLS`]
//! cells at once.
//!
//! Call [`FacetLanes::of`]. The operations have the same order as for a single facet and none is
//! fused, so that the bits are the same with all register widths and for single facets.
//!
//! *Conditioning.* As in [`crate::trace::photons::light`] and [`crate::model::polarisation`]; lanes that face away
//! from the lamp hold arbitrary values.

use pulp::Simd;

use super::response::GRAZING;
use crate::model::lanes::Lane;
use crate::trace::counting::grid::{Bearing, BinFinder};
use crate::trace::photons::light::{ELEMENTS_MAX, Leaving, PhotonState, STRAIGHT, Turn};
use crate::trace::photons::walk::Walk;
use crate::trace::surfaces::height_field::{HeightField, Side};
use crate::trace::vec3::{V3, cross, dot};

/// Cells processed together: the number of lanes of the widest register.
pub(in crate::trace) const CELLS: usize = 8;

/// One number per cell.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Row([f64; CELLS]);

const NOTHING: Row = Row([0.0; CELLS]);

/// Light that leaves some triangles towards one side.
#[derive(Debug)]
struct LaneBranch {
    k: [Row; 3],
    tilt: Row,
    turn: Row,
    power: Row,
    numbers: [Row; ELEMENTS_MAX],
}

impl LaneBranch {
    const NONE: LaneBranch = LaneBranch {
        k: [NOTHING; 3],
        tilt: NOTHING,
        turn: NOTHING,
        power: NOTHING,
        numbers: [NOTHING; ELEMENTS_MAX],
    };

    fn direction(&self, lane: usize) -> V3 {
        [self.k[0].0[lane], self.k[1].0[lane], self.k[2].0[lane]]
    }
}

/// The lamp's light on one of the two triangles of some cells.
#[derive(Debug)]
pub(in crate::trace) struct FacetLanes {
    facing: Row,
    cos_refracted: Row,
    above: LaneBranch,
    below: LaneBranch,
}

/// The options of the computation.
#[derive(Clone, Copy)]
pub(in crate::trace) struct Question<'a> {
    pub(in crate::trace) walk: &'a Walk<'a>,
    pub(in crate::trace) field: &'a HeightField,
    /// Whether facets are mirrors, so that light leaves them in known directions.
    pub(in crate::trace) smooth: bool,
    /// Whether light that leaves at once is counted.
    pub(in crate::trace) counts: bool,
}

impl FacetLanes {
    /// Uninitialised storage.
    pub(in crate::trace) const ROOM: FacetLanes = FacetLanes {
        facing: NOTHING,
        cos_refracted: NOTHING,
        above: LaneBranch::NONE,
        below: LaneBranch::NONE,
    };

    /// Processes the lower and the upper triangles of the cells from `first` on; beyond the last
    /// cell, the last one is repeated.
    #[inline(always)]
    pub(in crate::trace) fn of<L: PhotonState, S: Simd>(
        simd: S,
        both: &mut [FacetLanes; 2],
        question: Question<'_>,
        first: usize,
    ) {
        let Question { walk, field, .. } = question;
        let (nx, ny) = field.cells();
        let (cell_x, cell_y) = field.cell_size();
        let (cell_x, cell_y) = (Lane::splat(simd, cell_x), Lane::splat(simd, cell_y));
        let mut corners = [NOTHING; 4];
        for lane in 0..CELLS {
            let cell = (first + lane).min(nx * ny - 1);
            let h = field.corner_heights(cell / ny, cell % ny);
            for (row, h) in corners.iter_mut().zip(h) {
                row.0[lane] = h;
            }
        }
        let k = walk.k.map(|x| Lane::splat(simd, x));
        for part in 0..CELLS / Lane::<S>::WIDTH {
            let mut at = [k[0]; 4];
            for (at, row) in at.iter_mut().zip(&corners) {
                *at = Lane::load(simd, &row.0, part);
            }
            let [h00, h10, h01, h11] = at;
            for (upper, facets) in both.iter_mut().enumerate() {
                let (sx, sy) = if upper == 1 {
                    ((h11 - h01) / cell_x, (h01 - h00) / cell_y)
                } else {
                    ((h10 - h00) / cell_x, (h11 - h10) / cell_y)
                };
                let half = Lane::splat(simd, 0.5);
                let facing = half * (-k[0] * sx - k[1] * sy + k[2]) / k[2];
                facing.store(&mut facets.facing.0, part);
                if question.smooth {
                    facets.divide::<L, S>(simd, question, part, [sx, sy]);
                }
            }
        }
    }

    /// Processes one register of facets with these slopes, whose `facing` is known.
    #[inline(always)]
    fn divide<L: PhotonState, S: Simd>(
        &mut self,
        simd: S,
        question: Question<'_>,
        part: usize,
        [sx, sy]: [Lane<S>; 2],
    ) {
        let Question { walk, field, .. } = question;
        let k = walk.k.map(|x| Lane::splat(simd, x));
        let s = walk.s.map(|x| Lane::splat(simd, x));
        let stokes = walk.stokes.map(|x| Lane::splat(simd, x));
        let (zero, one) = (Lane::splat(simd, 0.0), Lane::splat(simd, 1.0));
        let (half, two) = (Lane::splat(simd, 0.5), Lane::splat(simd, 2.0));
        let (x, y) = (-sx, -sy);
        let inverse = one / (x * x + y * y + one).sqrt();
        let m = [inverse * x, inverse * y, inverse];
        let cos = (-dot(&k, &m)).max(Lane::splat(simd, GRAZING));
        let boundary = &walk.stack.interfaces[0].from_above;
        let split = boundary.at_each(simd, cos);
        split.cos_refracted.store(&mut self.cos_refracted.0, part);
        let (turn, s_hit) = if L::HAS_FRAME {
            to_hit(simd, &k, &m, &s)
        } else {
            (none(simd), s)
        };
        let ratio = split.ratio;
        let along = ratio * cos - split.cos_refracted;
        let reflected = combine(&k, two * cos, &m);
        let refracted = combine(&k.map(|x| ratio * x), along, &m);
        let (nx, ny) = field.cells();
        let facing = Lane::load(simd, &self.facing.0, part);
        let factor = facing / Lane::splat(simd, (nx * ny) as f64);
        for (way, k, channel) in [
            (&mut self.above, reflected, split.reflected),
            (&mut self.below, refracted, split.refracted),
        ] {
            for (row, x) in way.k.iter_mut().zip(k) {
                x.store(&mut row.0, part);
            }
            if !question.counts {
                continue;
            }
            let bearing = Bearing::of_each(simd, &k);
            bearing.tilt.store(&mut way.tilt.0, part);
            bearing.turn.store(&mut way.turn.0, part);
            let leave = if L::HAS_FRAME {
                to_exit(simd, &k, &s_hit, &s)
            } else {
                none(simd)
            };
            let leaving = Leaving {
                zero,
                half,
                turn,
                leave,
                channel,
                factor,
                stokes,
            };
            let mut numbers = [zero; ELEMENTS_MAX];
            let power = L::leaves_each(&leaving, &mut numbers);
            power.store(&mut way.power.0, part);
            for (row, x) in way.numbers[..L::ELEMENTS].iter_mut().zip(numbers) {
                x.store(&mut row.0, part);
            }
        }
    }

    /// A triangle's area projected along the light, divided by its horizontal cell's area.
    pub(in crate::trace) fn facing(&self, lane: usize) -> f64 {
        self.facing.0[lane]
    }

    /// Whether light is refracted: not into a metal, and not under total reflection.
    pub(in crate::trace) fn enters(&self, lane: usize) -> bool {
        self.cos_refracted.0[lane] > 0.0
    }

    fn way(&self, side: Side) -> &LaneBranch {
        match side {
            Side::Above => &self.above,
            Side::Below => &self.below,
        }
    }

    /// Direction of the light towards a side.
    pub(in crate::trace) fn direction(&self, side: Side, lane: usize) -> V3 {
        self.way(side).direction(lane)
    }

    /// Power of the light towards a side, for power 1 per cell.
    pub(in crate::trace) fn power(&self, side: Side, lane: usize) -> f64 {
        self.way(side).power.0[lane]
    }

    /// The bin contents of the light towards a side, if it leaves at once.
    pub(in crate::trace) fn numbers(&self, side: Side, lane: usize) -> impl Iterator<Item = f64> {
        self.way(side).numbers.iter().map(move |row| row.0[lane])
    }

    /// The bin of the direction towards a side.
    pub(in crate::trace) fn bin(&self, side: Side, lane: usize, bins: &BinFinder) -> usize {
        let way = self.way(side);
        let bearing = Bearing {
            tilt: way.tilt.0[lane],
            turn: way.turn.0[lane],
        };
        bins.bin_of(side, &way.direction(lane), bearing)
    }
}

/// x + b y.
#[inline(always)]
fn combine<S: Simd>(x: &[Lane<S>; 3], b: Lane<S>, y: &[Lane<S>; 3]) -> [Lane<S>; 3] {
    [x[0] + b * y[0], x[1] + b * y[1], x[2] + b * y[2]]
}

/// [`Turn::NONE`].
#[inline(always)]
fn none<S: Simd>(simd: S) -> Turn<Lane<S>> {
    Turn {
        cos: Lane::splat(simd, 1.0),
        sin: Lane::splat(simd, 0.0),
    }
}

/// [`Turn::new`].
#[inline(always)]
fn turn<S: Simd>(simd: S, c: Lane<S>, d: Lane<S>, square: Lane<S>) -> Turn<Lane<S>> {
    let inverse = Lane::splat(simd, 1.0) / square;
    Turn {
        cos: (c * c - d * d) * inverse,
        sin: Lane::splat(simd, 2.0) * c * d * inverse,
    }
}

/// [`Turn::to_hit`].
#[inline(always)]
fn to_hit<S: Simd>(
    simd: S,
    k: &[Lane<S>; 3],
    m: &[Lane<S>; 3],
    s: &[Lane<S>; 3],
) -> (Turn<Lane<S>>, [Lane<S>; 3]) {
    let (zero, one) = (Lane::splat(simd, 0.0), Lane::splat(simd, 1.0));
    let s_hit = cross(k, m);
    let (c, d) = (dot(&s_hit, s), dot(m, s));
    let square = c * c + d * d;
    let aslant = Lane::splat(simd, STRAIGHT).less(square);
    let turned = turn(simd, c, d, square);
    let inverse = one / square.sqrt();
    let mut out = *s;
    for n in 0..3 {
        out[n] = aslant.select(inverse * s_hit[n], s[n]);
    }
    let turned = Turn {
        cos: aslant.select(turned.cos, one),
        sin: aslant.select(turned.sin, zero),
    };
    (turned, out)
}

/// [`Turn::to_exit`].
#[inline(always)]
fn to_exit<S: Simd>(
    simd: S,
    k: &[Lane<S>; 3],
    s: &[Lane<S>; 3],
    straight: &[Lane<S>; 3],
) -> Turn<Lane<S>> {
    let (zero, one) = (Lane::splat(simd, 0.0), Lane::splat(simd, 1.0));
    let (x, y) = (-k[1], k[0]);
    let square = x * x + y * y;
    let aslant = Lane::splat(simd, STRAIGHT).less(square);
    let s_out = [
        aslant.select(x, straight[0]),
        aslant.select(y, straight[1]),
        aslant.select(zero, straight[2]),
    ];
    let square = aslant.select(square, one);
    turn(simd, dot(&s_out, s), dot(&s_out, &cross(k, s)), square)
}

#[cfg(test)]
mod tests {
    use pulp::{Arch, WithSimd};

    use super::*;
    use crate::trace::counting::grid::DirectionGrid;
    use crate::trace::facets::response::Incidence;
    use crate::trace::photons::interface::Relief;
    use crate::trace::photons::light::{Polarised, ScalarState};
    use crate::trace::photons::paired::Paired;
    use crate::trace::photons::stokes::StokesState;
    use crate::trace::run::walk_of;
    use crate::trace::scene::Scene;
    use crate::trace::vec3::unit;

    struct All<'a, L>(Question<'a>, &'a BinFinder, std::marker::PhantomData<L>);

    impl<L: PhotonState> WithSimd for All<'_, L> {
        /// Number of facets that face the lamp.
        type Output = usize;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> usize {
            let All(question, bins, _) = self;
            let Question { walk, field, .. } = question;
            let (nx, ny) = field.cells();
            let mut both = [FacetLanes::ROOM; 2];
            let mut seen = 0;
            for first in (0..nx * ny).step_by(CELLS) {
                FacetLanes::of::<L, S>(simd, &mut both, question, first);
                for lane in 0..CELLS.min(nx * ny - first) {
                    let (i, j) = ((first + lane) / ny, (first + lane) % ny);
                    for (upper, facets) in [(false, &both[0]), (true, &both[1])] {
                        let (sx, sy) = field.slopes(i, j, upper);
                        let m = unit(&[-sx, -sy, 1.0]);
                        let facing =
                            0.5 * (-walk.k[0] * sx - walk.k[1] * sy + walk.k[2]) / walk.k[2];
                        assert_eq!(facets.facing(lane), facing);
                        if facing <= 0.0 {
                            continue;
                        }
                        seen += 1;
                        let alone = Incidence::of::<L>(walk, &m);
                        assert_eq!(facets.enters(lane), alone.enters());
                        for side in [Side::Above, Side::Below] {
                            if side == Side::Below && !alone.enters() {
                                continue;
                            }
                            let (_, k) = alone.way(side);
                            assert_eq!(facets.direction(side, lane), k);
                            let exit = alone.leaves::<L>(side, facing / (nx * ny) as f64, bins);
                            assert_eq!(facets.power(side, lane), exit.power);
                            assert_eq!(facets.bin(side, lane, bins), exit.bin);
                            let mut numbers = vec![0.0; L::ELEMENTS];
                            exit.light.add_to(&mut numbers);
                            let found: Vec<f64> =
                                facets.numbers(side, lane).take(L::ELEMENTS).collect();
                            assert_eq!(found, numbers);
                        }
                    }
                }
            }
            seen
        }
    }

    fn same_as_alone<L: PhotonState>(below: &str, azimuth_deg: f64) {
        let scene = format!(
            "[light]\ntheta_i_deg = 50\nphi_i_deg = {azimuth_deg}\nstokes = [1, 0.3, -0.2, 0.4]\n\
             [[interface]]\nshape = \"beckmann\"\nalpha_u = 0.5\nalpha_v = 0.3\nseed = 3\ncells = 33\n\
             below = {below}\n[run]\nphotons = 1000\nseed = 1\n"
        );
        let prepared = Scene::parse(&scene)
            .unwrap()
            .prepare(&|_| Err("no files".into()))
            .unwrap();
        let walk = walk_of(&prepared, &|_| true);
        let Relief::Field(field) = &walk.stack.interfaces[0].relief else {
            panic!("a field");
        };
        let question = Question {
            walk: &walk,
            field,
            smooth: true,
            counts: true,
        };
        for grid in [DirectionGrid::polar(45, 180), DirectionGrid::disc(64)] {
            let bins = grid.finder();
            let all = All::<L>(question, &bins, std::marker::PhantomData);
            let seen = Arch::new().dispatch(all);
            assert!(seen > 1000, "{seen}");
            // Also with the narrowest register.
            let all = All::<L>(question, &bins, std::marker::PhantomData);
            all.with_simd(pulp::Scalar::new());
        }
    }

    #[test]
    fn every_lane_has_the_bits_of_a_single_facet() {
        let stain = "{ n = 0.9, k = 0.02 }\nthickness_um = 3.0\n[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }";
        for below in ["{ n = 1.5 }", "{ n = 0.7 }", "{ n = 0.35, k = 2.7 }", stain] {
            for azimuth_deg in [0.0, 205.0] {
                same_as_alone::<Polarised>(below, azimuth_deg);
                same_as_alone::<StokesState>(below, azimuth_deg);
                same_as_alone::<ScalarState>(below, azimuth_deg);
                same_as_alone::<Paired>(below, azimuth_deg);
            }
        }
    }
}
