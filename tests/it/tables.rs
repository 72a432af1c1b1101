//! BRDF tables from goniometers: simulated here for known surfaces, read and fitted. Below: forms of a reading, and files of
//! BiRD.

use std::sync::atomic::AtomicBool;

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde_json::Value as Json;
use tempfile::TempDir;

use ridged::analysis::{AnalysisOptions, analyse_observations};
use ridged::fit::causes::findings::Code;
use ridged::fit::{Constraint, FitOptions, FitReport, Quantity, VariantChoice};
use ridged::geometry::{Cones, Directions};
use ridged::model::prepared::OpticsTable;
use ridged::model::quadrature::Quadrature;
use ridged::model::{Optics, Surface};
use ridged::observation::ObservationSet;
use ridged::series::Series;
use ridged::tables::{BrdfTable, is_table};

pub(crate) mod bird;
mod forms;

/// θi, φi, θo, φo in degrees, φ from u towards v.
type Angles = [f64; 4];

const OPTICS: Optics = Optics {
    eta: 1.5,
    k: 0.0,
    theta_l: 0.0,
    cones: Cones::NONE,
};

fn surface(theta_r_deg: f64) -> Surface {
    Surface {
        theta_r: theta_r_deg.to_radians(),
        alpha_u: 0.10,
        alpha_v: 0.14,
        rho_d: 0.3,
        amplitude: 1.0,
    }
}

/// BRDF with two bounces integrated, sr⁻¹.
fn brdf(surface: &Surface, angles: &[Angles]) -> Vec<f64> {
    brdf_of(&OPTICS, surface, angles)
}

fn brdf_of(optics: &Optics, surface: &Surface, angles: &[Angles]) -> Vec<f64> {
    let towards = |theta_deg: f64, phi_deg: f64| {
        let ((s, c), (sp, cp)) = (
            theta_deg.to_radians().sin_cos(),
            phi_deg.to_radians().sin_cos(),
        );
        Vector3::new(s * cp, s * sp, c)
    };
    let directions: Vec<Directions> = angles
        .iter()
        .map(|a| Directions {
            incident: towards(a[0], a[1]),
            outgoing: towards(a[2], a[3]),
        })
        .collect();
    let radiances =
        Quadrature::new(surface, &OpticsTable::new(optics)).radiances(&directions, 1e-6);
    let pairs = radiances.iter().zip(&directions);
    pairs.map(|(l, d)| l.value / d.incident.z).collect()
}

/// Two angles of incidence from four sides, and the detector around the mirror directions of facets
/// up to 15°.
fn around() -> Vec<Angles> {
    let mut angles = Vec::new();
    for (theta_i, phi_i) in [(10.0, 0.0), (10.0, 90.0), (30.0, 180.0), (30.0, 270.0)] {
        for theta_o in [0.0, 20.0, 40.0, 60.0] {
            for side in [0.0, 50.0, 90.0, 180.0, 240.0, 300.0] {
                if theta_o > 0.0 || side == 0.0 {
                    angles.push([theta_i, phi_i, theta_o, phi_i + side]);
                }
            }
        }
    }
    angles
}

/// Only across the ridges, with the detector on both sides of the normal.
fn across() -> Vec<Angles> {
    let mut angles = Vec::new();
    for (theta_i, phi_i) in [(0.0, 90.0), (20.0, 90.0), (30.0, 270.0)] {
        for step in -12..=12 {
            let theta_o = 5.0 * f64::from(step);
            angles.push([theta_i, phi_i, theta_o, 90.0]);
        }
    }
    angles
}

/// A lamp 10° beside a camera, which tilts over nine azimuths.
fn beside() -> Vec<Angles> {
    let mut angles = Vec::new();
    for azimuth in 0..9 {
        for step in -4..=4 {
            let theta_c = 5.0 * f64::from(step);
            let at = |theta: f64| {
                let side = if theta < 0.0 { 180.0 } else { 0.0 };
                (theta.abs(), side + 90.0 - 30.0 * f64::from(azimuth))
            };
            let ((theta_i, phi_i), (theta_o, phi_o)) = (at(theta_c + 10.0), at(theta_c));
            angles.push([theta_i, phi_i, theta_o, phi_o]);
        }
    }
    angles
}

const REL_STD: f64 = 0.005;
const FLOOR: f64 = 0.001;

fn noisy(values: &[f64]) -> Vec<f64> {
    let mut rng = Pcg64::seed_from_u64(3);
    let noise = |f: &f64| {
        let z: f64 = StandardNormal.sample(&mut rng);
        f + z * (REL_STD * f).hypot(FLOOR)
    };
    values.iter().map(noise).collect()
}

const MANIFEST: &str = r#"schema = "brdf-table-1"
name = "made"
table = "table.csv"
[goniometer]
value = "brdf"
scale_rel_std = 0.005
value_rel_std = 0.005
value_std = 0.001
theta_std_deg = 0.02
phi_std_deg = 0.02
sample_tilt_std_deg = 0.02
[sample]
kind = "dielectric"
index_of_refraction = 1.5
index_of_refraction_std = 0.005
"#;

fn csv(angles: &[Angles], values: &[f64]) -> String {
    let mut text = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value\n".to_owned();
    for (a, f) in angles.iter().zip(values) {
        text += &format!("{},{},{},{},{f:.6}\n", a[0], a[1], a[2], a[3]);
    }
    text
}

fn folder(manifest: &str, table: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("manifest.toml"), manifest).unwrap();
    let name = if table.starts_with('{') {
        "table.json"
    } else {
        "table.csv"
    };
    std::fs::write(folder.path().join(name), table).unwrap();
    folder
}

fn observed(manifest: &str, table: &str) -> ObservationSet {
    BrdfTable::open(folder(manifest, table).path())
        .unwrap()
        .observations()
}

fn refused(manifest: &str, table: &str) -> String {
    BrdfTable::open(folder(manifest, table).path())
        .unwrap_err()
        .to_string()
}

fn fitted(observations: ObservationSet) -> FitReport {
    let options = AnalysisOptions {
        fit: FitOptions {
            variant: VariantChoice::Sawtooth,
            constraints: vec![Constraint {
                quantity: Quantity::TiltOffset,
                value: 0.0,
                std: 0.0,
            }],
            ..FitOptions::default()
        },
        ..AnalysisOptions::default()
    };
    let never = AtomicBool::new(false);
    analyse_observations(observations, &options, &|_| {}, &never)
        .unwrap()
        .report
}

/// A parameter is within its U, which is below `most`.
fn holds(name: &str, found: (Option<f64>, Option<f64>), truth: f64, most: f64) {
    let (value, u) = (found.0.unwrap(), found.1.unwrap());
    assert!(
        (value - truth).abs() <= u,
        "{name}: {value} ± {u}, truth {truth}"
    );
    assert!(u < most, "{name}: U is {u}");
}

#[test]
fn a_table_of_the_hemisphere_identifies_its_surface() {
    let truth = surface(12.0);
    let angles = around();
    let set = observed(MANIFEST, &csv(&angles, &noisy(&brdf(&truth, &angles))));
    assert_eq!(set.observations.len(), angles.len());
    let p = fitted(set).parameters;
    holds(
        "θr",
        (p.theta_r_deg.value, p.theta_r_deg.expanded),
        12.0,
        0.3,
    );
    holds(
        "φ",
        (p.azimuth_offset_deg.value, p.azimuth_offset_deg.expanded),
        0.0,
        1.0,
    );
    holds("αu", (p.alpha_u.value, p.alpha_u.expanded), 0.10, 0.01);
    holds("αv", (p.alpha_v.value, p.alpha_v.expanded), 0.14, 0.01);
    holds("ρd", (p.rho_d.value, p.rho_d.expanded), 0.3, 0.02);
}

#[test]
fn a_bad_reading_is_named_by_its_line() {
    let angles = around();
    let mut values = noisy(&brdf(&surface(12.0), &angles));
    values[40] *= 1.3;
    let report = fitted(observed(MANIFEST, &csv(&angles, &values)));
    let bad: Vec<&str> = report.findings.iter().map(|f| f.advice.as_str()).collect();
    // The header is line 1.
    assert!(bad[0].starts_with("Check line 42: "), "{bad:?}");
    assert_eq!(report.findings[0].code, Code::BadPose);
}

#[test]
fn noisy_readings_are_weighed_by_the_fit_and_not_by_themselves() {
    let truth = surface(12.0);
    let angles = around();
    let clean = brdf(&truth, &angles);
    let manifest = MANIFEST.replace(
        "value_rel_std = 0.005\nvalue_std = 0.001",
        "value_rel_std = 0.2",
    );
    let table_of =
        |manifest: &str| BrdfTable::open(folder(manifest, &csv(&angles, &clean)).path()).unwrap();
    let (mut first, mut second) = (0.0, 0.0);
    let seeds = 4_u32;
    for seed in 0..seeds {
        let mut rng = Pcg64::seed_from_u64(seed.into());
        let noise = |f: &f64| {
            let z: f64 = StandardNormal.sample(&mut rng);
            f * (1.0 + 0.2 * z)
        };
        let values: Vec<f64> = clean.iter().map(noise).collect();
        let table = BrdfTable::open(folder(&manifest, &csv(&angles, &values)).path()).unwrap();
        let report = fitted(table.observations());
        first += report.parameters.rho_d.value.unwrap() / f64::from(seeds);
        let signals: Vec<f64> = report.fitted.iter().map(|o| o.fitted).collect();
        let weighed = table.weighed_by(table.observations(), &signals);
        second += fitted(weighed).parameters.rho_d.value.unwrap() / f64::from(seeds);
    }
    // 70 diffuse readings of 20 % in four tables: 1.2 %.
    assert!((second / truth.rho_d - 1.0).abs() < 0.04, "{second}");
    assert!(
        (second - truth.rho_d).abs() < (first - truth.rho_d).abs(),
        "{first} {second}"
    );
    assert!(table_of(&manifest).is_noisy());
    assert!(!table_of(MANIFEST).is_noisy());
}

#[test]
fn a_table_across_the_ridges_identifies_their_angle() {
    let truth = surface(8.0);
    let angles = across();
    let table = csv(&angles, &noisy(&brdf(&truth, &angles)));
    let p = fitted(observed(MANIFEST, &table)).parameters;
    holds(
        "θr",
        (p.theta_r_deg.value, p.theta_r_deg.expanded),
        8.0,
        0.5,
    );
    holds("αv", (p.alpha_v.value, p.alpha_v.expanded), 0.14, 0.02);
    // The angle is identifiable without an absolute scale.
    let relative = MANIFEST.replace("scale_rel_std = 0.005", "scale = \"relative\"");
    let p = fitted(observed(&relative, &table)).parameters;
    holds(
        "θr",
        (p.theta_r_deg.value, p.theta_r_deg.expanded),
        8.0,
        0.5,
    );
    assert_eq!(p.rho_d.value, None);
}

#[test]
fn steep_ridges_of_metal_are_found_where_another_surface_is_nearer_to_the_first_starts() {
    let optics = Optics {
        eta: 2.9,
        k: 3.1,
        ..OPTICS
    };
    let metal = MANIFEST.replace(
        "kind = \"dielectric\"\nindex_of_refraction = 1.5\nindex_of_refraction_std = 0.005",
        "kind = \"conductor\"\neta = 2.9\nk = 3.1\neta_std = 0.01\nk_std = 0.01",
    );
    let angles = beside();
    let never = AtomicBool::new(false);
    for theta_r_deg in [30.0, 35.0] {
        let truth = Surface {
            alpha_u: 0.1,
            alpha_v: 0.1,
            rho_d: 0.0,
            ..surface(theta_r_deg)
        };
        let table = csv(&angles, &noisy(&brdf_of(&optics, &truth, &angles)));
        let set = observed(&metal, &table);
        let options = AnalysisOptions::default();
        let done = analyse_observations(set, &options, &|_| {}, &never).unwrap();
        let p = done.report.parameters;
        let found = (p.theta_r_deg.value, p.theta_r_deg.expanded);
        holds("θr", found, theta_r_deg, 1.0);
    }
}

#[test]
fn the_fault_of_a_table_is_named_with_its_place() {
    let table = "theta_i,phi_i,theta_o,phi_o,value,sigma\n10,0,20,90,0.5,\n10,0,30,90,nan,\n10,0,40,90,0.4,0.01\n";
    let set = observed(MANIFEST, table);
    assert_eq!(set.observations.len(), 2);
    assert!(
        set.warnings
            .iter()
            .any(|w| w.contains("1 row without a value")),
        "{:?}",
        set.warnings
    );
    for (from, to, words) in [
        ("theta_o", "theta", ["line 1", "theta_o_deg is missing"]),
        ("sigma", "brdf", ["line 1", "both mean value"]),
        ("10,0,20", "10,0,120", ["line 2", "not above the surface"]),
        ("0.4,0.01", "0.4,0", ["line 4", "sigma = 0"]),
        ("0.4,", "0.4°,", ["line 4", "U+00B0"]),
    ] {
        let said = refused(MANIFEST, &table.replacen(from, to, 1));
        for word in words {
            assert!(said.contains(word), "{to}: `{word}` is not in: {said}");
        }
    }
    for (from, to, words) in [
        ("\"brdf\"", "\"btdf\"", ["line 5: goniometer.value", "btdf"]),
        (
            "value_rel_std",
            "value_rel_sd",
            ["value_rel_sd", "docs/reference/brdf-tables.md"],
        ),
        (
            "theta_std_deg = 0.02",
            "theta_std_deg = 20",
            ["theta_std_deg", "0 to 10°"],
        ),
        (
            "index_of_refraction = 1.5",
            "",
            ["sample.index_of_refraction", "dielectric"],
        ),
        ("table.csv", "other.csv", ["other.csv", "cannot be read"]),
    ] {
        let said = refused(&MANIFEST.replacen(from, to, 1), table);
        for word in words {
            assert!(said.contains(word), "{to}: `{word}` is not in: {said}");
        }
    }
    // Commands that need frames name the kind of folder.
    let folder = folder(MANIFEST, table);
    assert!(is_table(folder.path()));
    let said = Series::open(folder.path()).unwrap_err().to_string();
    assert!(
        said.contains("a table of BRDF") && said.contains("ridged fit"),
        "{said}"
    );
}

#[test]
fn the_command_fits_a_table() {
    let angles = around();
    let table = folder(MANIFEST, &csv(&angles, &brdf(&surface(12.0), &angles)));
    let run = |more: &[&str]| {
        std::process::Command::new(env!("CARGO_BIN_EXE_ridged"))
            .arg("fit")
            .arg(table.path())
            .args(["--variant", "sawtooth", "--json"])
            .args(more)
            .output()
            .unwrap()
    };
    let done = run(&[]);
    assert!(done.status.success(), "{done:?}");
    let report: Json = serde_json::from_slice(&done.stdout).unwrap();
    let theta_r = report["parameters"]["theta_r_deg"]["value"]
        .as_f64()
        .unwrap();
    assert!((theta_r - 12.0).abs() < 0.05, "{theta_r}");
    for (more, words) in [
        (["--region", "even"], "no regions"),
        (["--fix", "tilt_offset_deg=1"], "theta_std_deg"),
    ] {
        let refused = run(&more);
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            refused.status.code() == Some(2) && said.contains(words),
            "{said}"
        );
    }
}
