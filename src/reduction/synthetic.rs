//! Series held in memory, for tests: recorded ones whose frames can be spoilt one by one, and made
//! ones whose truth is known to the last digit.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal, Poisson};
use rand_pcg::Pcg64;

use super::viewing::Viewing;
use crate::frame::{Frame, FrameKind};
use crate::geometry::Directions;
use crate::series::{FrameRow, Manifest, Series};

pub(super) use crate::cases::MemorySeries as Memory;

impl Memory {
    pub(super) fn of(series: &Series) -> Memory {
        Memory {
            manifest: series.manifest().clone(),
            rows: series.rows().to_vec(),
            frames: (0..series.rows().len())
                .map(|i| Some(series.read(i).unwrap()))
                .collect(),
        }
    }

    pub(super) fn index_of(&self, file: &str) -> usize {
        let wanted = |r: &FrameRow| r.file.contains(file);
        self.rows
            .iter()
            .position(wanted)
            .expect("the file is there")
    }

    pub(super) fn edit(&mut self, file: &str, change: impl FnOnce(&mut Vec<u16>)) {
        let at = self.index_of(file);
        let frame = self.frames[at].take().unwrap();
        let mut pixels = frame.pixels_dn().to_vec();
        change(&mut pixels);
        self.frames[at] = Some(Frame::new(frame.width_px(), frame.height_px(), pixels).unwrap());
    }
}

/// A camera whose every flaw is known.
#[derive(Clone)]
pub(super) struct Made {
    pub(super) edge: u32,
    pub(super) saturation_dn: u16,
    pub(super) gain_dn: f64,
    pub(super) read_electrons: f64,
    pub(super) black_dn: f64,
    pub(super) electrons_per_radiance_second: f64,
    pub(super) dark_electrons_s: f64,
    pub(super) prnu: f64,
    pub(super) dsnu_dn: f64,
    pub(super) vignetting: f64,
    pub(super) stray: f64,
    pub(super) hot: f64,
    pub(super) dead: f64,
    /// Distances of camera and lamp, where they are near.
    pub(super) near_mm: Option<(f64, f64)>,
    /// What is missing at full scale: c of s = e (1 − c e/S).
    pub(super) bend: f64,
    /// By what share every exposure but the first is longer than stated.
    pub(super) shutter: f64,
    /// Relative scatter of the lamp from frame to frame.
    pub(super) flicker: f64,
    pub(super) seed: u64,
}

impl Default for Made {
    fn default() -> Self {
        Made {
            edge: 96,
            saturation_dn: 65535,
            gain_dn: 2.0,
            read_electrons: 2.0,
            black_dn: 200.0,
            electrons_per_radiance_second: 1.2e6,
            dark_electrons_s: 30.0,
            prnu: 0.01,
            dsnu_dn: 2.0,
            vignetting: 0.06,
            stray: 0.0,
            hot: 0.0,
            dead: 0.0,
            near_mm: None,
            bend: 0.0,
            shutter: 0.0,
            flicker: 0.0,
            seed: 1,
        }
    }
}

impl Made {
    /// A series of darks, flats at `tilts` and sample frames of the radiance that `radiance`
    /// gives for a pose.
    pub(super) fn series(
        &self,
        tilts: &[f64],
        azimuths: &[f64],
        exposures: &[f64],
        radiance: impl Fn(f64, f64) -> f64,
    ) -> Memory {
        self.series_of(tilts, azimuths, exposures, |tilt, azimuth, _| {
            radiance(tilt, azimuth)
        })
    }

    /// Counts above black of this camera, for the counts of a linear one.
    fn counted(&self, linear: f64) -> f64 {
        let full = f64::from(self.saturation_dn) - self.black_dn;
        linear * (1.0 - self.bend * linear / full)
    }

    /// The same with a radiance that hangs on each pixel's own directions in the rig's frame.
    pub(super) fn series_of(
        &self,
        tilts: &[f64],
        azimuths: &[f64],
        exposures: &[f64],
        radiance: impl Fn(f64, f64, &Directions) -> f64,
    ) -> Memory {
        let mut manifest = Manifest::from_toml(
            include_str!("../../tests/data/series/polymer-10/manifest.toml"),
            "",
        )
        .unwrap();
        let camera = &mut manifest.camera;
        camera.width_px = self.edge;
        camera.height_px = self.edge;
        camera.saturation_dn = Some(f64::from(self.saturation_dn));
        camera.gain_dn_per_electron = self.gain_dn;
        camera.read_noise_electrons_rms = Some(self.read_electrons);
        camera.black_level_dn = Some(self.black_dn);
        if let Some((camera_mm, light_mm)) = self.near_mm {
            manifest.camera.projection = "perspective".to_owned();
            manifest.rig.camera_distance = Some("finite".to_owned());
            manifest.rig.light_distance = Some("finite".to_owned());
            manifest.rig.camera_distance_mm = Some(camera_mm);
            manifest.rig.light_distance_mm = Some(light_mm);
            manifest.rig.rotation_axis_px = Some([f64::from(self.edge) / 2.0; 2]);
        }
        let viewing = Viewing::of(&manifest).unwrap();
        let mut rng = Pcg64::seed_from_u64(self.seed);
        let pixels = (self.edge * self.edge) as usize;
        let normal = Normal::new(0.0, 1.0).unwrap();
        let fixed: Vec<(f64, f64, f64)> = (0..pixels)
            .map(|p| {
                let centre = f64::from(self.edge) / 2.0;
                let x = (p % self.edge as usize) as f64 + 0.5 - centre;
                let y = (p / self.edge as usize) as f64 + 0.5 - centre;
                let r2 = (x * x + y * y) / (centre * centre);
                let response =
                    (1.0 - self.vignetting * r2) * (1.0 + self.prnu * normal.sample(&mut rng));
                let defect: f64 = rng.random();
                let kind = if defect < self.hot {
                    1.0
                } else if defect < self.hot + self.dead {
                    -1.0
                } else {
                    0.0
                };
                (response, self.dsnu_dn * normal.sample(&mut rng), kind)
            })
            .collect();
        let mut rows = Vec::new();
        let mut frames = Vec::new();
        let mut take = |kind: FrameKind, tilt: f64, azimuth: f64, exposure: f64, repeat: u32| {
            let theta_c = crate::units::Angle::from_deg(tilt);
            let mut seconds = exposure;
            if exposure != exposures[0] {
                seconds *= 1.0 + self.shutter;
            }
            if self.flicker > 0.0 {
                seconds *= 1.0 + self.flicker * normal.sample(&mut rng);
            }
            let light_at = |pixel: usize| {
                let column = (pixel % self.edge as usize) as f64 + 0.5;
                let row = (pixel / self.edge as usize) as f64 + 0.5;
                let (d, irradiance) = viewing.at(viewing.point(column, row, theta_c), theta_c);
                match kind {
                    FrameKind::Dark => 0.0,
                    FrameKind::Flat => {
                        0.99 / std::f64::consts::PI * irradiance * d.incident.z + self.stray
                    }
                    FrameKind::Sample => irradiance * radiance(tilt, azimuth, &d) + self.stray,
                }
            };
            let dn = fixed
                .iter()
                .enumerate()
                .map(|(pixel, (response, offset, defect))| {
                    let light = light_at(pixel);
                    let due = light * response * self.electrons_per_radiance_second * seconds
                        + self.dark_electrons_s * seconds;
                    let electrons = if due > 0.0 {
                        Poisson::new(due).unwrap().sample(&mut rng)
                    } else {
                        0.0
                    } + self.read_electrons * normal.sample(&mut rng);
                    let dn = match *defect {
                        d if d > 0.0 => f64::from(self.saturation_dn) * 0.9,
                        d if d < 0.0 => self.black_dn,
                        _ => self.black_dn + offset + self.counted(self.gain_dn * electrons),
                    };
                    dn.round().clamp(0.0, f64::from(self.saturation_dn)) as u16
                })
                .collect();
            rows.push(FrameRow {
                file: format!(
                    "frames/{}_{tilt}_{azimuth}_{exposure}_{repeat}.png",
                    kind.as_str()
                ),
                kind,
                theta_c_deg: tilt,
                phi_s_deg: azimuth,
                exposure_s: exposure,
                repeat,
                timestamp: format!("2026-03-02T09:00:{:08.3}Z", rows.len() as f64 * 0.01),
            });
            frames.push(Some(Frame::new(self.edge, self.edge, dn).unwrap()));
        };
        for exposure in exposures {
            for repeat in 0..4 {
                take(FrameKind::Dark, 0.0, 0.0, *exposure, repeat);
            }
        }
        for tilt in tilts {
            // As much light as fits, so that the reference does not limit.
            let full = f64::from(self.saturation_dn) - self.black_dn;
            let due = |e: f64| 0.35 * self.electrons_per_radiance_second * e * self.gain_dn;
            let exposure = exposures
                .iter()
                .copied()
                .filter(|e| due(*e) < 0.9 * full)
                .fold(exposures[0], f64::max);
            take(FrameKind::Flat, *tilt, 0.0, exposure, 0);
        }
        for tilt in tilts {
            for azimuth in azimuths {
                for exposure in exposures {
                    take(FrameKind::Sample, *tilt, *azimuth, *exposure, 0);
                }
            }
        }
        Memory {
            manifest,
            rows,
            frames,
        }
    }
}
