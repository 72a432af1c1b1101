//! The recorded series of a path tracer, with the noise-free radiances and the truth of their samples.

use crate::geometry::{Directions, Pose};
use crate::model::{Optics, Surface};
use crate::series::Manifest;

/// A recorded series without its frames: the texts of its files.
#[derive(Debug, Clone, Copy)]
pub struct RecordedSeries {
    /// Name of its folder.
    pub name: &'static str,
    /// `manifest.toml`.
    pub manifest: &'static str,
    /// `truth.toml`.
    truth: &'static str,
    /// `radiance.csv`.
    radiance: &'static str,
}

/// What a series was traced from.
#[derive(Debug, Clone)]
pub struct RecordedTruth {
    /// Rig, camera and sample as stated to a fit.
    pub manifest: Manifest,
    /// The sample.
    pub surface: Surface,
    /// Its material under the lamp.
    pub optics: Optics,
    /// True pose, its directions, and the path tracer's radiance.
    pub rows: Vec<(Pose, Directions, f64)>,
}

/// Plastic of 10°.
pub const POLYMER_10: RecordedSeries = RecordedSeries {
    name: "polymer-10",
    manifest: include_str!("../../tests/data/series/polymer-10/manifest.toml"),
    truth: include_str!("../../tests/data/series/polymer-10/truth.toml"),
    radiance: include_str!("../../tests/data/series/polymer-10/radiance.csv"),
};
/// Steel of 15°.
pub const STEEL_15: RecordedSeries = RecordedSeries {
    name: "steel-15",
    manifest: include_str!("../../tests/data/series/steel-15/manifest.toml"),
    truth: include_str!("../../tests/data/series/steel-15/truth.toml"),
    radiance: include_str!("../../tests/data/series/steel-15/radiance.csv"),
};
/// Plastic of 5° on the rig of the first paper.
pub const PAPER_RIG_FULL: RecordedSeries = RecordedSeries {
    name: "paper-rig-full",
    manifest: include_str!("../../tests/data/series/paper-rig-full/manifest.toml"),
    truth: include_str!("../../tests/data/series/paper-rig-full/truth.toml"),
    radiance: include_str!("../../tests/data/series/paper-rig-full/radiance.csv"),
};
/// All of them.
pub const RECORDED_SERIES: [RecordedSeries; 3] = [POLYMER_10, STEEL_15, PAPER_RIG_FULL];

impl RecordedSeries {
    /// The manifest, read.
    ///
    /// # Panics
    /// Never: the texts are part of the program, and tests read them.
    #[must_use]
    pub fn manifest(&self) -> Manifest {
        Manifest::from_toml(self.manifest, "manifest.toml")
            .expect("the program's manifest is valid")
    }

    /// A number of `truth.toml` by section and key; `None` where it has none.
    #[must_use]
    pub fn true_number(&self, section: &str, key: &str) -> Option<f64> {
        let truth: toml::Table = toml::from_str(self.truth).ok()?;
        truth.get(section)?.get(key)?.as_float()
    }

    /// Poses as recorded, with the path tracer's radiances.
    #[must_use]
    pub fn radiances(&self) -> Vec<(Pose, f64)> {
        let rows = self.radiance.lines().skip(1).filter_map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            let number = |n: usize| fields.get(n)?.parse::<f64>().ok();
            Some((Pose::from_deg(number(0)?, number(1)?), number(3)?))
        });
        rows.collect()
    }

    /// What the radiances were traced from.
    #[must_use]
    pub fn truth(&self) -> RecordedTruth {
        let manifest = self.manifest();
        let rig = manifest.rig_geometry();
        let sample = |key| self.true_number("sample", key);
        let alpha = |key| sample(key).or_else(|| sample("alpha")).unwrap_or(0.0);
        let mounting = |key| self.true_number("mounting", key).unwrap_or(0.0);
        let offset = Pose::from_deg(
            mounting("camera_tilt_zero_offset_deg"),
            mounting("azimuth_offset_deg"),
        );
        let rows = self.radiances().into_iter().map(|(recorded, radiance)| {
            let pose = Pose {
                theta_c: recorded.theta_c + offset.theta_c,
                phi_s: recorded.phi_s + offset.phi_s,
            };
            (pose, rig.directions(pose), radiance)
        });
        RecordedTruth {
            surface: Surface {
                theta_r: sample("theta_r_deg").unwrap_or(0.0).to_radians(),
                alpha_u: alpha("alpha_u"),
                alpha_v: alpha("alpha_v"),
                rho_d: sample("rho_d_lambertian_equivalent").unwrap_or(0.0),
                amplitude: 1.0,
            },
            optics: Optics::new(&rig, &manifest.material()),
            rows: rows.collect(),
            manifest,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_recorded_series_has_a_truth_and_a_radiance_for_each_pose() {
        for series in RECORDED_SERIES {
            let truth = series.truth();
            assert!(
                truth.surface.theta_r > 0.0 && truth.surface.alpha_v > 0.0,
                "{}",
                series.name
            );
            assert!(
                truth.rows.len() > 50,
                "{}: {}",
                series.name,
                truth.rows.len()
            );
            assert!(truth.rows.iter().all(|row| row.2 >= 0.0));
        }
    }
}
