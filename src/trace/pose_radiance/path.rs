//! Paths of light over a ridged surface, traced from the camera or the lamp and connected to the other end.

use super::super::rng::{Purpose, RandomStream};
use super::super::vec3::{V3, combine, cross, dot, scaled, unit};
use super::{RadianceOptions, RidgedSurface};
use crate::trace::facets::scattering::DiffuseBody;
use crate::trace::photons::light::PhotonState;
use crate::trace::surfaces::height_field::Side;
use crate::trace::surfaces::surface_profile::{ProfileFlight, ProfileSpot};

/// Steps of the low-discrepancy points on the lamp: powers of the reciprocal plastic number (M.
/// Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
const SPREAD: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];
/// Largest number of bounces of a path (each loses most of its light on plastic, a third on steel).
const BOUNCES_MAX: u32 = 32;
/// Weight below which a path undergoes Russian roulette.
const WEAK: f64 = 0.05;

/// Start of a path, which is connected to the other end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    Camera,
    Lamp,
}

/// The body's behaviour on a path. If the light of a translucent body enters again after leaving,
/// its loss is already in the body's strength, which counts the light that leaves for good.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum BodyState {
    /// Light leaves the facet that it entered.
    Opaque,
    /// Light leaves anywhere on the profile.
    Translucent,
    /// Light of a translucent body that has left.
    Left,
}

/// Interaction of a path with a facet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Event {
    Mirrored,
    Diffused,
}

pub(super) struct PathTask<'a> {
    pub(super) surface: &'a RidgedSurface,
    pub(super) start: End,
    pub(super) incident: V3,
    pub(super) outgoing: V3,
    pub(super) options: &'a RadianceOptions,
}

/// The facet of a hit: its frame, and the direction back along the path in it.
struct HitFacet {
    frame: [V3; 3],
    back: V3,
}

impl HitFacet {
    fn local(&self, w: &V3) -> V3 {
        self.frame.map(|axis| dot(&axis, w))
    }

    fn world(&self, w: &V3) -> V3 {
        let [u, v, n] = &self.frame;
        combine(1.0, &combine(w[0], u, w[1], v), w[2], n)
    }
}

impl PathTask<'_> {
    pub fn batch<L: PhotonState>(&self, batch: u64, paths: u64) -> f64 {
        // The starts of the paths and their first points on the lamp are low-discrepancy points,
        // shifted by one random step per batch.
        let mut shifts = RandomStream::new(self.options.seed, Purpose::Batch, batch);
        let shift = [(); 3].map(|()| shifts.uniform());
        let mut sum = 0.0;
        for path in 0..paths {
            let index = 2 * (batch * paths + path) + u64::from(self.start == End::Lamp);
            let mut random = RandomStream::new(self.options.seed, Purpose::Photon, index);
            let along = [1.0 / paths as f64, SPREAD[0], SPREAD[1]];
            let [at, r, phi] = [0, 1, 2].map(|i| (shift[i] + path as f64 * along[i]).fract());
            sum += self
                .through_the_lens(&mut random)
                .path::<L>(at, [r, phi], &mut random);
        }
        sum / paths as f64
    }

    /// Traces one path; returns the light connected to it.
    fn path<L: PhotonState>(
        &self,
        at: f64,
        first_lamp: [f64; 2],
        random: &mut RandomStream,
    ) -> f64 {
        let profile = &self.surface.profile;
        let (start, share) = match self.start {
            End::Camera => (self.outgoing, 1.0),
            // From the lamp the walk gives f cos θo; the radiance is f cos θi.
            End::Lamp => {
                let lamp = self.lamp(first_lamp);
                (lamp, lamp[2] / self.outgoing[2])
            }
        };
        // The rim of a cone may be below the surface.
        if start[2] <= 0.0 || self.outgoing[2] <= 0.0 {
            return 0.0;
        }
        let mut k = scaled(-1.0, &start);
        let mut first = None;
        let mut body = self.body(random);
        let mut light = L::launch(&perpendicular(&k));
        let mut gathered = 0.0;
        let mut flight = profile.enter(Side::Above, &k, at, &mut 0);
        for bounce in 0..BOUNCES_MAX {
            let ProfileFlight::Hit(spot) = flight else {
                break;
            };
            let (along, normal) = profile.pieces()[spot.piece].frame(spot.v);
            let facet = HitFacet {
                frame: [[1.0, 0.0, 0.0], along, normal],
                back: scaled(-1.0, &k),
            };
            let lamp = if bounce == 0 {
                first_lamp
            } else {
                [random.uniform(), random.uniform()]
            };
            gathered += self.joined(&light, first, body, &facet, &spot, lamp);
            gathered += self.joined_from_body(&light, first, body, &facet, lamp, random);
            let Some((event, next, from)) = self.scattered(&mut light, body, &facet, random) else {
                break;
            };
            if from.is_some() {
                body = BodyState::Left;
            }
            first = first.or(Some(event));
            k = next;
            let spot = from.unwrap_or(spot);
            let weight = light.weight();
            if weight < WEAK {
                if random.uniform() >= weight / WEAK {
                    break;
                }
                light.scale(WEAK / weight);
            }
            flight = profile.onward(&spot, Side::Above, &k, &mut 0);
        }
        gathered * share
    }

    /// The body's behaviour on this path: translucent with its probability. An opaque body uses no
    /// random numbers.
    fn body(&self, random: &mut RandomStream) -> BodyState {
        let share = self.surface.diffuse.map_or(0.0, |body| body.translucency);
        match share > 0.0 && random.uniform() < share {
            true => BodyState::Translucent,
            false => BodyState::Opaque,
        }
    }

    /// The same task for one point of the lens's pupil. A point-like lens uses no random numbers.
    fn through_the_lens(&self, random: &mut RandomStream) -> Self {
        let radius = self.options.cones.lens.rad();
        let outgoing = if radius == 0.0 {
            self.outgoing
        } else {
            within(&self.outgoing, radius, [random.uniform(), random.uniform()])
        };
        PathTask { outgoing, ..*self }
    }

    /// A direction to the point of the lamp's disc for two numbers from 0 to 1.
    fn lamp(&self, point: [f64; 2]) -> V3 {
        within(&self.incident, self.options.cones.lamp.rad(), point)
    }

    /// Light that comes directly from the other end and is scattered here into the path.
    fn joined<L: PhotonState>(
        &self,
        light: &L,
        first: Option<Event>,
        body: BodyState,
        facet: &HitFacet,
        spot: &ProfileSpot,
        lamp: [f64; 2],
    ) -> f64 {
        let (mirrors, diffuses) = self.counted(first);
        let diffuses = diffuses && body == BodyState::Opaque;
        if !mirrors && !diffuses {
            return 0.0;
        }
        let lamp = self.other_end(lamp);
        let normal = &facet.frame[2];
        let (i_n, o_n) = (dot(&lamp, normal), dot(&facet.back, normal));
        if i_n <= 0.0 || o_n <= 0.0 {
            return 0.0;
        }
        let surface = self.surface;
        let profile = &surface.profile;
        if profile.onward(spot, Side::Above, &lamp, &mut 0) != ProfileFlight::Free {
            return 0.0;
        }
        let k = scaled(-1.0, &facet.back);
        let half = unit(&combine(1.0, &lamp, 1.0, &facet.back));
        let density = surface.slopes.density(&facet.local(&half));
        let mut gathered = 0.0;
        if mirrors && density > 0.0 {
            let masked = self.seen(&facet.local(&lamp)) * self.seen(&facet.local(&facet.back));
            let mut mirrored = *light;
            mirrored.meet(&k, &half);
            let reflected = surface.boundary.at(dot(&half, &lamp).min(1.0)).reflected;
            gathered += mirrored.share(&reflected) * density * masked / (4.0 * o_n);
        }
        if let (true, Some(diffuse)) = (diffuses, &surface.diffuse) {
            let mut entering = *light;
            entering.meet(&k, normal);
            let (inwards, more_in) = surface.passing(&facet.local(&facet.back));
            let (outwards, more_out) = surface.passing(&facet.local(&lamp));
            let body = diffuse.strength * std::f64::consts::FRAC_1_PI * (more_in * more_out);
            gathered += entering.share(&inwards) * body * outwards.unpolarised() * i_n;
        }
        gathered
    }

    /// Whether light whose last interaction is specular or diffuse is counted on this path. Paths
    /// that are diffuse next to the camera and specular next to the lamp are counted from the lamp,
    /// all others from the camera.
    fn counted(&self, first: Option<Event>) -> (bool, bool) {
        match self.start {
            End::Camera => (first != Some(Event::Diffused), true),
            End::Lamp => (false, first == Some(Event::Mirrored)),
        }
    }

    /// A direction to the other end of the path.
    fn other_end(&self, lamp: [f64; 2]) -> V3 {
        match self.start {
            End::Camera => self.lamp(lamp),
            End::Lamp => self.outgoing,
        }
    }

    /// As `joined`, for light that entered anywhere and leaves a translucent body here.
    fn joined_from_body<L: PhotonState>(
        &self,
        light: &L,
        first: Option<Event>,
        body: BodyState,
        facet: &HitFacet,
        lamp: [f64; 2],
        random: &mut RandomStream,
    ) -> f64 {
        let surface = self.surface;
        let Some(diffuse) = surface.diffuse.filter(|_| body == BodyState::Translucent) else {
            return 0.0;
        };
        // Drawn even if unused, so that a path's random numbers do not depend on it.
        let spot = surface.exits.at(&surface.profile, random.uniform());
        if !self.counted(first).1 || dot(&facet.back, &facet.frame[2]) <= 0.0 {
            return 0.0;
        }
        let lamp = self.other_end(lamp);
        let profile = &surface.profile;
        let (along, normal) = profile.pieces()[spot.piece].frame(spot.v);
        let i_n = dot(&lamp, &normal);
        if i_n <= 0.0 || profile.onward(&spot, Side::Above, &lamp, &mut 0) != ProfileFlight::Free {
            return 0.0;
        }
        let there = HitFacet {
            frame: [[1.0, 0.0, 0.0], along, normal],
            back: facet.back,
        };
        let mut entering = *light;
        entering.meet(&scaled(-1.0, &facet.back), &facet.frame[2]);
        let (inwards, more_in) = surface.passing(&facet.local(&facet.back));
        let (outwards, more_out) = surface.passing(&there.local(&lamp));
        let evenly = diffuse.strength * surface.exits.per_period;
        let body = evenly * std::f64::consts::FRAC_1_PI * (more_in * more_out);
        entering.share(&inwards) * body * outwards.unpolarised() * i_n
    }

    /// Smith's G1 of a direction in the facet's frame.
    fn seen(&self, w: &V3) -> f64 {
        self.surface.slopes.seen(w)
    }

    /// A normal that a ray along `k` meets, in the facet's frame.
    fn normal(&self, k: &V3, random: &mut RandomStream) -> V3 {
        match self.surface.slopes.tail {
            0.0 => self.surface.roughness.visible_normal(k, random),
            _ => self.surface.slopes.visible_normal(k, random),
        }
    }

    /// The path's next direction and, if it leaves elsewhere, its new point; `None` at its end.
    fn scattered<L: PhotonState>(
        &self,
        light: &mut L,
        body: BodyState,
        facet: &HitFacet,
        random: &mut RandomStream,
    ) -> Option<(Event, V3, Option<ProfileSpot>)> {
        let surface = self.surface;
        let k = scaled(-1.0, &facet.back);
        let normal = facet.frame[2];
        if let Some(diffuse) = surface.diffuse.filter(|_| body != BodyState::Left) {
            // Half of the paths continue in the body: on plastic most of the light does.
            if random.bits() & 1 == 0 {
                let local = DiffuseBody::direction(random);
                let from = (body == BodyState::Translucent)
                    .then(|| surface.exits.at(&surface.profile, random.uniform()));
                let (out, leaves, share) = match &from {
                    None => (facet.world(&local), normal, 1.0),
                    Some(spot) => {
                        let piece = &surface.profile.pieces()[spot.piece];
                        let (along, normal) = piece.frame(spot.v);
                        let there = HitFacet {
                            frame: [[1.0, 0.0, 0.0], along, normal],
                            back: facet.back,
                        };
                        (there.world(&local), normal, surface.exits.per_period)
                    }
                };
                light.meet(&k, &normal);
                let (inwards, more) = surface.passing(&facet.local(&facet.back));
                light.pass(&inwards, 2.0 * share * more);
                light.depolarise(&perpendicular(&out));
                light.meet(&out, &leaves);
                let (outwards, more) = surface.passing(&local);
                light.pass(&outwards, diffuse.strength * more);
                return Some((Event::Diffused, out, from));
            }
            light.scale(2.0);
        }
        let m = facet.world(&self.normal(&facet.local(&k), random));
        let cos = dot(&m, &facet.back).clamp(1e-12, 1.0);
        let out = combine(1.0, &k, 2.0 * cos, &m);
        if dot(&out, &normal) <= 0.0 {
            return None;
        }
        light.meet(&k, &m);
        light.pass(
            &surface.boundary.at(cos).reflected,
            self.seen(&facet.local(&out)),
        );
        Some((Event::Mirrored, out, None))
    }
}

/// A unit vector perpendicular to `k`, horizontal unless `k` is vertical.
fn perpendicular(k: &V3) -> V3 {
    let square = k[0] * k[0] + k[1] * k[1];
    if square < 1e-24 {
        [1.0, 0.0, 0.0]
    } else {
        scaled(1.0 / square.sqrt(), &[-k[1], k[0], 0.0])
    }
}

/// A direction within `radius` (rad) of `w`, uniformly distributed if the two numbers are uniform
/// from 0 to 1.
fn within(w: &V3, radius: f64, [area, turn]: [f64; 2]) -> V3 {
    if radius == 0.0 {
        return *w;
    }
    let a = perpendicular(w);
    let b = cross(w, &a);
    let (r, phi) = (radius * area.sqrt(), std::f64::consts::TAU * turn);
    let (s, c) = phi.sin_cos();
    let (sin, cos) = r.sin_cos();
    combine(cos, w, sin, &combine(c, &a, s, &b))
}
