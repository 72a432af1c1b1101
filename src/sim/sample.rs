//! The samples of the simulated rig: their radiance towards the camera at a true pose.
//!
//! A [`SimulatedSample::Model`] is painted from a closed form. A [`SimulatedSample::Traced`] is
//! painted from path-traced radiances, so that a fit of the closed form meets the true model error.
//! At the poses of the table it has exactly the table's values. Between them and slightly beyond,
//! it is the closed form at the true parameters times the smoothly interpolated ratio traced /
//! closed.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::sync::{Arc, OnceLock};

use serde::Serialize;

use crate::geometry::{Directions, Pose, RigGeometry};
use crate::material::Material;
use crate::model::{Optics, Surface, Variant, radiance};
use crate::units::Angle;

/// True values of a sample, to print beside a fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Truth {
    /// Ridge angle.
    pub theta_r_deg: f64,
    /// Roughness along the ridges.
    pub alpha_u: f64,
    /// Roughness across the ridges.
    pub alpha_v: f64,
    /// Lambertian-equivalent diffuse reflectance; 0 for metals.
    pub rho_d: f64,
}

/// A sample that is uniform over the field.
#[derive(Debug, Clone)]
pub enum SimulatedSample {
    /// Painted from path-traced radiances.
    Traced(Arc<TracedTable>),
    /// Painted from a closed form.
    Model {
        /// The closed form.
        variant: Variant,
        /// The surface.
        surface: Surface,
        /// The material.
        material: Material,
    },
}

/// Path-traced radiances over a grid of poses, with the closed form used to interpolate them.
#[derive(Debug)]
pub struct TracedTable {
    name: &'static str,
    surface: Surface,
    material: Material,
    rig: RigGeometry,
    /// Camera tilts in degrees, ascending.
    tilts: Vec<f64>,
    /// Number of azimuths of the sample, evenly spaced over the turn from 0.
    azimuths: usize,
    /// (traced + floor) / (closed + floor), tilt by tilt.
    ratio: Vec<f64>,
    /// Bounds the ratio where there is almost no light; 0 for a sample that is bright at all poses.
    floor: f64,
}

/// Names of the samples of the tests; [`SimulatedSample::by_name`] makes them.
#[cfg(test)]
pub(super) const NAMES: [&str; 4] = ["polymer-10", "polymer-20", "polymer-05", "steel-15"];

const POLYMER: Material = Material::Dielectric {
    eta: 1.54,
    eta_std: 0.005,
};

#[cfg(test)]
const STEEL: Material = Material::Conductor {
    eta: 2.9,
    k: 3.1,
    eta_std: 0.02,
    k_std: 0.02,
};

impl SimulatedSample {
    /// The sample of `ridged demo`: rough plastic, θr 10°, traced on the full grid.
    #[must_use]
    pub fn polymer_10() -> SimulatedSample {
        static TABLE: OnceLock<Arc<TracedTable>> = OnceLock::new();
        let table = TABLE.get_or_init(|| {
            Arc::new(TracedTable::read(
                "polymer-10",
                include_str!("../../tests/data/series/polymer-10/radiance.csv"),
                surface(10.0, 0.12, 0.12, 0.33725),
                POLYMER,
                0.0,
            ))
        });
        SimulatedSample::Traced(Arc::clone(table))
    }

    /// Rough steel, θr 15°, traced with polarisation.
    #[cfg(test)]
    pub(super) fn steel_15() -> SimulatedSample {
        static TABLE: OnceLock<Arc<TracedTable>> = OnceLock::new();
        let table = TABLE.get_or_init(|| {
            Arc::new(TracedTable::read(
                "steel-15",
                include_str!("../../tests/data/series/steel-15/radiance.csv"),
                surface(15.0, 0.06, 0.18, 0.0),
                STEEL,
                0.01,
            ))
        });
        SimulatedSample::Traced(Arc::clone(table))
    }

    /// Returns a sample by one of [`NAMES`].
    #[cfg(test)]
    pub(super) fn by_name(name: &str) -> Option<SimulatedSample> {
        let plastic = |theta_r_deg, alpha| SimulatedSample::Model {
            variant: Variant::Sawtooth,
            surface: surface(theta_r_deg, alpha, alpha, 0.33),
            material: POLYMER,
        };
        match name {
            "polymer-10" => Some(SimulatedSample::polymer_10()),
            "polymer-20" => Some(plastic(20.0, 0.12)),
            "polymer-05" => Some(plastic(5.0, 0.08)),
            "steel-15" => Some(SimulatedSample::steel_15()),
            _ => None,
        }
    }

    /// The values that a fit should find.
    #[must_use]
    pub fn truth(&self) -> Truth {
        let surface = self.surface();
        Truth {
            theta_r_deg: surface.theta_r.to_degrees(),
            alpha_u: surface.alpha_u,
            alpha_v: surface.alpha_v,
            rho_d: surface.rho_d,
        }
    }

    /// The true surface.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        match self {
            SimulatedSample::Traced(table) => &table.surface,
            SimulatedSample::Model { surface, .. } => surface,
        }
    }

    /// The nominal material, as a manifest states it.
    #[must_use]
    pub fn material(&self) -> Material {
        match self {
            SimulatedSample::Traced(table) => table.material,
            SimulatedSample::Model { material, .. } => *material,
        }
    }

    /// Name as text.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            SimulatedSample::Traced(table) => table.name.to_owned(),
            SimulatedSample::Model {
                surface, material, ..
            } => {
                let kind = match material {
                    Material::Dielectric { .. } => "polymer",
                    Material::Conductor { .. } => "metal",
                };
                format!("{kind}-{:02.0}", surface.theta_r.to_degrees())
            }
        }
    }

    /// Radiance towards the camera at a true pose, for irradiance 1 on a surface facing the lamp. A
    /// traced sample is tabulated for its own rig ([`RigGeometry::IN_PLANE`]); the closed form
    /// converts it to another rig.
    #[must_use]
    pub fn radiance(&self, rig: &RigGeometry, pose: Pose) -> f64 {
        self.radiance_towards(rig, pose)(&rig.directions(pose))
    }

    /// The radiance as a function of directions in the sample frame, for pixels with their own
    /// directions: the closed form converts a traced sample from the pose's directions to others.
    pub(super) fn radiance_towards<'s>(
        &'s self,
        rig: &RigGeometry,
        pose: Pose,
    ) -> Box<dyn Fn(&Directions) -> f64 + 's> {
        match self {
            SimulatedSample::Traced(table) => {
                let optics = Optics::new(rig, &table.material);
                let ratio = if *rig == table.rig {
                    table.ratio_at(pose)
                } else {
                    1.0
                };
                Box::new(move |directions| {
                    let closed = radiance(Variant::Sawtooth, directions, &table.surface, &optics);
                    ((closed + table.floor) * ratio - table.floor).max(0.0)
                })
            }
            SimulatedSample::Model {
                variant,
                surface,
                material,
            } => {
                let optics = Optics::new(rig, material);
                Box::new(move |directions| radiance(*variant, directions, surface, &optics))
            }
        }
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

impl TracedTable {
    /// Reads the columns `theta_c_deg, phi_s_deg, region, radiance, …` of a full grid whose
    /// azimuths are evenly spaced from 0. `floor_share` is a fraction of the largest radiance.
    fn read(
        name: &'static str,
        csv: &str,
        surface: Surface,
        material: Material,
        floor_share: f64,
    ) -> TracedTable {
        let rig = RigGeometry::IN_PLANE;
        let mut cells: BTreeMap<(i64, i64), f64> = BTreeMap::new();
        for line in csv.lines().skip(1) {
            let mut fields = line.split(',');
            let mut number = || fields.next().and_then(|f| f.trim().parse::<f64>().ok());
            let (Some(tilt), Some(azimuth)) = (number(), number()) else {
                continue;
            };
            let value = line
                .split(',')
                .nth(3)
                .and_then(|f| f.trim().parse::<f64>().ok())
                .expect("the embedded table has a radiance in its fourth column");
            cells.insert(
                (
                    (tilt * 1000.0).round() as i64,
                    (azimuth * 1000.0).round() as i64,
                ),
                value,
            );
        }
        let mut tilts: Vec<i64> = cells.keys().map(|k| k.0).collect();
        tilts.dedup();
        let azimuths = cells.len() / tilts.len();
        let floor = floor_share * cells.values().fold(0.0, |a: f64, b| a.max(*b));
        let optics = Optics::new(&rig, &material);
        let ratio = cells
            .iter()
            .map(|((tilt, azimuth), traced)| {
                let pose = Pose::from_deg(*tilt as f64 / 1000.0, *azimuth as f64 / 1000.0);
                let closed = radiance(Variant::Sawtooth, &rig.directions(pose), &surface, &optics);
                (traced + floor) / (closed + floor)
            })
            .collect();
        TracedTable {
            name,
            surface,
            material,
            rig,
            tilts: tilts.iter().map(|t| *t as f64 / 1000.0).collect(),
            azimuths,
            ratio,
            floor,
        }
    }

    /// The ratio at a true pose: trigonometric interpolation over the turn and a natural cubic
    /// spline over the tilts, extrapolated linearly for half a step and constant beyond.
    fn ratio_at(&self, pose: Pose) -> f64 {
        let weights: Vec<f64> = (0..self.azimuths)
            .map(|j| {
                let node = TAU * j as f64 / self.azimuths as f64;
                dirichlet(pose.phi_s.rad() - node, self.azimuths)
            })
            .collect();
        let over_tilts: Vec<f64> = self
            .ratio
            .chunks(self.azimuths)
            .map(|row| row.iter().zip(&weights).map(|(r, w)| r * w).sum())
            .collect();
        let (first, last) = (self.tilts[0], self.tilts[self.tilts.len() - 1]);
        let step = self.tilts[1] - self.tilts[0];
        let tilt = pose
            .theta_c
            .deg()
            .clamp(first - 0.5 * step, last + 0.5 * step);
        natural_spline(&self.tilts, &over_tilts, tilt)
    }
}

/// Weight of a node at distance `x` in the trigonometric interpolation over `n` (even) nodes of a
/// turn.
fn dirichlet(x: f64, n: usize) -> f64 {
    let half = 0.5 * Angle::from_rad(x).wrapped().rad();
    if half.abs() < 1e-9 {
        return 1.0;
    }
    if (half.abs() - 0.5 * PI).abs() < 1e-9 {
        return 0.0;
    }
    let n = n as f64;
    (n * half).sin() / (n * half.tan())
}

/// Natural cubic spline through (`xs`, `ys`) at `x`, linear beyond its ends.
fn natural_spline(xs: &[f64], ys: &[f64], x: f64) -> f64 {
    let n = xs.len();
    // Second derivatives by the tridiagonal algorithm; zero at both ends.
    let mut second = vec![0.0; n];
    let mut upper = vec![0.0; n];
    for i in 1..n - 1 {
        let (before, after) = (xs[i] - xs[i - 1], xs[i + 1] - xs[i]);
        let bend = (ys[i + 1] - ys[i]) / after - (ys[i] - ys[i - 1]) / before;
        let pivot = 2.0 * (before + after) - before * upper[i - 1];
        upper[i] = after / pivot;
        second[i] = (6.0 * bend - before * second[i - 1]) / pivot;
    }
    for i in (1..n - 1).rev() {
        second[i] -= upper[i] * second[i + 1];
    }
    let slope_at = |i: usize, end: bool| {
        let h = xs[i + 1] - xs[i];
        let chord = (ys[i + 1] - ys[i]) / h;
        if end {
            chord + h * (second[i] + 2.0 * second[i + 1]) / 6.0
        } else {
            chord - h * (2.0 * second[i] + second[i + 1]) / 6.0
        }
    };
    if x <= xs[0] {
        return ys[0] + slope_at(0, false) * (x - xs[0]);
    }
    if x >= xs[n - 1] {
        return ys[n - 1] + slope_at(n - 2, true) * (x - xs[n - 1]);
    }
    let i = xs.partition_point(|node| *node <= x) - 1;
    let h = xs[i + 1] - xs[i];
    let (a, b) = ((xs[i + 1] - x) / h, (x - xs[i]) / h);
    a * ys[i]
        + b * ys[i + 1]
        + ((a * a * a - a) * second[i] + (b * b * b - b) * second[i + 1]) * h * h / 6.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(name: &str) -> Vec<(f64, f64, f64, f64)> {
        let path = format!(
            "{}/tests/data/series/{name}/radiance.csv",
            env!("CARGO_MANIFEST_DIR")
        );
        let mut reader = csv::Reader::from_path(path).unwrap();
        let records = reader.records().map(Result::unwrap);
        records
            .map(|r| {
                let f = |i: usize| r[i].parse::<f64>().unwrap();
                (f(0), f(1), f(3), f(4))
            })
            .collect()
    }

    #[test]
    fn a_traced_sample_equals_its_table_at_the_tables_poses() {
        let rig = RigGeometry::IN_PLANE;
        for (name, sample) in [
            ("polymer-10", SimulatedSample::polymer_10()),
            ("steel-15", SimulatedSample::steel_15()),
        ] {
            let table = table(name);
            let peak = table.iter().map(|t| t.2).fold(0.0, f64::max);
            assert_eq!(table.len(), 108);
            for (tilt, azimuth, value, _) in table {
                for turns in [0.0, 360.0, -360.0] {
                    let got = sample.radiance(&rig, Pose::from_deg(tilt, azimuth + turns));
                    assert!(
                        (got - value).abs() < 1e-12 * peak,
                        "{name} {tilt} {azimuth}"
                    );
                }
            }
        }
    }

    #[test]
    fn between_the_tables_poses_a_traced_sample_stays_near_the_closed_form() {
        // The closed form deviates by at most 1.5 % of the peak at the table's poses; the
        // interpolated ratio must not add to that between them or slightly beyond.
        let rig = RigGeometry::IN_PLANE;
        let sample = SimulatedSample::polymer_10();
        let model = SimulatedSample::Model {
            variant: Variant::Sawtooth,
            surface: *sample.surface(),
            material: sample.material(),
        };
        let mut last: Option<f64> = None;
        for step in 0..4 * 360 {
            let pose = Pose::from_deg(-20.4 + f64::from(step) * 0.028, f64::from(step) * 0.25);
            let traced = sample.radiance(&rig, pose);
            let closed = model.radiance(&rig, pose);
            assert!((traced - closed).abs() < 0.015 * 0.358, "{pose:?}");
            let ratio = traced / closed;
            assert!(last.is_none_or(|l| (l - ratio).abs() < 0.004), "{pose:?}");
            last = Some(ratio);
        }
    }

    #[test]
    fn interpolation_is_exact_for_functions_in_its_space() {
        let wave = |x: f64| 1.0 + 0.3 * x.cos() - 0.2 * (3.0 * x).sin();
        for x in [0.1, 1.0, 2.5, 5.9] {
            let sum: f64 = (0..12)
                .map(|j| {
                    let node = TAU * f64::from(j) / 12.0;
                    wave(node) * dirichlet(x - node, 12)
                })
                .sum();
            assert!((sum - wave(x)).abs() < 1e-12);
        }
        let xs = [-1.0, 0.0, 1.5, 2.0];
        let ys = xs.map(|x| 3.0 - 2.0 * x);
        for x in [-2.0, -0.5, 1.0, 1.9, 4.0] {
            assert!((natural_spline(&xs, &ys, x) - (3.0 - 2.0 * x)).abs() < 1e-12);
        }
    }

    #[test]
    fn every_named_sample_exists_and_conserves_energy() {
        for name in NAMES {
            let sample = SimulatedSample::by_name(name).unwrap();
            assert_eq!(sample.name(), name);
            let bright = sample.radiance(&RigGeometry::IN_PLANE, Pose::from_deg(5.0, 0.0));
            assert!(bright.is_finite() && bright > 0.0);
        }
        assert!(SimulatedSample::by_name("gold").is_none());
    }
}
