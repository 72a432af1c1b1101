//! A near camera and a near lamp: frames rendered pixel by pixel with independent geometry, then reduced and fitted.

use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use ridged::cases::MemorySeries;
use ridged::fit::{FitOptions, FitReport, VariantChoice, fit};
use ridged::frame::{Frame, FrameKind};
use ridged::geometry::Directions;
use ridged::model::prepared::{OpticsTable, Prepared};
use ridged::model::{Optics, Surface, Variant};
use ridged::observation::ObservationSet;
use ridged::reduction::reduce;
use ridged::series::Manifest;

const EDGE: usize = 32;
const FIELD_MM: f64 = 44.0;
const CAMERA_MM: f64 = 400.0;
const LIGHT_MM: f64 = 350.0;
const AZIMUTH_OFFSET_DEG: f64 = 4.0;
const TILT_OFFSET_DEG: f64 = 0.3;

const MANIFEST: &str = r#"
schema = "gonio-series-1"
name = "near"
[rig]
theta_l_deg = 10.0
light_azimuth_deg = 90.0
azimuth_zero_deg = 90.0
light_distance = "finite"
camera_distance = "finite"
light_distance_mm = 350.0
light_radius_mm = 0.0
camera_distance_mm = 400.0
rotation_axis_px = [16.0, 16.0]
[camera]
projection = "perspective"
width_px = 32
height_px = 32
field_width_mm = 44.0
field_height_mm = 44.0
bit_depth = 16
saturation_dn = 65535
gain_dn_per_electron = 2.0
black_level_dn = 200.0
read_noise_electrons_rms = 2.0
[flat]
reflectance = 0.99
reflectance_std = 0.005
[sample]
kind = "dielectric"
index_of_refraction = 1.54
index_of_refraction_std = 0.005
"#;

/// Returns the directions to lamp and camera at the point of the sample that a pixel images, and the irradiance there.
fn seen(pixel: usize, tilt_deg: f64) -> (Vector3<f64>, Vector3<f64>, f64) {
    let t = tilt_deg.to_radians();
    let view = Vector3::new(t.sin(), 0.0, t.cos());
    let columns = Vector3::new(t.cos(), 0.0, -t.sin());
    let rows = Vector3::new(0.0, -1.0, 0.0);
    let place = |i: usize| ((i as f64 + 0.5) / EDGE as f64 - 0.5) * FIELD_MM;
    let on_plane = columns * place(pixel % EDGE) + rows * place(pixel / EDGE);
    let pupil = view * CAMERA_MM;
    let ray = on_plane - pupil;
    let point = pupil - ray * (pupil.z / ray.z);
    // The lamp is beside the tilt plane.
    let lamp = (view * 10f64.to_radians().cos()
        + Vector3::new(0.0, 1.0, 0.0) * 10f64.to_radians().sin())
        * LIGHT_MM;
    let to_lamp = lamp - point;
    let irradiance = (LIGHT_MM / to_lamp.norm()).powi(2);
    (to_lamp.normalize(), (pupil - point).normalize(), irradiance)
}

fn painted(surface: &Surface, stray: f64) -> MemorySeries {
    // A lobe's peak is inversely proportional to its widths along both axes; this exposure avoids saturation.
    let exposure_s = 0.025 * surface.alpha_u * surface.alpha_v / 0.0064;
    let manifest = Manifest::from_toml(MANIFEST, "manifest.toml").unwrap();
    let optics = Optics::new(&manifest.rig_geometry(), &manifest.material());
    let sample = Prepared::new(Variant::Sawtooth, surface, &OpticsTable::new(&optics));
    let mut rng = Pcg64::seed_from_u64(11);
    let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
    let response: Vec<f64> = (0..EDGE * EDGE)
        .map(|p| {
            let at = |i: usize| (i as f64 + 0.5) / EDGE as f64 * 2.0 - 1.0;
            let r2 = at(p % EDGE).powi(2) + at(p / EDGE).powi(2);
            (1.0 - 0.06 * r2) * (1.0 + 0.01 * noise())
        })
        .collect();
    let mut poses = vec![(FrameKind::Dark, 0.0, 0.0); 3];
    let tilts = [-20.0, -10.0, -5.0, 0.0, 5.0, 10.0, 20.0];
    poses.extend(tilts.map(|t| (FrameKind::Flat, t, 0.0)));
    for tilt in tilts {
        poses.extend((0..8).map(|i| (FrameKind::Sample, tilt, 45.0 * f64::from(i))));
    }
    let mut series = MemorySeries::new(manifest);
    for (kind, tilt, azimuth) in poses {
        // v is at the recorded azimuth + zero + offset.
        let v_deg: f64 = azimuth + 90.0 + AZIMUTH_OFFSET_DEG;
        let (s, c) = v_deg.to_radians().sin_cos();
        let (u, v) = (Vector3::new(s, -c, 0.0), Vector3::new(c, s, 0.0));
        let on_sample = |w: Vector3<f64>| Vector3::new(w.dot(&u), w.dot(&v), w.z);
        let dn = (0..EDGE * EDGE)
            .map(|pixel| {
                let (lamp, camera, irradiance) = seen(pixel, tilt + TILT_OFFSET_DEG);
                let light = match kind {
                    FrameKind::Dark => 0.0,
                    FrameKind::Flat => 0.99 / PI * lamp.z * irradiance + stray,
                    FrameKind::Sample => {
                        let directions = Directions {
                            incident: on_sample(lamp),
                            outgoing: on_sample(camera),
                        };
                        irradiance * sample.partials(&directions).value + stray
                    }
                };
                let electrons = light * response[pixel] * 1.2e6 * exposure_s;
                let counted = electrons + electrons.sqrt() * noise() + 2.0 * noise();
                (200.0 + 2.0 * counted).round().clamp(0.0, 65535.0) as u16
            })
            .collect();
        series.take(kind, tilt, azimuth, exposure_s);
        let frame = Frame::new(EDGE as u32, EDGE as u32, dn).unwrap();
        series.frames.push(Some(frame));
    }
    series
}

/// Fits the rendered surface and compares it with the truth: to 0.1°, 0.3° for the azimuth, and 3 %.
fn checked(surface: &Surface, set: &ObservationSet) -> FitReport {
    let report = fit(set, &sawtooth(), &AtomicBool::new(false));
    let p = &report.parameters;
    for (name, found, truth, tolerance) in [
        (
            "theta_r_deg",
            &p.theta_r_deg,
            surface.theta_r.to_degrees(),
            0.1,
        ),
        (
            "alpha_u",
            &p.alpha_u,
            surface.alpha_u,
            0.03 * surface.alpha_u,
        ),
        (
            "alpha_v",
            &p.alpha_v,
            surface.alpha_v,
            0.03 * surface.alpha_v,
        ),
        ("rho_d", &p.rho_d, surface.rho_d, 0.03 * surface.rho_d),
        (
            "azimuth_offset_deg",
            &p.azimuth_offset_deg,
            AZIMUTH_OFFSET_DEG,
            0.3,
        ),
        ("tilt_offset_deg", &p.tilt_offset_deg, TILT_OFFSET_DEG, 0.1),
    ] {
        let (value, expanded) = (found.value.unwrap(), found.expanded.unwrap());
        let off = (value - truth).abs();
        assert!(
            off < tolerance && off < expanded,
            "{name}: {value} ± {expanded}"
        );
    }
    report
}

fn sawtooth() -> FitOptions {
    FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    }
}

fn reduced(surface: &Surface) -> ObservationSet {
    let set = reduce(&painted(surface, 0.004), None, &AtomicBool::new(false)).unwrap();
    assert_eq!(set.observations.len(), 56, "{:?}", set.rejected_frames);
    set
}

const BROAD: Surface = Surface {
    theta_r: 10.0 * PI / 180.0,
    alpha_u: 0.08,
    alpha_v: 0.08,
    rho_d: 0.3,
    amplitude: 1.0,
};

#[test]
fn the_fit_of_a_near_rig_is_right_and_is_worse_if_the_rig_is_taken_as_far() {
    let set = reduced(&BROAD);
    let near = checked(&BROAD, &set);
    let mut flattened = set.clone();
    flattened.views = Vec::new();
    let far = fit(&flattened, &sawtooth(), &AtomicBool::new(false));
    let (near, far) = (near.rms_residual.unwrap(), far.rms_residual.unwrap());
    assert!(far > 3.0 * near, "{far} {near}");
}

#[test]
fn a_narrow_lobe_on_a_dark_field_keeps_all_its_pixels() {
    let narrow = Surface {
        alpha_u: 0.05,
        alpha_v: 0.05,
        ..BROAD
    };
    let report = checked(&narrow, &reduced(&narrow));
    // If its flanks were rejected as outliers, the residual would be 2 %.
    let residual = report.rms_residual.unwrap();
    assert!(residual < 0.002, "{residual}");
}
