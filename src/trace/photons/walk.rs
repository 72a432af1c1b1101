//! The path of one photon through a stack: hits, Fresnel, transport between interfaces, exits.
//!
//! Call [`Walk::photon`]. Every photon is unit light and is counted in a [`TallyBatch`]. Reflection
//! or refraction is drawn by the fractions for unpolarised light, so the Mueller matrix is valid
//! for every lamp. With [`Method::Split`] both branches are followed while they carry enough,
//! metals and layers absorb their part of every photon, and weak photons undergo roulette.

mod emerge;
mod splitting;
mod waiting;

use super::interface::{Interface, RayEnd, ReliefPoint, Stack};
use super::light::PhotonState;
use crate::model::polarisation::Channel;
use crate::trace::counting::tally::TallyBatch;
use crate::trace::rng::RandomStream;
use crate::trace::surfaces::height_field::Side;
use crate::trace::vec3::{V3, combine, dot};

pub use splitting::worth_splitting;
use waiting::State;
pub use waiting::Waiting;

/// How random numbers are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// As in nature: every photon takes one branch and ends in one place, with weight 1.
    Analog,
    /// The same on average, with less noise: stratified starts, both branches at a hit while both
    /// carry enough, absorption by weight, roulette for weak photons.
    Split,
}

/// Weight below which a photon undergoes roulette.
const WEAK: f64 = 1e-3;
/// Weight of a photon that survives roulette.
const REVIVED: f64 = 1e-2;

/// Largest number of splits of a photon on rough interfaces; beyond it one branch is drawn. On
/// ordinary roughness a photon splits a few times. Between walls that light crosses hundreds of
/// times there would be as many parts, each with a long path.
const SPLITS_MAX: u32 = 16;
/// Smallest probability of a branch between smooth planes. There only the draw itself makes noise,
/// and each further reflection is fainter: a branch drawn with its small probability (two per cent,
/// then two per cent of those) would be missed by many runs, whose standard error would not show
/// it. The weights compensate for the higher probability.
const FLAT_CHANCE_MIN: f64 = 0.25;
/// Largest weight up to which this makes the photons of the likelier branch heavier. Without a
/// limit, a path of a thousand reflections would multiply its weight a thousand times: a few
/// photons would hold most of the light, and most runs, including their standard errors, would miss
/// them.
const HEAVIEST: f64 = 2.0;
/// Work of one interaction, in crossed cells.
const INTERACTION: u64 = 16;

/// The common parameters of all photons of a run.
pub struct Walk<'a> {
    /// The interfaces.
    pub stack: &'a Stack,
    /// How random numbers are used.
    pub method: Method,
    /// The lamp's Stokes vector divided by its I; energies are for this light.
    pub stokes: [f64; 4],
    /// Direction of travel of the lamp's light.
    pub k: V3,
    /// s of the lamp's frame, also used for exits along ±n.
    pub s: V3,
    /// Interactions after which a photon is given up.
    pub interactions_max: u32,
    /// Least fraction in the weaker branch for following both after the first hit
    /// ([`worth_splitting`]).
    pub worth_splitting: f64,
    /// Whether to continue a batch with this amount of work ([`TallyBatch::work`]); also called
    /// during a photon, because one may take as long as thousands of others.
    pub go_on: &'a (dyn Fn(u64) -> bool + Sync),
}

enum Event {
    Goes,
    Ends,
}

impl Walk<'_> {
    /// Traces a photon that crosses the first interface's outermost level at the fractions `x`, `y`
    /// of its tile.
    pub fn photon<L: PhotonState>(
        &self,
        x: f64,
        y: f64,
        random: &mut RandomStream,
        waiting: &mut Waiting<L>,
        batch: &mut TallyBatch,
    ) {
        let relief = &self.stack.interfaces[0].relief;
        let place = match relief.enter(Side::Above, &self.k, x, y, &mut batch.work) {
            RayEnd::Hit(place) => place,
            RayEnd::Free | RayEnd::Lost => {
                // Almost horizontal light travels far without a hit.
                batch.given_up |= batch.take_due() && !(self.go_on)(batch.work);
                return batch.truncate(1.0);
            }
        };
        self.photon_at(place, random, waiting, batch);
    }

    /// Traces a photon that hits the first interface at `place`.
    pub fn photon_at<L: PhotonState>(
        &self,
        place: ReliefPoint,
        random: &mut RandomStream,
        waiting: &mut Waiting<L>,
        batch: &mut TallyBatch,
    ) {
        let mut state = State {
            light: L::launch(&self.s),
            k: self.k,
            side: Side::Above,
            interface: 0,
            place,
            interactions: 0,
        };
        waiting.splits = 0;
        self.follow(&mut state, waiting, random, batch);
        self.follow_waiting(waiting, random, batch);
    }

    /// Continues light from its first hit, at `place`, along `k` on a side.
    #[expect(clippy::too_many_arguments, reason = "a photon's state and its tools")]
    pub fn go_on<L: PhotonState>(
        &self,
        light: L,
        k: V3,
        side: Side,
        place: ReliefPoint,
        random: &mut RandomStream,
        waiting: &mut Waiting<L>,
        batch: &mut TallyBatch,
    ) {
        let mut state = State {
            light,
            k,
            side,
            interface: 0,
            place,
            interactions: 1,
        };
        waiting.splits = 0;
        if let Event::Goes = self.advance(&mut state, random, batch) {
            self.follow(&mut state, waiting, random, batch);
        }
        self.follow_waiting(waiting, random, batch);
    }

    fn follow_waiting<L: PhotonState>(
        &self,
        waiting: &mut Waiting<L>,
        random: &mut RandomStream,
        batch: &mut TallyBatch,
    ) {
        while let Some(mut other) = waiting.pop() {
            if let Event::Goes = self.advance(&mut other, random, batch) {
                self.follow(&mut other, waiting, random, batch);
            }
        }
    }

    /// From a hit to the end of the path.
    fn follow<L: PhotonState>(
        &self,
        state: &mut State<L>,
        waiting: &mut Waiting<L>,
        random: &mut RandomStream,
        batch: &mut TallyBatch,
    ) {
        loop {
            if state.interactions >= self.interactions_max {
                return batch.truncate(state.light.power(&self.stokes));
            }
            batch.work += INTERACTION;
            if batch.take_due() && !(self.go_on)(batch.work) {
                batch.given_up = true;
            }
            if batch.given_up {
                return waiting.clear();
            }
            let interface = &self.stack.interfaces[state.interface];
            let event = if interface.roughness.is_some() || interface.diffuse.is_some() {
                self.meet_rough(state, interface, random, batch)
            } else {
                let m = interface.relief.normal(&state.place);
                if self.method == Method::Split && waiting.has_room() {
                    self.split_smooth(state, waiting, &m, random, batch)
                } else {
                    self.meet_smooth(state, interface, &m, random, batch)
                }
            };
            if let Event::Ends = event {
                return;
            }
            if let Event::Ends = self.advance(state, random, batch) {
                return;
            }
        }
    }

    /// To the next hit, or out.
    fn advance<L: PhotonState>(
        &self,
        state: &mut State<L>,
        random: &mut RandomStream,
        batch: &mut TallyBatch,
    ) -> Event {
        let relief = &self.stack.interfaces[state.interface].relief;
        let crossed = &mut batch.work;
        let mut way = relief.onward(&state.place, state.side, &state.k, crossed);
        if let RayEnd::Free = way {
            let below = match state.side {
                Side::Above => state.interface.checked_sub(1),
                Side::Below => Some(state.interface),
            };
            // `below` is the interface above the layer in which the light is.
            let last = self.stack.interfaces.len() - 1;
            let Some(over) = below.filter(|&i| i < last || state.side == Side::Above) else {
                self.exit(state, batch);
                return Event::Ends;
            };
            let kept = self.stack.kept_in_layer(over, state.k[2].abs());
            if kept < 1.0 && !self.survive(state, kept, random, batch) {
                return Event::Ends;
            }
            (state.interface, state.side) = match state.side {
                Side::Above => (over, Side::Below),
                Side::Below => (over + 1, Side::Above),
            };
            let crossed = &mut batch.work;
            way = self
                .stack
                .enter(state.interface, state.side, &state.k, random, crossed);
        }
        match way {
            RayEnd::Hit(place) => {
                state.place = place;
                Event::Goes
            }
            RayEnd::Free | RayEnd::Lost => {
                batch.truncate(state.light.power(&self.stokes));
                Event::Ends
            }
        }
    }

    fn exit<L: PhotonState>(&self, state: &mut State<L>, batch: &mut TallyBatch) {
        let power = state.light.power(&self.stokes);
        state.light.leave(&state.k, &self.s);
        batch.exit(
            &state.light,
            power,
            state.side,
            &state.k,
            state.interactions,
        );
    }

    /// Absorbs all but `kept`; returns `false` if the photon ended.
    fn survive<L: PhotonState>(
        &self,
        state: &mut State<L>,
        kept: f64,
        random: &mut RandomStream,
        batch: &mut TallyBatch,
    ) -> bool {
        let power = state.light.power(&self.stokes);
        if self.method == Method::Analog {
            if random.uniform() < kept {
                return true;
            }
            batch.absorb(power);
            return false;
        }
        batch.absorb(power * (1.0 - kept));
        state.light.scale(kept);
        self.roulette(&mut state.light, random)
    }

    /// Returns `false` if a weak photon ended.
    pub fn roulette<L: PhotonState>(&self, light: &mut L, random: &mut RandomStream) -> bool {
        let weight = light.weight();
        if weight >= WEAK {
            return true;
        }
        let chance = weight / REVIVED;
        if random.uniform() < chance {
            light.scale(1.0 / chance);
            return true;
        }
        false
    }

    /// A hit on a smooth facet: both branches are followed, always at the first hit, later if both
    /// carry enough.
    fn split_smooth<L: PhotonState>(
        &self,
        state: &mut State<L>,
        waiting: &mut Waiting<L>,
        m: &V3,
        random: &mut RandomStream,
        batch: &mut TallyBatch,
    ) -> Event {
        let interface = &self.stack.interfaces[state.interface];
        let boundary = interface.boundary(state.side);
        let cos = -state.side.sign() * dot(&state.k, m);
        if boundary.is_metal() || cos <= 0.0 {
            return self.meet_smooth(state, interface, m, random, batch);
        }
        let split = boundary.at(cos);
        // Total reflection inside, at an absorbing layer, absorbs part of the light.
        if split.cos_refracted <= 0.0 && !boundary.is_transparent() {
            return self.meet_smooth(state, interface, m, random, batch);
        }
        if state.interactions > 0 {
            // The frame of the hit is not set yet: the fraction for unpolarised light is accurate
            // enough.
            let weight = state.light.weight();
            let weaker = split
                .reflected
                .unpolarised()
                .min(split.refracted.unpolarised());
            let interfaces = self.stack.interfaces.len();
            let deep = interfaces > 1
                && state.interactions as usize >= interfaces
                && !self.stack.is_flat();
            let spent = waiting.splits >= SPLITS_MAX && !self.stack.is_flat();
            if spent || deep || weaker * weight < self.worth_splitting {
                return self.meet_smooth(state, interface, m, random, batch);
            }
        }
        state.light.meet(&state.k, m);
        state.interactions += 1;
        if split.cos_refracted > 0.0 {
            let mut other = *state;
            other.light.pass(&split.refracted, 1.0);
            refract(
                &mut other.k,
                m,
                state.side,
                cos,
                split.ratio,
                split.cos_refracted,
            );
            other.side = state.side.across();
            waiting.push(other);
            waiting.splits += 1;
        }
        state.light.pass(&split.reflected, 1.0);
        reflect(&mut state.k, m, state.side, cos);
        // The reflection is negligible (index 1, or exactly Brewster's angle).
        if state.light.weight() <= f64::MIN_POSITIVE {
            return Event::Ends;
        }
        Event::Goes
    }

    /// A hit on a mirror with normal `m` (upwards): one branch is drawn.
    #[inline]
    fn meet_smooth<L: PhotonState>(
        &self,
        state: &mut State<L>,
        interface: &Interface,
        m: &V3,
        random: &mut RandomStream,
        batch: &mut TallyBatch,
    ) -> Event {
        let boundary = interface.boundary(state.side);
        // A facet is hit from its own side; rounding at grazing incidence must not reverse that.
        let cos = (-state.side.sign() * dot(&state.k, m)).max(1e-12);
        let split = boundary.at(cos);
        state.light.meet(&state.k, m);
        state.interactions += 1;
        let weight = state.light.weight();
        let share = state.light.share(&split.reflected) / weight;
        if split.cos_refracted > 0.0 {
            let mut chance = share;
            // A branch that carries almost nothing keeps its probability.
            if share > 1e-9 && self.method == Method::Split && self.stack.is_flat() {
                let fairer = share.clamp(FLAT_CHANCE_MIN, 1.0 - FLAT_CHANCE_MIN);
                let gain = (share / fairer).max((1.0 - share) / (1.0 - fairer));
                if weight * gain <= HEAVIEST {
                    chance = fairer;
                }
            }
            if random.uniform() < chance {
                state.light.pass(&split.reflected, 1.0 / chance);
            } else {
                state.light.pass(&split.refracted, 1.0 / (1.0 - chance));
                refract(
                    &mut state.k,
                    m,
                    state.side,
                    cos,
                    split.ratio,
                    split.cos_refracted,
                );
                state.side = state.side.across();
                return Event::Goes;
            }
        } else if boundary.is_transparent() {
            state.light.pass(&split.reflected, 1.0);
        } else if !self.reflect_off_metal(state, &split.reflected, share, random, batch) {
            return Event::Ends;
        }
        reflect(&mut state.k, m, state.side, cos);
        Event::Goes
    }

    fn reflect_off_metal<L: PhotonState>(
        &self,
        state: &mut State<L>,
        reflected: &Channel,
        share: f64,
        random: &mut RandomStream,
        batch: &mut TallyBatch,
    ) -> bool {
        let before = state.light.power(&self.stokes);
        if self.method == Method::Analog {
            if random.uniform() < share {
                state.light.pass(reflected, 1.0 / share);
                return true;
            }
            // The branch is drawn by unpolarised light, the loss is that of the incident light:
            // both are correct on average.
            state.light.pass(reflected, 1.0);
            batch.absorb((before - state.light.power(&self.stokes)) / (1.0 - share));
            return false;
        }
        state.light.pass(reflected, 1.0);
        batch.absorb(before - state.light.power(&self.stokes));
        self.roulette(&mut state.light, random)
    }

    /// A hit on a facet that is rough below the resolution of the relief, or has a diffuse body:
    /// the light walks on Smith's surface until it leaves the facet.
    fn meet_rough<L: PhotonState>(
        &self,
        state: &mut State<L>,
        interface: &Interface,
        random: &mut RandomStream,
        batch: &mut TallyBatch,
    ) -> Event {
        let [u, v, n] = interface.relief.frame(&state.place);
        // Local z points to the side of the light, so below everything is mirrored in the facet.
        let local = |k: &V3, side: Side| [dot(k, &u), dot(k, &v), side.sign() * dot(k, &n)];
        let world = |m: &V3, side: Side| {
            let flat = combine(m[0], &u, m[1], &v);
            combine(1.0, &flat, side.sign() * m[2], &n)
        };
        let mut height = 1.0;
        loop {
            if let Some(roughness) = &interface.roughness {
                let k = local(&state.k, state.side);
                match roughness.next_height(&k, height, random) {
                    Some(next) => height = next,
                    None => return Event::Goes,
                }
                // Heights that rounding or underflow made meaningless.
                if height.is_nan() || height <= 0.0 {
                    batch.truncate(state.light.power(&self.stokes));
                    return Event::Ends;
                }
            } else if state.side.sign() * dot(&state.k, &n) > 0.0 {
                return Event::Goes;
            }
            if state.interactions >= self.interactions_max {
                batch.truncate(state.light.power(&self.stokes));
                return Event::Ends;
            }
            let m = match &interface.roughness {
                Some(roughness) => {
                    let k = local(&state.k, state.side);
                    world(&roughness.visible_normal(&k, random), state.side)
                }
                None => world(&[0.0, 0.0, 1.0], state.side),
            };
            // `meet_smooth` expects the normal upwards.
            let upwards = m.map(|x| x * state.side.sign());
            let before = state.side;
            if let Event::Ends = self.meet_smooth(state, interface, &upwards, random, batch) {
                return Event::Ends;
            }
            if state.side != before {
                height = 1.0 - height;
                if let (Side::Below, Some(diffuse)) = (state.side, &interface.diffuse) {
                    return self.re_emerge(state, interface, diffuse.strength, random, batch);
                }
            }
        }
    }
}

#[inline]
fn reflect(k: &mut V3, m: &V3, side: Side, cos: f64) {
    *k = combine(1.0, k, 2.0 * cos * side.sign(), m);
}

#[inline]
fn refract(k: &mut V3, m: &V3, side: Side, cos: f64, ratio: f64, cos_refracted: f64) {
    *k = combine(ratio, k, (ratio * cos - cos_refracted) * side.sign(), m);
}
