//! Averages over the cones of lamp and lens, for lobes too narrow to be widened instead.
//!
//! Call [`nodes`]. A lobe depends only on its half vector, which moves by half of what lamp and lens move. To first
//! order in the angles, a displacement a of the lamp and b of the lens is equivalent to one of a + b of the lamp. So
//! both averages are one average over a disc of radius Rl + Rc, weighted by the density of a + b. That density is
//! proportional to the overlap of two discs; for a single cone it is uniform.
//!
//! *Conditioning.* Weights are positive and sum to 1, so an average is as exact as its terms.

use std::f64::consts::PI;

use nalgebra::Vector3;

use super::gauss::LEGENDRE_4;
use crate::geometry::{Cones, Directions};

/// A displacement of the lamp across its direction, rad, and its weight; the weights sum to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Along the first axis of [`across`].
    pub x: f64,
    /// Along the second axis.
    pub y: f64,
    /// Share of the light.
    pub weight: f64,
}

impl Node {
    /// The node with all of the light, for point-like lamp and lens.
    pub const CENTRE: Node = Node {
        x: 0.0,
        y: 0.0,
        weight: 1.0,
    };
}

/// Reach of the cones, in lobe widths, up to which seven nodes suffice.
const NARROW: f64 = 0.3;
/// Largest number of rings, in groups of four: enough for lobes of a twentieth of the cones' radius.
const PANELS_MAX: f64 = 20.0;

/// Returns a cubature over both cones for lobes of the roughness `alpha`: seven nodes, exact to degree 5, if the lobe
/// is broader than the cones; otherwise rings of Gauss nodes. Angles in rad.
#[must_use]
pub fn nodes(cones: &Cones, alpha: f64) -> Vec<Node> {
    let (lamp, lens) = (cones.lamp.rad().abs(), cones.lens.rad().abs());
    let (large, small) = (lamp.max(lens), lamp.min(lens));
    if large <= 0.0 {
        return vec![Node::CENTRE];
    }
    // The half vector moves by half the angle: reach of the cones in lobe widths.
    let breadth = (large + small) / (2.0 * alpha);
    if breadth <= NARROW {
        seven(large, small)
    } else {
        rings(large, small, breadth)
    }
}

/// Returns the centre and six nodes on a ring, with the second and the fourth moment of a + b.
fn seven(large: f64, small: f64) -> Vec<Node> {
    // In units of the larger radius, whose powers could underflow.
    let q = (small / large).powi(2);
    let second = 0.5 * (1.0 + q);
    let fourth = (1.0 + q * q) / 3.0 + q;
    let weight = second * second / fourth;
    let mut nodes = vec![Node {
        x: 0.0,
        y: 0.0,
        weight: 1.0 - weight,
    }];
    nodes.extend(ring(large * (fourth / second).sqrt(), 6, 0.0, weight));
    nodes
}

fn rings(large: f64, small: f64, breadth: f64) -> Vec<Node> {
    let count = breadth.ceil().clamp(1.0, PANELS_MAX);
    let spokes = 12 * count as u32 + 4;
    let (reach, even) = (large + small, large - small);
    let inner = (count * even / reach).ceil();
    // In the squared radius every ring of a uniformly filled disc has the same share.
    let mut circles = panels(inner, |t| (even * even * t, even * even));
    if small > 0.0 {
        // At the radius where the overlap begins to shrink and at the one where it ends, it varies with the power
        // 3/2; a variable that is quadratic there makes it smooth. Two panels give its fourth moment to 3e-4.
        let width = reach * reach - even * even;
        circles.extend(panels((count - inner).max(2.0), |t| {
            let square = even * even + width * t * t * (3.0 - 2.0 * t);
            (square, 6.0 * width * t * (1.0 - t))
        }));
    }
    for circle in &mut circles {
        circle.weight *= shared(circle.radius, large, small);
    }
    let total: f64 = circles.iter().map(|c| c.weight).sum();
    circles
        .iter()
        .flat_map(|c| ring(c.radius, spokes, c.turn, c.weight / total))
        .collect()
}

struct Circle {
    radius: f64,
    /// Offset of its first node, in steps between nodes.
    turn: f64,
    weight: f64,
}

/// Returns the Gauss nodes of `count` panels over 0 to 1, each at the squared radius that `square` returns with its
/// derivative.
fn panels(count: f64, square: impl Fn(f64) -> (f64, f64)) -> Vec<Circle> {
    (0..count as u32)
        .flat_map(|panel| LEGENDRE_4.map(|(x, w)| (panel, x, w)))
        .map(|(panel, x, w)| {
            let (square, derivative) = square((f64::from(panel) + 0.5 * (1.0 + x)) / count);
            Circle {
                radius: square.sqrt(),
                turn: if panel % 2 == 0 { 0.0 } else { 0.5 },
                weight: 0.5 * w / count * derivative,
            }
        })
        .collect()
}

fn ring(radius: f64, spokes: u32, turn: f64, weight: f64) -> impl Iterator<Item = Node> {
    (0..spokes).map(move |k| {
        let angle = 2.0 * PI * (f64::from(k) + turn) / f64::from(spokes);
        Node {
            x: radius * angle.cos(),
            y: radius * angle.sin(),
            weight: weight / f64::from(spokes),
        }
    })
}

/// Returns the overlap of two discs whose centres are `distance` apart, over the area of the smaller one.
fn shared(distance: f64, large: f64, small: f64) -> f64 {
    if distance <= large - small {
        return 1.0;
    }
    if distance >= large + small {
        return 0.0;
    }
    // Half the angle that the common chord subtends at each centre.
    let cos = |a: f64, b: f64| {
        ((distance * distance + a * a - b * b) / (2.0 * distance * a)).clamp(-1.0, 1.0)
    };
    let segment = |cos: f64| cos.acos() - cos * (1.0 - cos * cos).sqrt();
    let at_large = segment(cos(large, small)) * (large / small).powi(2);
    (at_large + segment(cos(small, large))) / PI
}

/// Returns two unit vectors perpendicular to the unit vector `w` and to each other.
#[must_use]
pub fn across(w: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let helper = if w.z.abs() < 0.9 {
        Vector3::z()
    } else {
        Vector3::x()
    };
    let x = w.cross(&helper).normalize();
    (x, w.cross(&x))
}

/// Returns the directions with the lamp moved by `node`.
#[must_use]
pub fn moved(directions: &Directions, node: &Node) -> Directions {
    let w = directions.incident;
    let (x, y) = across(&w);
    Directions {
        incident: (w + x * node.x + y * node.y).normalize(),
        ..*directions
    }
}

/// Returns the largest difference of a widened lobe (α² + (Rl² + Rc²)/8) from the average over the cones, over the
/// peak of the latter, and that of the lobe for point-like lamp and lens. For lobes of the roughness `alpha` along
/// both axes.
#[must_use]
pub fn costs(cones: &Cones, alpha: f64) -> Costs {
    if cones.reach() <= 0.0 {
        return Costs {
            widened: 0.0,
            point: 0.0,
        };
    }
    // Lobes narrower than the nodes' spacing would fall between them; the error of a widened lobe has reached the whole
    // peak before that.
    let alpha = alpha.max(cones.reach() / (2.0 * PANELS_MAX));
    let nodes = nodes(cones, alpha);
    let average = |at: f64| -> f64 {
        let lobe = |n: &Node| {
            let (x, y) = ((at + 0.5 * n.x) / alpha, 0.5 * n.y / alpha);
            n.weight * (-(x * x + y * y)).exp()
        };
        nodes.iter().map(lobe).sum()
    };
    let wide = alpha * alpha + cones.widening();
    let top = average(0.0);
    let mut costs = Costs {
        widened: 0.0,
        point: 0.0,
    };
    // From the peak to where both the lobe and the cones have ended.
    let end = 0.5 * cones.reach() + 3.0 * alpha;
    for step in 0..=STEPS {
        let at = end * f64::from(step) / f64::from(STEPS);
        let mean = average(at);
        let widened = alpha * alpha / wide * (-at * at / wide).exp();
        let point = (-at * at / (alpha * alpha)).exp();
        costs.widened = costs.widened.max((widened - mean).abs() / top);
        costs.point = costs.point.max((point - mean).abs() / top);
    }
    costs
}

/// Number of steps at which [`costs`] compares.
const STEPS: u32 = 24;

/// Errors of forms simpler than the average over the cones, as shares of a lobe's peak.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Costs {
    /// Widened lobes.
    pub widened: f64,
    /// Lamp and lens as points.
    pub point: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, RigGeometry};
    use crate::model::{Optics, Surface, Variant, radiance};
    use crate::units::Angle;

    fn cones(lamp: f64, lens: f64) -> Cones {
        Cones {
            lamp: Angle::from_rad(lamp),
            lens: Angle::from_rad(lens),
        }
    }

    /// Returns the mean of f(a + b) over two discs by a product rule of equal areas, independent of [`nodes`].
    fn brute(lamp: f64, lens: f64, f: &dyn Fn(f64, f64) -> f64) -> f64 {
        const RINGS: u32 = 24;
        let disc = |radius: f64| -> Vec<(f64, f64)> {
            (0..RINGS)
                .flat_map(|i| {
                    let r = radius * ((f64::from(i) + 0.5) / f64::from(RINGS)).sqrt();
                    (0..RINGS).map(move |k| {
                        let a = 2.0 * PI * (f64::from(k) + 0.37 * f64::from(i)) / f64::from(RINGS);
                        (r * a.cos(), r * a.sin())
                    })
                })
                .collect()
        };
        let (a, b) = (disc(lamp), disc(lens));
        let sum: f64 = a
            .iter()
            .flat_map(|p| b.iter().map(|q| f(p.0 + q.0, p.1 + q.1)))
            .sum();
        sum / (a.len() * b.len()) as f64
    }

    #[test]
    fn the_nodes_have_the_moments_of_two_discs() {
        for (lamp, lens) in [(0.02, 0.0), (0.02, 0.013), (0.01, 0.01), (0.001, 0.03)] {
            let c = cones(lamp, lens);
            for alpha in [1.0, 0.02, 0.004, 0.001] {
                let nodes = nodes(&c, alpha);
                let of = |f: &dyn Fn(&Node) -> f64| -> f64 {
                    nodes.iter().map(|n| n.weight * f(n)).sum()
                };
                assert!((of(&|_| 1.0) - 1.0).abs() < 1e-12);
                // The widening is half the variance of the half vector's slope along one axis, twice.
                let second = of(&|n| n.x * n.x);
                // The overlap of two discs is not a polynomial.
                let rounding = if lens > 0.0 && alpha < 1.0 {
                    3e-4
                } else {
                    1e-9
                };
                assert!(
                    (second / (2.0 * c.widening()) - 1.0).abs() < rounding,
                    "{lamp} {lens} {alpha}"
                );
                let (p, q) = (lamp * lamp, lens * lens);
                let fourth = of(&|n| (n.x * n.x + n.y * n.y).powi(2));
                let expected = (p * p + q * q) / 3.0 + p * q;
                assert!(
                    (fourth / expected - 1.0).abs() < rounding,
                    "{lamp} {lens} {alpha}: {fourth} {expected}"
                );
            }
        }
    }

    #[test]
    fn averages_of_narrow_lobes_agree_with_brute_force() {
        for (lamp, lens, alpha) in [
            (0.02, 0.012, 0.008),
            (0.01, 0.01, 0.005),
            (0.02, 0.0, 0.006),
        ] {
            for at in [0.0, 0.004, 0.009, 0.014] {
                let lobe = |x: f64, y: f64| {
                    let (x, y) = ((at + 0.5 * x) / alpha, 0.5 * y / alpha);
                    (-(x * x + y * y)).exp()
                };
                let expected = brute(lamp, lens, &lobe);
                let found: f64 = nodes(&cones(lamp, lens), alpha)
                    .iter()
                    .map(|n| n.weight * lobe(n.x, n.y))
                    .sum();
                // The brute force has 24 rings, with an error of some 1/24² of a ring's change.
                assert!(
                    (found - expected).abs() < 2e-3,
                    "{lamp} {lens} {alpha} {at}: {found} {expected}"
                );
            }
        }
    }

    /// Returns points of a disc of directions, without the assumption that displacements add.
    fn discs(w: Vector3<f64>, radius: f64) -> Vec<Vector3<f64>> {
        let (x, y) = across(&w);
        (0..8)
            .flat_map(|i| {
                let r = radius.tan() * ((f64::from(i) + 0.5) / 8.0).sqrt();
                (0..9).map(move |k| {
                    let a = 2.0 * PI * (f64::from(k) + 0.41 * f64::from(i)) / 9.0;
                    (w + x * (r * a.cos()) + y * (r * a.sin())).normalize()
                })
            })
            .collect()
    }

    #[test]
    fn moving_only_the_lamp_is_equivalent_to_moving_lamp_and_lens() {
        let both = cones(1.2f64.to_radians(), 2f64.to_radians());
        let rig = RigGeometry {
            theta_l: Angle::from_deg(30.0),
            light_azimuth: Angle::from_deg(40.0),
            azimuth_zero: Angle::ZERO,
            cones: both,
        };
        let optics = |cones| Optics {
            eta: 1.54,
            k: 0.0,
            theta_l: rig.theta_l.rad(),
            cones,
        };
        for (alpha, limit) in [(0.1, 1e-3), (0.015, 6e-3)] {
            let surface = Surface {
                theta_r: 0.2,
                alpha_u: alpha,
                alpha_v: alpha,
                rho_d: 0.3,
                amplitude: 1.0,
            };
            let points = optics(Cones::NONE);
            let at = |d: &Directions| radiance(Variant::Sawtooth, d, &surface, &points);
            let (mut peak, mut off, mut closed_off) = (0.0f64, 0.0f64, 0.0f64);
            for (theta_c_deg, phi_s_deg) in [
                (-30.0, 0.0),
                (-5.0, 10.0),
                (0.0, -15.0),
                (2.0, -20.0),
                (12.0, 140.0),
            ] {
                let d = rig.directions(Pose::from_deg(theta_c_deg, phi_s_deg));
                let lamps = discs(d.incident, both.lamp.rad());
                let pupils = discs(d.outgoing, both.lens.rad());
                let sum: f64 = lamps
                    .iter()
                    .flat_map(|i| pupils.iter().map(|o| (*i, *o)))
                    .map(|(incident, outgoing)| at(&Directions { incident, outgoing }))
                    .sum();
                let expected = sum / (lamps.len() * pupils.len()) as f64;
                let found: f64 = nodes(&both, alpha)
                    .iter()
                    .map(|n| n.weight * at(&moved(&d, n)))
                    .sum();
                let closed = radiance(Variant::Sawtooth, &d, &surface, &optics(both));
                peak = peak.max(expected);
                off = off.max((found - expected).abs());
                closed_off = closed_off.max((closed - expected).abs());
            }
            assert!(off < limit * peak, "{alpha}: {}", off / peak);
            let stated = costs(&both, alpha).widened;
            assert!(
                closed_off < 1.5 * stated * peak + limit * peak,
                "{alpha}: {} stated {stated}",
                closed_off / peak
            );
        }
    }

    #[test]
    fn widened_lobes_are_exact_if_broad_and_wrong_if_narrow() {
        let led = cones(1f64.to_radians(), 0.0);
        let broad = costs(&led, 0.06);
        assert!(broad.widened < 2e-4 && broad.point > 5e-3, "{broad:?}");
        let narrow = costs(&led, 0.001);
        assert!(narrow.widened > 0.2, "{narrow:?}");
        let none = costs(&Cones::NONE, 0.06);
        assert_eq!((none.widened, none.point), (0.0, 0.0));
    }
}
