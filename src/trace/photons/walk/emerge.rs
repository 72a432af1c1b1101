//! Light that entered a diffuse body and leaves it again.
//!
//! *Conditioning.* Probabilities at slopes are Fresnel's fractions, between 0 and 1 except under
//! total reflection, where the ray is certainly reflected; there is no division by a probability
//! that was not drawn.

use super::{Event, Method, State, Walk};
use crate::model::polarisation::Boundary;
use crate::trace::counting::tally::TallyBatch;
use crate::trace::facets::scattering::{DiffuseBody, Roughness};
use crate::trace::photons::interface::Interface;
use crate::trace::photons::light::PhotonState;
use crate::trace::rng::RandomStream;
use crate::trace::surfaces::height_field::Side;
use crate::trace::vec3::{V3, combine, dot, unit};

impl Walk<'_> {
    /// Light that entered a diffuse body leaves through the same facet, or is absorbed.
    ///
    /// It leaves along the path by which light from that direction would enter, so that lamp and
    /// camera are interchangeable: straight through a smooth boundary, and through a rough one by a
    /// walk on its slopes that is drawn backwards.
    pub(super) fn re_emerge<L: PhotonState>(
        &self,
        state: &mut State<L>,
        interface: &Interface,
        strength: f64,
        random: &mut RandomStream,
        batch: &mut TallyBatch,
    ) -> Event {
        let [u, v, n] = interface.relief.frame(&state.place);
        let world = |w: &V3| combine(1.0, &combine(w[0], &u, w[1], &v), w[2], &n);
        let out = DiffuseBody::direction(random);
        let before = state.light.power(&self.stokes);
        let mut chance = 1.0;
        let way_in = match &interface.roughness {
            None => Some(WayIn::straight(&out)),
            Some(roughness) => WayIn::drawn(roughness, &out, &interface.from_above, random),
        };
        let Some(way_in) = way_in else {
            batch.absorb(before);
            return Event::Ends;
        };
        if self.method == Method::Analog {
            chance = match interface.roughness {
                Some(_) => strength,
                None => {
                    strength
                        * interface
                            .from_above
                            .at(out[2].max(1e-12))
                            .refracted
                            .unpolarised()
                }
            }
            .min(1.0);
            if random.uniform() >= chance {
                batch.absorb(before);
                return Event::Ends;
            }
        }
        state.side = Side::Above;
        for (nth, hit) in way_in.hits().iter().rev().enumerate() {
            // Forwards, the light comes along the direction to which the hit turned the backward
            // ray.
            let m = world(&hit.normal);
            let passed = interface.from_above.at(hit.cos);
            if nth == 0 {
                let leaves = world(&hit.k.map(|x| -x));
                // Any frame is valid for unpolarised light; `meet` sets that of the hit.
                let horizontal = unit(&combine(1.0, &u, -dot(&u, &leaves), &leaves));
                state.light.depolarise(&horizontal);
                state.light.meet(&leaves, &m);
                state
                    .light
                    .pass(&passed.refracted, strength / (chance * hit.chance));
            } else {
                let comes = combine(1.0, &hit.k, 2.0 * hit.cos, &hit.normal).map(|x| -x);
                state.light.meet(&world(&comes), &m);
                state.light.pass(&passed.reflected, 1.0 / hit.chance);
            }
        }
        state.k = world(&out);
        let after = state.light.power(&self.stokes);
        batch.absorb(before - after);
        if self.method == Method::Analog || self.roulette(&mut state.light, random) {
            Event::Goes
        } else {
            Event::Ends
        }
    }
}

/// The path of a ray into a facet through its slopes: reflected by some, refracted at the last.
struct WayIn {
    hits: [Meeting; MEETINGS],
    count: usize,
}

/// A slope that a ray meets on its way in; directions in the facet's frame.
#[derive(Clone, Copy)]
struct Meeting {
    /// Direction of the ray before it.
    k: V3,
    normal: V3,
    cos: f64,
    /// Probability with which its branch was drawn.
    chance: f64,
}

/// Largest number of slopes on a way in; only 1e-8 of the light is reflected by more.
const MEETINGS: usize = 8;

impl WayIn {
    const NONE: Self = WayIn {
        hits: [Meeting {
            k: [0.0; 3],
            normal: [0.0; 3],
            cos: 1.0,
            chance: 1.0,
        }; MEETINGS],
        count: 0,
    };

    /// The path of a ray from the direction `out` through a smooth facet.
    fn straight(out: &V3) -> Self {
        let mut way = Self::NONE;
        way.push(out.map(|x| -x), [0.0, 0.0, 1.0], 1.0);
        way
    }

    /// A random path of a ray from the direction `out` through a rough facet; `None` if it does not
    /// get in.
    fn drawn(
        roughness: &Roughness,
        out: &V3,
        boundary: &Boundary,
        random: &mut RandomStream,
    ) -> Option<Self> {
        let mut way = Self::NONE;
        let (mut k, mut height) = (out.map(|x| -x), 1.0);
        while way.count < MEETINGS {
            height = roughness.next_height(&k, height, random)?;
            if height.is_nan() || height <= 0.0 {
                return None;
            }
            let normal = roughness.visible_normal(&k, random);
            let cos = (-dot(&k, &normal)).max(1e-12);
            let share = boundary.at(cos).reflected.unpolarised();
            if random.uniform() >= share {
                way.push(k, normal, 1.0 - share);
                return Some(way);
            }
            way.push(k, normal, share);
            k = combine(1.0, &k, 2.0 * cos, &normal);
        }
        None
    }

    fn push(&mut self, k: V3, normal: V3, chance: f64) {
        let cos = (-dot(&k, &normal)).max(1e-12);
        self.hits[self.count] = Meeting {
            k,
            normal,
            cos,
            chance,
        };
        self.count += 1;
    }

    fn hits(&self) -> &[Meeting] {
        &self.hits[..self.count]
    }
}

#[cfg(test)]
mod tests {
    use crate::trace::counting::grid::DirectionGrid;
    use crate::trace::run::{Shard, trace};
    use crate::trace::scene::Scene;
    use crate::trace::surfaces::height_field::Side;

    /// Light from 12.5° seen at 77.5° and vice versa, in the plane of incidence: the Mueller
    /// elements m00 and m10 of one and m00 and m01 of the other.
    fn both_ways(facet: &str) -> [[(f64, f64); 2]; 2] {
        let of = |theta_i: f64, theta_o: f64, element: usize| {
            let text = format!(
                "[light]\ntheta_i_deg = {theta_i}\n[[interface]]\n{facet}\n[run]\nphotons = 1000000\n\
                 theta_bins = 18\nphi_bins = 36\n"
            );
            let scene = Scene::parse(&text).unwrap();
            let ready = scene.prepare(&|_| Err(String::new())).unwrap();
            let grid = DirectionGrid::polar(18, 36);
            let totals = trace(&ready, Shard::WHOLE, &|_| true);
            let (sin, cos) = f64::to_radians(theta_o).sin_cos();
            // All azimuths are equivalent: the sum over them has the least noise.
            let mut sums = [(0.0, 0.0); 2];
            for bin in 0..36 {
                let phi = f64::to_radians(5.0 + 10.0 * f64::from(bin));
                let at = grid.bin(Side::Above, &[sin * phi.cos(), sin * phi.sin(), cos]);
                for (sum, i) in sums.iter_mut().zip([0, element]) {
                    let e = totals.element(Side::Above, at, i);
                    sum.0 += e.value / 36.0;
                    sum.1 += (e.std / 36.0).powi(2);
                }
            }
            sums.map(|(value, variance)| (value, variance.sqrt()))
        };
        [of(12.5, 77.5, 4), of(77.5, 12.5, 1)]
    }

    #[test]
    fn lamp_and_camera_are_interchangeable_over_rough_diffuse_facets() {
        // The lobe of the rough boundary is reciprocal by itself; the light from the body must be
        // reciprocal too.
        let facet =
            "shape = \"smith\"\nalpha_u = 0.4\nalpha_v = 0.4\nbelow = { n = 1.5, rho_d = 0.6 }";
        let [there, back] = both_ways(facet);
        for (a, b) in there.iter().zip(&back) {
            let sigma = a.1.hypot(b.1);
            assert!((a.0 - b.0).abs() < 4.0 * sigma, "{there:?} {back:?}");
            assert!(sigma < 2e-3, "{sigma}");
        }
    }
}
