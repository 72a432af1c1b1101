//! Radiance of a ridged surface for one pose of the rig, by path tracing: the reference for the
//! closed forms.
//!
//! The function to call is [`RidgedSurface::radiance`]. Paths start at the camera and are connected
//! to the lamp at every hit; by reciprocity this is the light that reaches the camera. Light that a
//! narrow lobe reflects from the lamp onto a diffuse wall would rarely be found that way, so it is
//! traced from the lamp; each path is counted by exactly one of the two methods. All orders of
//! scattering between facets and risers are included: Beckmann roughness below the profile (one
//! microfacet per hit, Smith's masking), and on dielectrics a Lambert body under the Fresnel
//! boundary. With polarisation, the lamp is unpolarised and the camera insensitive to polarisation;
//! each bounce polarises the light for the next ones.
//!
//! *Conditioning.* Contributions are positive and are summed by replicates, so there is no
//! cancellation: narrow lobes (α down to 1e-6) and grazing poses give noise, which the standard
//! error covers, not rounding errors.

use rayon::prelude::*;

use super::facet::{Diffuse, Roughness};
use super::height_field::Side;
use super::light::{Light, Scalar};
use super::profile::{Profile, ProfileFlight, ProfileSpot};
use super::rng::{Purpose, Stream};
use super::stokes::Stokes;
use super::tails::Tailed;
use super::tally::Estimate;
use super::vec3::{V3, combine, cross, dot, scaled, unit};
use crate::geometry::{Cones, Directions};
use crate::model::polarisation::{Boundary, Channel};
use crate::model::rough_boundary::RoughBoundary;

/// A ridged sample as the tracer uses it.
#[derive(Debug, Clone)]
pub struct RidgedSurface {
    /// Its profile across the ridges.
    pub profile: Profile,
    /// Roughness of the facets below the profile.
    pub roughness: Roughness,
    /// Refractive index, for light from air.
    pub boundary: Boundary,
    /// Diffuse light from the body.
    pub diffuse: Option<Diffuse>,
    /// Transmission of that light through the rough boundary, relative to Fresnel's transmittance.
    entrance: RoughBoundary,
    /// Points at which the light of a translucent body leaves.
    evenly: Evenly,
    /// The slopes of the facets.
    slopes: Tailed,
    /// Real part of the index.
    index: f64,
}

/// Points that are uniformly distributed over the surface of a profile.
#[derive(Debug, Clone)]
struct Evenly {
    /// Length of the profile up to the end of each piece.
    up_to: Vec<f64>,
    /// Length of the profile over its period.
    per_period: f64,
}

impl Evenly {
    fn over(profile: &Profile) -> Self {
        let lengths = profile
            .pieces()
            .iter()
            .map(|p| (p.to - p.from).hypot(p.z_to - p.z_from));
        let up_to: Vec<f64> = lengths
            .scan(0.0, |sum, length| {
                *sum += length;
                Some(*sum)
            })
            .collect();
        let all = up_to.last().copied().unwrap_or(0.0);
        Evenly {
            per_period: all / profile.period(),
            up_to,
        }
    }

    /// The point for a number from 0 to 1.
    fn at(&self, profile: &Profile, share: f64) -> ProfileSpot {
        let last = self.up_to.len() - 1;
        let length = share * self.up_to[last];
        let piece = self.up_to.partition_point(|end| *end <= length).min(last);
        let p = &profile.pieces()[piece];
        let before = if piece == 0 {
            0.0
        } else {
            self.up_to[piece - 1]
        };
        let part = ((length - before) / (self.up_to[piece] - before)).clamp(0.0, 1.0);
        let v = p.from + part * (p.to - p.from);
        ProfileSpot {
            piece,
            v,
            z: p.height(v),
        }
    }
}

/// Options of a traced radiance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadianceOptions {
    /// Paths from the camera.
    pub paths: u64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// The cones of lamp and lens, over which the radiance is averaged.
    pub cones: Cones,
    /// Whether polarisation is followed between bounces.
    pub polarised: bool,
}

/// Number of replicates, whose spread gives the standard error.
const BATCHES: u64 = 64;
/// Steps of the low-discrepancy points on the lamp: powers of the reciprocal plastic number (M.
/// Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
const SPREAD: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];
/// Largest number of bounces of a path (each loses most of its light on plastic, a third on steel).
const BOUNCES_MAX: u32 = 32;
/// Weight below which a path undergoes Russian roulette.
const WEAK: f64 = 0.05;

impl RidgedSurface {
    /// Makes a sample with rough facets under a boundary of index n + ik, with or without diffuse
    /// light.
    #[must_use]
    pub fn new(
        profile: Profile,
        roughness: Roughness,
        [n, k]: [f64; 2],
        diffuse: Option<Diffuse>,
    ) -> Self {
        let entrance = match diffuse {
            Some(_) => RoughBoundary::new(roughness.alpha_u, roughness.alpha_v, 0.0, n),
            None => RoughBoundary::smooth(),
        };
        RidgedSurface {
            evenly: Evenly::over(&profile),
            slopes: Tailed {
                roughness,
                tail: 0.0,
            },
            index: n,
            profile,
            roughness,
            boundary: Boundary::new(1.0, n, k),
            diffuse: diffuse.map(|body| body.under(&entrance, n)),
            entrance,
        }
    }

    /// Returns the sample with a tail ι of its slopes ([`crate::model::extended::slopes`]); 0 is
    /// Beckmann.
    #[must_use]
    pub fn with_tail(mut self, tail: f64) -> Self {
        let n = self.index;
        self.slopes.tail = tail;
        if let Some(body) = &mut self.diffuse {
            let was = self.entrance.clone();
            let Roughness { alpha_u, alpha_v } = self.roughness;
            self.entrance = RoughBoundary::new(alpha_u, alpha_v, tail, n);
            let ratio = |cos: f64| was.transmittance(cos, n) / self.entrance.transmittance(cos, n);
            let [first, second] = body.cosines.map(ratio);
            body.strength *= first * second;
        }
        self
    }

    /// Transmission of the boundary along a direction in the facet's frame: that of a smooth
    /// boundary, and the factor of the rough one.
    fn passing(&self, w: &V3) -> (Channel, f64) {
        let smooth = self.boundary.at(w[2].clamp(1e-12, 1.0)).refracted;
        let share = smooth.unpolarised().max(f64::MIN_POSITIVE);
        let more = self.entrance.excess(w[0], w[1], w[2]) / share;
        (smooth, 1.0 + more)
    }

    /// Radiance towards `directions.outgoing` for irradiance 1 on a surface facing the lamp, in
    /// sr⁻¹, with its standard error; 0 if lamp or camera is below the surface.
    #[must_use]
    pub fn radiance(&self, directions: &Directions, options: &RadianceOptions) -> Estimate {
        let incident: V3 = directions.incident.into();
        let outgoing: V3 = directions.outgoing.into();
        if incident[2] <= 0.0 || outgoing[2] <= 0.0 {
            return Estimate {
                value: 0.0,
                std: 0.0,
            };
        }
        let paths = options.paths.div_ceil(BATCHES).max(1);
        let means: Vec<f64> = (0..BATCHES)
            .into_par_iter()
            .map(|batch| {
                let from = |start: End| {
                    let task = Task {
                        surface: self,
                        start,
                        incident,
                        outgoing,
                        options,
                    };
                    if options.polarised {
                        task.batch::<Stokes>(batch, paths)
                    } else {
                        task.batch::<Scalar>(batch, paths)
                    }
                };
                let camera = from(End::Camera);
                if self.diffuse.is_none() {
                    return camera;
                }
                camera + from(End::Lamp)
            })
            .collect();
        let n = BATCHES as f64;
        let mean = means.iter().sum::<f64>() / n;
        let spread: f64 = means.iter().map(|m| (m - mean).powi(2)).sum();
        Estimate {
            value: mean,
            std: (spread / (n * (n - 1.0))).sqrt(),
        }
    }
}

/// Start of a path, which is connected to the other end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Camera,
    Lamp,
}

/// The body's behaviour on a path. If the light of a translucent body enters again after leaving,
/// its loss is already in the body's strength, which counts the light that leaves for good.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Body {
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

struct Task<'a> {
    surface: &'a RidgedSurface,
    start: End,
    incident: V3,
    outgoing: V3,
    options: &'a RadianceOptions,
}

/// The facet of a hit: its frame, and the direction back along the path in it.
struct Facet {
    frame: [V3; 3],
    back: V3,
}

impl Facet {
    fn local(&self, w: &V3) -> V3 {
        self.frame.map(|axis| dot(&axis, w))
    }

    fn world(&self, w: &V3) -> V3 {
        let [u, v, n] = &self.frame;
        combine(1.0, &combine(w[0], u, w[1], v), w[2], n)
    }
}

impl Task<'_> {
    fn batch<L: Light>(&self, batch: u64, paths: u64) -> f64 {
        // The starts of the paths and their first points on the lamp are low-discrepancy points,
        // shifted by one random step per batch.
        let mut shifts = Stream::new(self.options.seed, Purpose::Batch, batch);
        let shift = [(); 3].map(|()| shifts.uniform());
        let mut sum = 0.0;
        for path in 0..paths {
            let index = 2 * (batch * paths + path) + u64::from(self.start == End::Lamp);
            let mut random = Stream::new(self.options.seed, Purpose::Photon, index);
            let along = [1.0 / paths as f64, SPREAD[0], SPREAD[1]];
            let [at, r, phi] = [0, 1, 2].map(|i| (shift[i] + path as f64 * along[i]).fract());
            sum += self
                .through_the_lens(&mut random)
                .path::<L>(at, [r, phi], &mut random);
        }
        sum / paths as f64
    }

    /// Traces one path; returns the light connected to it.
    fn path<L: Light>(&self, at: f64, first_lamp: [f64; 2], random: &mut Stream) -> f64 {
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
            let facet = Facet {
                frame: [[1.0, 0.0, 0.0], along, normal],
                back: scaled(-1.0, &k),
            };
            let lamp = if bounce == 0 {
                first_lamp
            } else {
                [random.uniform(), random.uniform()]
            };
            gathered += self.joined(&light, first, body, &facet, &spot, lamp);
            gathered += self.joined_evenly(&light, first, body, &facet, lamp, random);
            let Some((event, next, from)) = self.scattered(&mut light, body, &facet, random) else {
                break;
            };
            if from.is_some() {
                body = Body::Left;
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
    fn body(&self, random: &mut Stream) -> Body {
        let share = self.surface.diffuse.map_or(0.0, |body| body.translucency);
        match share > 0.0 && random.uniform() < share {
            true => Body::Translucent,
            false => Body::Opaque,
        }
    }

    /// The same task for one point of the lens's pupil. A point-like lens uses no random numbers.
    fn through_the_lens(&self, random: &mut Stream) -> Self {
        let radius = self.options.cones.lens.rad();
        let outgoing = if radius == 0.0 {
            self.outgoing
        } else {
            within(&self.outgoing, radius, [random.uniform(), random.uniform()])
        };
        Task { outgoing, ..*self }
    }

    /// A direction to the point of the lamp's disc for two numbers from 0 to 1.
    fn lamp(&self, point: [f64; 2]) -> V3 {
        within(&self.incident, self.options.cones.lamp.rad(), point)
    }

    /// Light that comes directly from the other end and is scattered here into the path.
    fn joined<L: Light>(
        &self,
        light: &L,
        first: Option<Event>,
        body: Body,
        facet: &Facet,
        spot: &ProfileSpot,
        lamp: [f64; 2],
    ) -> f64 {
        let (mirrors, diffuses) = self.counted(first);
        let diffuses = diffuses && body == Body::Opaque;
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
    fn joined_evenly<L: Light>(
        &self,
        light: &L,
        first: Option<Event>,
        body: Body,
        facet: &Facet,
        lamp: [f64; 2],
        random: &mut Stream,
    ) -> f64 {
        let surface = self.surface;
        let Some(diffuse) = surface.diffuse.filter(|_| body == Body::Translucent) else {
            return 0.0;
        };
        // Drawn even if unused, so that a path's random numbers do not depend on it.
        let spot = surface.evenly.at(&surface.profile, random.uniform());
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
        let there = Facet {
            frame: [[1.0, 0.0, 0.0], along, normal],
            back: facet.back,
        };
        let mut entering = *light;
        entering.meet(&scaled(-1.0, &facet.back), &facet.frame[2]);
        let (inwards, more_in) = surface.passing(&facet.local(&facet.back));
        let (outwards, more_out) = surface.passing(&there.local(&lamp));
        let evenly = diffuse.strength * surface.evenly.per_period;
        let body = evenly * std::f64::consts::FRAC_1_PI * (more_in * more_out);
        entering.share(&inwards) * body * outwards.unpolarised() * i_n
    }

    /// Smith's G1 of a direction in the facet's frame.
    fn seen(&self, w: &V3) -> f64 {
        self.surface.slopes.seen(w)
    }

    /// A normal that a ray along `k` meets, in the facet's frame.
    fn normal(&self, k: &V3, random: &mut Stream) -> V3 {
        match self.surface.slopes.tail {
            0.0 => self.surface.roughness.visible_normal(k, random),
            _ => self.surface.slopes.visible_normal(k, random),
        }
    }

    /// The path's next direction and, if it leaves elsewhere, its new point; `None` at its end.
    fn scattered<L: Light>(
        &self,
        light: &mut L,
        body: Body,
        facet: &Facet,
        random: &mut Stream,
    ) -> Option<(Event, V3, Option<ProfileSpot>)> {
        let surface = self.surface;
        let k = scaled(-1.0, &facet.back);
        let normal = facet.frame[2];
        if let Some(diffuse) = surface.diffuse.filter(|_| body != Body::Left) {
            // Half of the paths continue in the body: on plastic most of the light does.
            if random.bits() & 1 == 0 {
                let local = Diffuse::direction(random);
                let from = (body == Body::Translucent)
                    .then(|| surface.evenly.at(&surface.profile, random.uniform()));
                let (out, leaves, share) = match &from {
                    None => (facet.world(&local), normal, 1.0),
                    Some(spot) => {
                        let piece = &surface.profile.pieces()[spot.piece];
                        let (along, normal) = piece.frame(spot.v);
                        let there = Facet {
                            frame: [[1.0, 0.0, 0.0], along, normal],
                            back: facet.back,
                        };
                        (there.world(&local), normal, surface.evenly.per_period)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, RigGeometry};

    struct Sample {
        series: &'static str,
        theta_r_deg: f64,
        alpha: (f64, f64),
        index: (f64, f64),
        rho_d: Option<f64>,
        rig: RigGeometry,
        polarised: bool,
        /// Compare every n-th row.
        every: usize,
    }

    fn surface(sample: &Sample) -> RidgedSurface {
        let cos_l = sample.rig.theta_l.rad().cos();
        RidgedSurface::new(
            Profile::sawtooth(sample.theta_r_deg.to_radians(), 100.0, 0.0).unwrap(),
            Roughness {
                alpha_u: sample.alpha.0,
                alpha_v: sample.alpha.1,
            },
            sample.index.into(),
            sample
                .rho_d
                .map(|rho| Diffuse::new(rho, sample.index.0, 1.0, cos_l)),
        )
    }

    /// Deviations from the series' noise-free radiances, in units of both standard errors combined
    /// with 3e-4 of the peak (the series' finite number of phases).
    fn deviations(sample: &Sample) -> Vec<f64> {
        let path = format!("tests/data/series/{}/radiance.csv", sample.series);
        let mut reader = csv::Reader::from_path(path).unwrap();
        let rows: Vec<[f64; 4]> = reader
            .records()
            .map(|r| {
                let r = r.unwrap();
                [0, 1, 3, 4].map(|i| r[i].parse().unwrap())
            })
            .collect();
        let peak = rows.iter().map(|r| r[2]).fold(0.0, f64::max);
        let surface = surface(sample);
        rows.iter()
            .step_by(sample.every)
            .enumerate()
            .map(|(n, row)| {
                let options = RadianceOptions {
                    paths: 10_000,
                    seed: n as u64,
                    cones: sample.rig.cones,
                    polarised: sample.polarised,
                };
                let directions = sample.rig.directions(Pose::from_deg(row[0], row[1]));
                let found = surface.radiance(&directions, &options);
                let sigma = found.std.hypot(row[3]).hypot(3e-4 * peak);
                (found.value - row[2]) / sigma
            })
            .collect()
    }

    fn check(sample: &Sample) {
        let z = deviations(sample);
        let worst = z.iter().fold(0.0f64, |w, z| w.max(z.abs()));
        assert!(z.len() > 8 && worst < 4.5, "{}: {worst}", sample.series);
    }

    #[test]
    fn plastic_ridges_agree_with_an_independent_path_tracer() {
        check(&Sample {
            series: "polymer-10",
            theta_r_deg: 10.0,
            alpha: (0.12, 0.12),
            index: (1.54, 0.0),
            rho_d: Some(0.33725),
            rig: RigGeometry::IN_PLANE,
            polarised: false,
            every: 9,
        });
        check(&Sample {
            series: "paper-rig-full",
            theta_r_deg: 5.0,
            alpha: (0.05, 0.05),
            index: (1.54, 0.0),
            rho_d: Some(0.34395),
            rig: RigGeometry::BESIDE,
            polarised: false,
            every: 11,
        });
    }

    #[test]
    fn steel_ridges_agree_too_but_not_without_polarisation() {
        check(&Sample {
            series: "steel-15",
            theta_r_deg: 15.0,
            alpha: (0.06, 0.18),
            index: (2.9, 3.1),
            rho_d: None,
            rig: RigGeometry::IN_PLANE,
            polarised: true,
            every: 9,
        });
    }

    #[test]
    fn translucent_bodies_tails_and_crests_agree_with_the_closed_form() {
        use crate::model::extended::{Real, Terms, Walls, partials};
        use crate::model::prepared::OpticsTable;
        use crate::model::{Optics, Surface};
        let rig = RigGeometry {
            cones: Cones::of_lamp(crate::units::Angle::from_deg(1.0)),
            ..RigGeometry::IN_PLANE
        };
        let optics = Optics {
            eta: 1.54,
            k: 0.0,
            theta_l: rig.theta_l.rad(),
            cones: rig.cones,
        };
        let ideal = Real::NONE;
        let cases = [
            (
                12.0,
                0.15,
                0.66,
                Real {
                    translucency: 1.0,
                    ..ideal
                },
            ),
            (
                12.0,
                0.15,
                0.66,
                Real {
                    translucency: 0.4,
                    ..ideal
                },
            ),
            (13.0, 0.09, 0.27, Real { tail: 1.0, ..ideal }),
            (13.0, 0.09, 0.27, Real { tail: 0.5, ..ideal }),
            (
                14.0,
                0.09,
                0.29,
                Real {
                    crest: 0.05,
                    ..ideal
                },
            ),
        ];
        for (theta_r_deg, alpha, rho_d, real) in cases {
            let surface = Surface {
                theta_r: f64::to_radians(theta_r_deg),
                alpha_u: alpha,
                alpha_v: alpha,
                rho_d,
                amplitude: 1.0,
            };
            let walls = Walls::new(&surface, &real, &OpticsTable::new(&optics));
            let body = Diffuse::new(rho_d, 1.54, 1.0, optics.theta_l.cos());
            let traced = RidgedSurface::new(
                Profile::rounded(surface.theta_r, 1.0, [real.crest, 0.0]).unwrap(),
                Roughness {
                    alpha_u: alpha,
                    alpha_v: alpha,
                },
                [1.54, 0.0],
                Some(body.with_translucency(real.translucency)),
            )
            .with_tail(real.tail);
            let poses = [-18.0, -6.0, 6.0, 18.0]
                .into_iter()
                .flat_map(|tilt| [0.0, 60.0, 180.0].map(|turn| Pose::from_deg(tilt, turn)));
            let found: Vec<(f64, Estimate)> = poses
                .enumerate()
                .map(|(n, pose)| {
                    let directions = rig.directions(pose);
                    let terms = Terms::of(&real, &optics, false, false);
                    let closed = partials(&directions, &surface, &real, terms, &optics, &walls);
                    let options = RadianceOptions {
                        paths: 1 << 14,
                        seed: n as u64,
                        cones: rig.cones,
                        polarised: false,
                    };
                    (closed.value, traced.radiance(&directions, &options))
                })
                .collect();
            let peak = found.iter().map(|(closed, _)| *closed).fold(0.0, f64::max);
            for (closed, traced) in found {
                // In addition to the noise, the terms that the closed form omits: double
                // reflections and the second order of a crest.
                let allowed = 4.0 * traced.std + 0.006 * peak;
                assert!(
                    (closed - traced.value).abs() < allowed,
                    "{real:?}: {closed} {traced:?} {peak}"
                );
            }
        }
    }
}
