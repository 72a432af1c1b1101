//! The quadrature against the path tracer, and its own laws.

use super::*;
use crate::geometry::{Cones, Pose, RigGeometry};
use crate::model::{Variant, prepared::Prepared};
use crate::units::Angle;

struct Traced {
    directions: Vec<Directions>,
    radiance: Vec<f64>,
    surface: Surface,
    table: OpticsTable,
    peak: f64,
}

const PLASTIC: (f64, f64) = (1.54, 0.0);
const STEEL: (f64, f64) = (2.9, 3.1);

fn surface(theta_r_deg: f64, alpha_u: f64, alpha_v: f64, rho_d: f64) -> Surface {
    Surface {
        theta_r: theta_r_deg.to_radians(),
        alpha_u,
        alpha_v,
        rho_d,
        amplitude: 1.0,
    }
}

fn optics((eta, k): (f64, f64), lamp_deg: f64) -> Optics {
    Optics {
        eta,
        k,
        theta_l: 10f64.to_radians(),
        cones: Cones::of_lamp(Angle::from_deg(lamp_deg)),
    }
}

/// Reads the noise-free radiances of a path-traced series (see `tests/data/README.md`).
fn traced(text: &str, rig: &RigGeometry, surface: Surface, index: (f64, f64)) -> Traced {
    let mut directions = Vec::new();
    let mut radiance = Vec::new();
    for line in text.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let x = |j: usize| fields[j].parse::<f64>().unwrap();
        directions.push(rig.directions(Pose::from_deg(x(0), x(1))));
        radiance.push(x(3));
    }
    let peak = radiance.iter().copied().fold(0.0, f64::max);
    Traced {
        directions,
        radiance,
        surface,
        table: OpticsTable::new(&optics(index, 1.0)),
        peak,
    }
}

/// Returns the rms differences of quadrature and closed form from the tracer, as fractions of the peak.
fn residuals(t: &Traced) -> (f64, f64) {
    // The renderer of these series omits polarisation on plastic.
    let q = Quadrature::new(&t.surface, &t.table).with_polarisation(t.table.optics.k > 0.0);
    let p = Prepared::new(Variant::Sawtooth, &t.surface, &t.table);
    let n = t.radiance.len() as f64;
    let (mut ours, mut closed) = (0.0, 0.0);
    for (e, (d, y)) in q
        .radiances(&t.directions, 1e-4 * t.peak)
        .iter()
        .zip(t.directions.iter().zip(&t.radiance))
    {
        ours += (e.value - y).powi(2);
        closed += (p.partials(d).value - y).powi(2);
    }
    ((ours / n).sqrt() / t.peak, (closed / n).sqrt() / t.peak)
}

#[test]
fn path_traced_plastic_agrees_within_a_twentieth_of_a_percent_of_the_peak() {
    let t = traced(
        include_str!("../../../tests/data/series/polymer-10/radiance.csv"),
        &RigGeometry::IN_PLANE,
        surface(10.0, 0.12, 0.12, 0.33725),
        PLASTIC,
    );
    let (quadrature, closed) = residuals(&t);
    // The tracer's standard errors are 0.023 % of the peak (rms), and its 128 phases add up to 0.03 %. The remainder
    // is light after more than two bounces.
    assert!(quadrature < 0.000_5, "{quadrature}");
    assert!(closed > 2.0 * quadrature, "{closed} {quadrature}");
}

#[test]
fn path_traced_steel_agrees_within_a_fortieth_of_a_percent_of_the_peak() {
    let t = traced(
        include_str!("../../../tests/data/series/steel-15/radiance.csv"),
        &RigGeometry::IN_PLANE,
        surface(15.0, 0.06, 0.18, 0.0),
        STEEL,
    );
    let (quadrature, closed) = residuals(&t);
    // The tracer's standard errors are 0.0104 % (rms).
    assert!(
        quadrature < 0.000_25 && closed > 5.0 * quadrature,
        "{closed} {quadrature}"
    );
}

#[test]
fn the_papers_rig_agrees_within_a_hundredth_of_a_percent_of_the_peak() {
    let t = traced(
        include_str!("../../../tests/data/series/paper-rig-full/radiance.csv"),
        &RigGeometry::BESIDE,
        surface(5.0, 0.05, 0.05, 0.34395),
        PLASTIC,
    );
    // Tracer noise 0.0068 % (rms).
    assert!(residuals(&t).0 < 0.000_1);
}

#[test]
fn lamp_and_camera_can_be_exchanged() {
    for (s, index) in [
        (surface(14.0, 0.08, 0.15, 0.4), PLASTIC),
        (surface(20.0, 0.1, 0.2, 0.0), STEEL),
    ] {
        let q = Quadrature::new(&s, &OpticsTable::new(&optics(index, 0.0)));
        for (tilt, azimuth) in [(-20.0, 0.0), (5.0, 40.0), (25.0, 170.0), (40.0, 300.0)] {
            let there = RigGeometry::IN_PLANE.directions(Pose::from_deg(tilt, azimuth));
            let back = Directions {
                incident: there.outgoing,
                outgoing: there.incident,
            };
            let a = q.radiance(&there, 1e-6);
            let b = q.radiance(&back, 1e-6);
            let (f, g) = (a.value / there.incident.z, b.value / back.incident.z);
            let allowed = 2.0 * (a.error + b.error) + 1e-12;
            assert!((f - g).abs() <= allowed, "{f} {g} {allowed:e}");
        }
    }
}

#[test]
fn the_error_estimate_covers_the_error() {
    let s = surface(12.0, 0.07, 0.11, 0.3);
    for index in [PLASTIC, STEEL] {
        let q = Quadrature::new(&s, &OpticsTable::new(&optics(index, 1.0)));
        for (tilt, azimuth) in [(-20.0, 0.0), (0.0, 90.0), (20.0, 180.0)] {
            let d = RigGeometry::IN_PLANE.directions(Pose::from_deg(tilt, azimuth));
            let fine = q.radiance(&d, 1e-8);
            for tolerance in [1e-3, 1e-4, 1e-5] {
                let rough = q.radiance(&d, tolerance);
                assert!(rough.error <= tolerance);
                assert!((rough.value - fine.value).abs() <= rough.error + fine.error);
            }
        }
    }
}

#[test]
fn narrow_retro_lobes_converge_to_the_closed_form() {
    // With the lamp beside the camera and metal, two mirror bounces are all the light at these poses.
    let rig = RigGeometry {
        theta_l: Angle::from_deg(1.0),
        ..RigGeometry::IN_PLANE
    };
    let relative: Vec<f64> = [0.2, 0.1, 0.05]
        .iter()
        .map(|&alpha| {
            let s = surface(20.0, alpha, alpha, 0.0);
            let table = OpticsTable::new(&optics(STEEL, 0.0));
            let q = Quadrature::new(&s, &table);
            let p = Prepared::new(Variant::Sawtooth, &s, &table);
            let (mut off, mut all) = (0.0, 0.0);
            for tilt in [-30.0, -35.0, -40.0] {
                let d = rig.directions(Pose::from_deg(tilt, 0.0));
                let closed = p.partials(&d).value;
                off += (q.radiance(&d, 1e-5).value - closed).abs();
                all += closed;
            }
            off / all
        })
        .collect();
    assert!(
        relative[1] < 0.6 * relative[0] && relative[2] < 0.6 * relative[1],
        "{relative:?}"
    );
}
