//! Laws that every form must obey, tested over one list of forms. The terms of real samples are not in it: the tests of
//! [`super::extended`] draw them.

use nalgebra::Vector3;

use super::fresnel::{reflectance, transmittance};
use super::prepared::{OpticsTable, Prepared};
use super::quadrature::Quadrature;
use super::{Optics, Surface, Variant, radiance};
use crate::geometry::{Cones, Directions, Pose, RigGeometry};
use crate::units::Angle;

/// A function from directions to a radiance. A new form is one line here, and all laws are tested on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Closed(Variant),
    Prepared(Variant),
    Quadrature,
}

const FORMS: [Form; 5] = [
    Form::Closed(Variant::Paper),
    Form::Closed(Variant::Sawtooth),
    Form::Prepared(Variant::Paper),
    Form::Prepared(Variant::Sawtooth),
    Form::Quadrature,
];

impl Form {
    /// Returns radiances and the error that each may have.
    fn many(self, directions: &[Directions], s: &Surface, optics: &Optics) -> Vec<(f64, f64)> {
        match self {
            Form::Closed(v) => directions
                .iter()
                .map(|d| (radiance(v, d, s, optics), 0.0))
                .collect(),
            Form::Prepared(v) => {
                let p = Prepared::new(v, s, &OpticsTable::new(optics));
                directions
                    .iter()
                    .map(|d| (p.partials(d).value, 0.0))
                    .collect()
            }
            Form::Quadrature => Quadrature::new(s, &OpticsTable::new(optics))
                .radiances(directions, 1e-4)
                .iter()
                .map(|e| (e.value, e.error))
                .collect(),
        }
    }

    fn one(self, d: &Directions, s: &Surface, optics: &Optics) -> (f64, f64) {
        self.many(std::slice::from_ref(d), s, optics)[0]
    }
}

fn direction(theta: f64, phi: f64) -> Vector3<f64> {
    let (s, c) = theta.sin_cos();
    Vector3::new(s * phi.cos(), s * phi.sin(), c)
}

fn optics(eta: f64, k: f64) -> Optics {
    Optics {
        eta,
        k,
        theta_l: 10f64.to_radians(),
        cones: Cones::NONE,
    }
}

fn surface(theta_r_deg: f64, alpha_u: f64, alpha_v: f64, rho_d: f64) -> Surface {
    Surface {
        theta_r: theta_r_deg.to_radians(),
        alpha_u,
        alpha_v,
        rho_d,
        amplitude: 1.0,
    }
}

/// Returns directions spread over the hemisphere by irrational steps.
fn spread(n: u32) -> Vec<Directions> {
    (0..n)
        .map(|j| {
            let t = f64::from(j);
            let part = |step: f64| (t * step).fract();
            Directions {
                incident: direction(
                    1.4 * part(0.618_034),
                    std::f64::consts::TAU * part(0.754_878),
                ),
                outgoing: direction(
                    1.4 * part(0.569_840),
                    std::f64::consts::TAU * part(0.438_579),
                ),
            }
        })
        .collect()
}

#[test]
fn lamp_and_camera_can_be_exchanged() {
    for form in FORMS {
        for (s, o) in [
            (surface(12.0, 0.1, 0.25, 0.4), optics(1.54, 0.0)),
            (surface(25.0, 0.3, 0.15, 0.0), optics(2.9, 3.1)),
        ] {
            for d in spread(60) {
                let back = Directions {
                    incident: d.outgoing,
                    outgoing: d.incident,
                };
                let (a, da) = form.one(&d, &s, &o);
                let (b, db) = form.one(&back, &s, &o);
                // L = f cos θi for irradiance 1 on a surface facing the lamp.
                let (f, g) = (a / d.incident.z, b / back.incident.z);
                let allowed =
                    1e-12 * (1.0 + f) + 2.0 * da / d.incident.z + 2.0 * db / back.incident.z;
                assert!((f - g).abs() <= allowed, "{form:?} {d:?}: {f} {g}");
            }
        }
    }
}

#[test]
fn a_ridge_that_leans_the_other_way_equals_the_ridge_turned_by_180_degrees() {
    let rig = RigGeometry {
        light_azimuth: Angle::from_deg(35.0),
        ..RigGeometry::IN_PLANE
    };
    for form in FORMS {
        for (s, o) in [
            (surface(12.0, 0.1, 0.25, 0.4), optics(1.54, 0.0)),
            (surface(20.0, 0.3, 0.15, 0.0), optics(2.9, 3.1)),
        ] {
            let mirrored = Surface {
                theta_r: -s.theta_r,
                ..s
            };
            for phi in [0.0, 40.0, 133.0, 251.0] {
                let a = form.one(&rig.directions(Pose::from_deg(14.0, phi)), &s, &o);
                let b = form.one(
                    &rig.directions(Pose::from_deg(14.0, phi + 180.0)),
                    &mirrored,
                    &o,
                );
                assert!(
                    (a.0 - b.0).abs() <= 1e-12 + a.1 + b.1,
                    "{form:?} {a:?} {b:?}"
                );
            }
        }
    }
}

/// Returns the albedo for light from `incident`: ∫ L cos θo dω over the hemisphere, / cos θi.
fn albedo(form: Form, s: &Surface, o: &Optics, incident: Vector3<f64>, n: u32) -> f64 {
    // Midpoints in sin²θ and φ: equal shares of the projected hemisphere, π/(n · 2n) each.
    let directions: Vec<Directions> = (0..n)
        .flat_map(|j| {
            (0..2 * n).map(move |k| {
                let sin2 = (f64::from(j) + 0.5) / f64::from(n);
                let phi = std::f64::consts::PI * (f64::from(k) + 0.5) / f64::from(n);
                Directions {
                    incident,
                    outgoing: direction(sin2.sqrt().asin(), phi),
                }
            })
        })
        .collect();
    let share = std::f64::consts::PI / f64::from(n * 2 * n);
    form.many(&directions, s, o)
        .iter()
        .map(|(value, _)| value * share)
        .sum::<f64>()
        / incident.z
}

/// Error of the grid for lobes of the forms' domain (ridges to 20°, α to 0.3).
const GRID_ERROR: f64 = 0.002;

#[test]
fn no_form_emits_more_than_it_receives() {
    for form in FORMS {
        let n = if form == Form::Quadrature { 10 } else { 40 };
        for theta_r_deg in [3.0, 20.0] {
            for (s, o) in [
                (surface(theta_r_deg, 0.25, 0.2, 0.0), optics(1.0, 1e6)),
                (surface(theta_r_deg, 0.3, 0.3, 0.85), optics(1.5, 0.0)),
            ] {
                // The mirror has a sharper test of its own below.
                if form == Form::Quadrature && o.k > 0.0 {
                    continue;
                }
                for incident in [direction(0.1, 0.3), direction(0.6, 1.2)] {
                    let albedo = albedo(form, &s, &o, incident, n);
                    assert!(
                        albedo > 0.0 && albedo <= 1.0 + GRID_ERROR,
                        "{form:?} {s:?} {o:?} {incident:?}: {albedo}"
                    );
                }
            }
        }
    }
}

#[test]
fn the_quadrature_of_a_perfect_mirror_loses_only_light_reflected_four_times() {
    let mirror = optics(1.0, 1e6);
    for (theta_r_deg, least) in [(3.0, 0.99), (10.0, 0.985), (20.0, 0.96)] {
        let s = surface(theta_r_deg, 0.25, 0.2, 0.0);
        for incident in [direction(0.1, 0.3), direction(0.6, -1.5)] {
            let albedo = albedo(Form::Quadrature, &s, &mirror, incident, 12);
            assert!(
                albedo > least && albedo <= 1.0 + GRID_ERROR,
                "{theta_r_deg} {incident:?}: {albedo}"
            );
        }
    }
}

#[test]
fn without_ridges_the_forms_equal_a_rough_flat_surface() {
    let o = optics(1.54, 0.0);
    for form in FORMS {
        let s = surface(0.0, 0.2, 0.3, 0.4);
        for d in spread(200) {
            // The closed forms do not include masking of the roughness itself and grazing light.
            if d.incident.z < 0.6 || d.outgoing.z < 0.6 {
                continue;
            }
            let h = d.incident + d.outgoing;
            let (x, y) = (h.x / h.z, h.y / h.z);
            let density = (-(x / s.alpha_u).powi(2) - (y / s.alpha_v).powi(2)).exp()
                * (h.norm() / h.z).powi(4)
                / (std::f64::consts::PI * s.alpha_u * s.alpha_v);
            let cos = 0.5 * h.norm();
            let f = reflectance(cos, 1.54, 0.0);
            let printed = matches!(
                form,
                Form::Closed(Variant::Paper) | Form::Prepared(Variant::Paper)
            );
            let t = |c: f64| transmittance(c, 1.54, 0.0);
            let expected = if printed {
                density / (4.0 * d.outgoing.z)
                    * (f + s.rho_d / std::f64::consts::PI * (1.0 - f).powi(2))
            } else {
                density * f / (4.0 * d.outgoing.z)
                    + s.rho_d / (std::f64::consts::PI * t(1.0) * t(o.theta_l.cos()))
                        * t(d.incident.z)
                        * t(d.outgoing.z)
                        * d.incident.z
            };
            let (value, _) = form.one(&d, &s, &o);
            // Smith's masking, only in the quadrature, is below 2e-3 at these angles.
            let allowed = if form == Form::Quadrature {
                2e-3
            } else {
                1e-12
            };
            assert!(
                (value - expected).abs() <= allowed * (1.0 + expected),
                "{form:?} {d:?}: {value} {expected}"
            );
        }
    }
}

#[test]
fn a_mirror_facets_peak_grows_as_the_inverse_square_of_its_roughness() {
    let o = optics(2.9, 3.1);
    for form in FORMS {
        let theta_r = 0.2;
        // Lamp and camera are mirrored at m, in the plane across the ridges.
        let d = Directions {
            incident: Vector3::new(0.0, (theta_r + 0.15f64).sin(), (theta_r + 0.15f64).cos()),
            outgoing: Vector3::new(0.0, (theta_r - 0.15f64).sin(), (theta_r - 0.15f64).cos()),
        };
        let at = |alpha: f64| {
            let s = surface(theta_r.to_degrees(), alpha, alpha, 0.0);
            form.one(&d, &s, &o).0 * alpha * alpha
        };
        let (a, b) = (at(1e-2), at(1e-3));
        assert!((a / b - 1.0).abs() < 1e-9, "{form:?} {a} {b}");
    }
}

#[test]
fn an_index_of_one_has_no_specular_reflection() {
    for form in [
        Form::Closed(Variant::Sawtooth),
        Form::Prepared(Variant::Sawtooth),
        Form::Quadrature,
    ] {
        let o = optics(1.0, 0.0);
        let dark = surface(10.0, 0.1, 0.1, 0.0);
        let d = RigGeometry::IN_PLANE.directions(Pose::from_deg(5.0, 0.0));
        assert_eq!(form.one(&d, &dark, &o).0, 0.0);
        // A flat Lambertian surface under a matched boundary stays Lambertian.
        let s = surface(0.0, 0.1, 0.1, 0.5);
        let expected = 0.5 / std::f64::consts::PI * d.incident.z;
        assert!((form.one(&d, &s, &o).0 - expected).abs() < 1e-14);
    }
}

#[test]
fn directions_below_the_surface_have_no_radiance() {
    let s = surface(10.0, 0.2, 0.2, 0.4);
    let o = optics(1.5, 0.0);
    for form in FORMS {
        let (up, down) = (direction(0.3, 0.0), direction(2.0, 1.0));
        for (incident, outgoing) in [(up, down), (down, up)] {
            let d = Directions { incident, outgoing };
            assert_eq!(form.one(&d, &s, &o).0, 0.0);
        }
    }
}
