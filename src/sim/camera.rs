//! The simulated camera: paints a 16-bit frame at the true pose of the shared world.
//!
//! Electrons are Poisson distributed about (radiance + stray light) · response · exposure + dark
//! current. Counts are black level + fixed offset + gain · (electrons + read noise), rounded and
//! clipped. Response is vignetting × pixel response. The frame shows what is in front of the lens
//! (a cap, the white reference, the sample), whatever kind was requested: a dark frame taken
//! without the cap shows the sample. While the stage moves, the radiance is averaged over the
//! exposure. With a near camera or lamp, each pixel has its own radiance ([`super::light`]).

use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures::future::BoxFuture;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Poisson, StandardNormal};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::light::{PixelLight, SimulatedScene};
use super::sample::SimulatedSample;
use super::world::{OnTable, World};
use crate::bench::{Camera, CameraError, CaptureRequest, Captured};
use crate::clock::Clock;
use crate::frame::Frame;
use crate::frame::FrameTag;
use crate::geometry::{Imaging, Pose, RigGeometry};
use crate::material::Material;
use crate::series::{
    CameraFacts, DarkFacts, FlatFacts, Manifest, RigFacts, SCHEMA, SampleFacts, SampleKind,
};

/// Number of poses sampled during one exposure.
const GLANCES: u32 = 4;
/// Expectation from which a Poisson number is drawn from the normal distribution; the skewness is
/// then below 1/50.
const NORMAL_FROM: f64 = 2500.0;

/// Properties of the simulated camera; the defaults are those of the recorded series.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatedCameraSettings {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Edge length of the square field along the columns.
    pub field_width_mm: f64,
    /// Distance from the centre of tilt to the entrance pupil; `None` for a telecentric lens.
    pub camera_distance_mm: Option<f64>,
    /// Distance from the centre of tilt to the lamp; `None` for collimated light.
    pub light_distance_mm: Option<f64>,
    /// Columns and rows from the frame's centre to the centre of tilt.
    pub tilt_centre_offset_px: [f64; 2],
    /// Columns and rows from the frame's centre to the foot of the rotation axis at θc = 0.
    pub axis_offset_px: [f64; 2],
    /// Bits of the converter; the largest count is 2^bits − 1.
    pub bit_depth: u32,
    /// Counts per electron.
    pub gain_dn_per_electron: f64,
    /// Count without light.
    pub black_level_dn: f64,
    /// Read noise, rms electrons.
    pub read_noise_electrons_rms: f64,
    /// Electrons per unit radiance and second in a pixel of response 1.
    pub electrons_per_radiance_second: f64,
    /// Dark current.
    pub dark_current_electrons_per_s: f64,
    /// Relative spread of the pixels' response.
    pub prnu_rms: f64,
    /// Spread of the pixels' offset, in counts.
    pub dsnu_dn_rms: f64,
    /// Relative loss of light at the middle of an edge of the field.
    pub vignetting_at_edge: f64,
    /// Stray radiance that reaches the sensor, the same in sample and flat frames.
    pub stray_radiance: f64,
    /// Fraction of pixels that are hot or dead.
    pub defect_fraction: f64,
    /// Reflectance of the white reference.
    pub reflectance: f64,
    /// Standard uncertainty of the reflectance in its certificate.
    pub reflectance_std: f64,
    /// Exposure times that suit the lamp.
    pub exposures_s: Vec<f64>,
    /// Seed of the fixed pattern and the noise.
    pub seed: u64,
}

impl Default for SimulatedCameraSettings {
    fn default() -> Self {
        SimulatedCameraSettings {
            width_px: 128,
            height_px: 128,
            field_width_mm: 51.2,
            camera_distance_mm: None,
            light_distance_mm: None,
            tilt_centre_offset_px: [0.0; 2],
            axis_offset_px: [0.0; 2],
            bit_depth: 16,
            gain_dn_per_electron: 2.0,
            black_level_dn: 200.0,
            read_noise_electrons_rms: 2.0,
            electrons_per_radiance_second: 1.2e6,
            dark_current_electrons_per_s: 30.0,
            prnu_rms: 0.01,
            dsnu_dn_rms: 2.0,
            vignetting_at_edge: 0.06,
            stray_radiance: 0.001,
            defect_fraction: 0.0005,
            reflectance: 0.99,
            reflectance_std: 0.005,
            exposures_s: vec![0.02, 0.06],
            seed: 1,
        }
    }
}

/// Response and offset of one pixel.
#[derive(Debug, Clone, Copy)]
struct Pixel {
    response: f64,
    offset_dn: f64,
    /// Constant count of a defective pixel.
    stuck_dn: Option<u16>,
}

/// Changes the sample on the table while the bench owns the camera.
#[derive(Debug, Clone)]
pub struct SampleHandle {
    sample: Arc<Mutex<SimulatedSample>>,
}

impl SampleHandle {
    /// Replaces the sample.
    pub fn set(&self, sample: SimulatedSample) {
        *self.lock() = sample;
    }

    /// Returns the present sample.
    #[must_use]
    pub fn get(&self) -> SimulatedSample {
        self.lock().clone()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, SimulatedSample> {
        self.sample.lock().expect("no holder of this lock panics")
    }
}

/// A camera above a [`World`].
pub struct SimulatedCamera {
    world: Arc<World>,
    clock: Arc<dyn Clock>,
    settings: SimulatedCameraSettings,
    rig: RigGeometry,
    sample: SampleHandle,
    pixels: Arc<[Pixel]>,
    captures: u64,
}

impl SimulatedCamera {
    /// Makes a camera on the rig of the recorded series ([`RigGeometry::IN_PLANE`]), above `world`.
    #[must_use]
    pub fn new(
        world: Arc<World>,
        settings: SimulatedCameraSettings,
        sample: SimulatedSample,
        clock: Arc<dyn Clock>,
    ) -> Self {
        SimulatedCamera {
            pixels: fixed_pattern(&settings),
            world,
            clock,
            settings,
            rig: RigGeometry::IN_PLANE,
            sample: SampleHandle {
                sample: Arc::new(Mutex::new(sample)),
            },
            captures: 0,
        }
    }

    /// Returns a handle that can change the sample.
    #[must_use]
    pub fn sample_handle(&self) -> SampleHandle {
        self.sample.clone()
    }

    /// The manifest of a recorded series of this rig and the present sample. It omits the world's
    /// mounting offsets: the fit has to find them.
    #[must_use]
    pub fn manifest(&self) -> Manifest {
        manifest(&self.settings, &self.rig, &self.sample.get())
    }

    /// The pose and the object in front of the lens; `None` with the cap on.
    fn seen_now(&self) -> Option<(Pose, OnTable)> {
        let open = !self.world.lens_capped();
        open.then(|| (self.world.true_pose_now(), self.world.on_table()))
    }

    /// Radiance in front of the lens, averaged over several moments.
    fn radiance(&self, moments: &[Option<(Pose, OnTable)>]) -> PixelLight {
        let sample = self.sample.get();
        let settings = &self.settings;
        let scene = SimulatedScene {
            imaging: imaging(settings, &self.rig),
            width: settings.width_px as usize,
            height: settings.height_px as usize,
            mounting: self.world.mounting(),
            sample: &sample,
            reflectance: settings.reflectance,
        };
        let at = |moment: &Option<(Pose, OnTable)>| match moment {
            Some((pose, on_table)) => scene
                .radiance(*on_table, *pose)
                .and(settings.stray_radiance),
            None => PixelLight::Even(0.0),
        };
        // All moments of a rig at rest are equal.
        match moments.windows(2).all(|two| two[0] == two[1]) {
            true => moments.first().map_or(PixelLight::Even(0.0), at),
            false => PixelLight::mean(&moments.iter().map(at).collect::<Vec<_>>()),
        }
    }
}

/// The mapping from pixels to places of the sample.
fn imaging(settings: &SimulatedCameraSettings, rig: &RigGeometry) -> Imaging {
    let (width, height) = (f64::from(settings.width_px), f64::from(settings.height_px));
    let from_centre = |[column, row]: [f64; 2]| [0.5 * width + column, 0.5 * height + row];
    let centre = from_centre(settings.tilt_centre_offset_px);
    Imaging {
        rig: *rig,
        pixel_mm: [settings.field_width_mm / width; 2],
        tilt_centre_px: centre,
        principal_point_px: centre,
        rotation_axis_px: from_centre(settings.axis_offset_px),
        camera_mm: settings.camera_distance_mm,
        light_mm: settings.light_distance_mm,
    }
}

impl Camera for SimulatedCamera {
    fn describe(&self) -> String {
        format!(
            "simulated camera, {} × {} pixels, {} bit, seed {}",
            self.settings.width_px,
            self.settings.height_px,
            self.settings.bit_depth,
            self.settings.seed
        )
    }

    fn capture<'a>(
        &'a mut self,
        request: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>> {
        Box::pin(async move {
            let exposure_s = request.exposure_s;
            if !(exposure_s.is_finite() && (0.0..=3600.0).contains(&exposure_s)) {
                return Err(CameraError::Failed(format!(
                    "an exposure of {exposure_s} s is out of its range of 0 to 3600 s"
                )));
            }
            let started_at = self.clock.now();
            let started_utc = self.clock.utc();
            let mut moments = vec![self.seen_now()];
            for glance in 1..=GLANCES {
                let due = started_at
                    + Duration::from_secs_f64(exposure_s * f64::from(glance) / f64::from(GLANCES));
                if let Some(left) = due.checked_sub(self.clock.now())
                    && !left.is_zero()
                {
                    self.clock.sleep(left).await;
                }
                moments.push(self.seen_now());
            }
            let radiance = self.radiance(&moments);
            self.captures += 1;
            // Without this, exposures shorter than the painting would starve all other tasks.
            tokio::task::yield_now().await;
            let frame = paint(
                &self.settings,
                &self.pixels,
                &radiance,
                exposure_s,
                self.captures,
            )?;
            let tag = FrameTag {
                counter: Some(self.captures),
                exposure_start: Some(started_utc),
                exposure_s: Some(exposure_s),
                gain: Some(self.settings.gain_dn_per_electron),
                serial: Some(format!("simulated-{}", self.settings.seed)),
                temperature_c: None,
            };
            Ok(Captured {
                frame,
                started_at,
                started_utc,
                tag,
            })
        })
    }
}

/// The camera's fixed pattern, equal in all frames.
fn fixed_pattern(settings: &SimulatedCameraSettings) -> Arc<[Pixel]> {
    let mut rng = Pcg64::seed_from_u64(settings.seed ^ 0x70A7_7E12);
    let (width, height) = (settings.width_px as usize, settings.height_px as usize);
    let full = full_dn(settings);
    (0..width * height)
        .map(|pixel| {
            // Distance from the centre, 1 at the middle of an edge.
            let x = 2.0 * ((pixel % width) as f64 + 0.5) / width as f64 - 1.0;
            let y = 2.0 * ((pixel / width) as f64 + 0.5) / height as f64 - 1.0;
            let vignetting = 1.0 - settings.vignetting_at_edge * (x * x + y * y);
            let response: f64 = StandardNormal.sample(&mut rng);
            let offset: f64 = StandardNormal.sample(&mut rng);
            let fate: f64 = rng.random();
            Pixel {
                response: (vignetting * (1.0 + settings.prnu_rms * response)).max(0.0),
                offset_dn: settings.dsnu_dn_rms * offset,
                stuck_dn: if fate < 0.5 * settings.defect_fraction {
                    Some(full)
                } else if fate < settings.defect_fraction {
                    Some(0)
                } else {
                    None
                },
            }
        })
        .collect()
}

fn full_dn(settings: &SimulatedCameraSettings) -> u16 {
    ((1_u32 << settings.bit_depth.clamp(1, 16)) - 1) as u16
}

fn paint(
    settings: &SimulatedCameraSettings,
    pixels: &[Pixel],
    radiance: &PixelLight,
    exposure_s: f64,
    capture: u64,
) -> Result<Frame, CameraError> {
    let mut rng = Pcg64::seed_from_u64(
        settings
            .seed
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .wrapping_add(capture),
    );
    let full = full_dn(settings);
    let dark = settings.dark_current_electrons_per_s * exposure_s;
    let electrons = settings.electrons_per_radiance_second * exposure_s;
    let counts = pixels
        .iter()
        .enumerate()
        .map(|(at, pixel)| {
            let due = (radiance.at(at) * electrons * pixel.response + dark).max(0.0);
            let read: f64 = StandardNormal.sample(&mut rng);
            let electrons = if due > NORMAL_FROM {
                let shot: f64 = StandardNormal.sample(&mut rng);
                due + due.sqrt() * shot
            } else {
                // An expectation of 0 has no distribution and gives no electrons.
                Poisson::new(due).map_or(0.0, |p| p.sample(&mut rng))
            };
            let dn = settings.black_level_dn
                + pixel.offset_dn
                + settings.gain_dn_per_electron
                    * (electrons + settings.read_noise_electrons_rms * read);
            pixel
                .stuck_dn
                .unwrap_or_else(|| dn.round().clamp(0.0, f64::from(full)) as u16)
        })
        .collect();
    Ok(Frame::new(settings.width_px, settings.height_px, counts)?)
}

/// The manifest of a series taken with such a camera, rig and sample.
#[must_use]
pub fn manifest(
    settings: &SimulatedCameraSettings,
    rig: &RigGeometry,
    sample: &SimulatedSample,
) -> Manifest {
    let material = sample.material();
    let (kind, index, eta, k) = match material {
        Material::Dielectric { eta, eta_std } => {
            (SampleKind::Dielectric, Some((eta, eta_std)), None, None)
        }
        Material::Conductor {
            eta,
            k,
            eta_std,
            k_std,
        } => (
            SampleKind::Conductor,
            None,
            Some((eta, eta_std)),
            Some((k, k_std)),
        ),
    };
    let value = |pair: Option<(f64, f64)>| pair.map(|p| p.0);
    let std = |pair: Option<(f64, f64)>| pair.map(|p| p.1);
    let imaging = imaging(settings, rig);
    let distance = |mm: Option<f64>| match mm {
        Some(_) => Some("finite".to_owned()),
        None => Some("infinity".to_owned()),
    };
    let field_height_mm =
        settings.field_width_mm * f64::from(settings.height_px) / f64::from(settings.width_px);
    Manifest {
        schema: SCHEMA.to_owned(),
        name: sample.name(),
        frames: "frames.csv".to_owned(),
        notes: [("origin".to_owned(), "simulated rig".into())].into(),
        rig: RigFacts {
            theta_l_deg: rig.theta_l.deg(),
            light_azimuth_deg: rig.light_azimuth.deg(),
            azimuth_zero_deg: rig.azimuth_zero.deg(),
            azimuth_zero_std_deg: None,
            light_angular_radius_deg: Some(rig.cones.lamp.deg()),
            wavelength_nm: Some(550.0),
            tilt_centre_px: Some(imaging.tilt_centre_px),
            rotation_axis_px: Some(imaging.rotation_axis_px),
            light_distance: distance(settings.light_distance_mm),
            camera_distance: distance(settings.camera_distance_mm),
            light_distance_mm: settings.light_distance_mm,
            lens_angular_radius_deg: Some(rig.cones.lens.deg()).filter(|deg| *deg > 0.0),
            light_radius_mm: None,
            sample_wedge_std_deg: None,
            theta_l_std_deg: None,
            theta_c_std_deg: Some(0.02),
            phi_s_std_deg: Some(0.02),
            lamp_drift_std: Some(1e-3),
            lens_radius_mm: None,
            camera_distance_mm: settings.camera_distance_mm,
            notes: Default::default(),
        },
        camera: CameraFacts {
            projection: match settings.camera_distance_mm {
                Some(_) => "perspective".to_owned(),
                None => "orthographic".to_owned(),
            },
            width_px: settings.width_px,
            height_px: settings.height_px,
            field_width_mm: Some(settings.field_width_mm),
            field_height_mm: Some(field_height_mm),
            bit_depth: Some(settings.bit_depth),
            saturation_dn: Some(f64::from(full_dn(settings))),
            gain_dn_per_electron: settings.gain_dn_per_electron,
            black_level_dn: Some(settings.black_level_dn),
            read_noise_electrons_rms: Some(settings.read_noise_electrons_rms),
            exposures_s: settings.exposures_s.clone(),
            camera_distance_mm: None,
            principal_point_px: None,
            exposure_rel_std: None,
            notes: Default::default(),
        },
        flat: Some(FlatFacts {
            reflectance: Some(settings.reflectance),
            reflectance_std: Some(settings.reflectance_std),
            notes: Default::default(),
        }),
        dark: Some(DarkFacts::default()),
        sample: SampleFacts {
            metal: None,
            kind,
            index_of_refraction: value(index),
            index_of_refraction_std: std(index),
            eta: value(eta),
            k: value(k),
            eta_std: std(eta),
            k_std: std(k),
            pitch_length_um: Some(100.0),
            translucency: None,
            translucency_std: None,
            notes: Default::default(),
            layout: None,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::SteppedClock;
    use crate::frame::FrameKind;
    use crate::sim::world::{Mounting, WorldSettings};
    use crate::units::Angle;

    fn request(kind: FrameKind, pose: Pose, exposure_s: f64) -> CaptureRequest {
        CaptureRequest {
            kind,
            pose,
            exposure_s,
            repeat: 0,
        }
    }

    fn bench(mounting: Mounting, seed: u64) -> (Arc<World>, SimulatedCamera) {
        let clock = Arc::new(SteppedClock::new());
        let settings = WorldSettings {
            mounting,
            ..WorldSettings::default()
        };
        let world = Arc::new(World::new(clock.clone(), settings));
        let camera = SimulatedCamera::new(
            Arc::clone(&world),
            SimulatedCameraSettings {
                seed,
                ..SimulatedCameraSettings::default()
            },
            SimulatedSample::polymer_10(),
            clock,
        );
        (world, camera)
    }

    async fn mean_above_dark(camera: &mut SimulatedCamera, world: &World, pose: Pose) -> f64 {
        world.set_pose(pose);
        let mean = |frame: &Frame| {
            let dn = frame.pixels_dn().iter().map(|d| f64::from(*d));
            dn.sum::<f64>() / frame.pixels_dn().len() as f64
        };
        world.cap_lens(true);
        let dark = camera.capture(&request(FrameKind::Dark, pose, 0.02)).await;
        world.cap_lens(false);
        let seen = camera
            .capture(&request(FrameKind::Sample, pose, 0.02))
            .await;
        mean(&seen.unwrap().frame) - mean(&dark.unwrap().frame)
    }

    #[tokio::test]
    async fn a_frame_shows_the_true_pose_not_the_requested_one() {
        let (world, mut camera) = bench(Mounting::default(), 1);
        let straight = mean_above_dark(&mut camera, &world, Pose::from_deg(10.4, 7.0)).await;
        let mounting = Mounting {
            azimuth_offset: Angle::from_deg(7.0),
            tilt_offset: Angle::from_deg(0.4),
            ..Mounting::default()
        };
        let (world, mut camera) = bench(mounting, 1);
        let offset = mean_above_dark(&mut camera, &world, Pose::from_deg(10.0, 0.0)).await;
        let plain = mean_above_dark(&mut camera, &world, Pose::from_deg(10.4, 7.0)).await;
        // 128² pixels of ~8,000 electrons: the mean is accurate to 1e-4.
        assert!(
            (offset / straight - 1.0).abs() < 5e-4,
            "{offset} {straight}"
        );
        assert!((plain / straight - 1.0).abs() > 5e-3, "{plain} {straight}");
    }

    #[tokio::test]
    async fn a_frame_shows_what_is_in_front_of_the_lens() {
        let (world, mut camera) = bench(Mounting::default(), 1);
        let pose = Pose::from_deg(0.0, 180.0);
        let sample = mean_above_dark(&mut camera, &world, pose).await;
        world.place(OnTable::WhiteReference);
        let white = mean_above_dark(&mut camera, &world, pose).await;
        let due = 0.99 / std::f64::consts::PI * 10_f64.to_radians().cos();
        let seen = camera
            .sample_handle()
            .get()
            .radiance(&RigGeometry::IN_PLANE, pose);
        let stray = camera.settings.stray_radiance;
        let ratio = (due + stray) / (seen + stray);
        assert!((white / sample / ratio - 1.0).abs() < 1e-3);
        world.place(OnTable::Sample);
        camera.sample_handle().set(SimulatedSample::steel_15());
        let steel = mean_above_dark(&mut camera, &world, pose).await;
        assert!((steel / sample - 1.0).abs() > 0.1);
    }

    #[tokio::test]
    async fn equal_seeds_paint_equal_frames_and_different_seeds_do_not() {
        let mut frames = Vec::new();
        for seed in [1, 1, 2] {
            let (world, mut camera) = bench(Mounting::default(), seed);
            let pose = Pose::from_deg(5.0, 30.0);
            world.set_pose(pose);
            for _ in 0..2 {
                let asked = request(FrameKind::Sample, pose, 0.02);
                frames.push(camera.capture(&asked).await.unwrap().frame);
            }
        }
        assert_eq!(frames[0], frames[2]);
        assert_eq!(frames[1], frames[3]);
        assert_ne!(frames[0], frames[1]);
        assert_ne!(frames[0], frames[4]);
    }

    #[tokio::test]
    async fn an_exposure_takes_its_time_and_an_invalid_one_is_refused() {
        let (_, mut camera) = bench(Mounting::default(), 1);
        let pose = Pose::from_deg(0.0, 0.0);
        let first = camera.capture(&request(FrameKind::Sample, pose, 0.5)).await;
        let second = camera.capture(&request(FrameKind::Sample, pose, 0.5)).await;
        let apart = second.unwrap().started_at - first.unwrap().started_at;
        assert!((apart.as_secs_f64() - 0.5).abs() < 1e-6);
        for exposure_s in [f64::NAN, -1.0, 1e9] {
            let asked = request(FrameKind::Sample, pose, exposure_s);
            assert!(matches!(
                camera.capture(&asked).await,
                Err(CameraError::Failed(_))
            ));
        }
    }

    #[test]
    fn its_manifest_is_a_series_manifest() {
        for name in super::super::sample::NAMES {
            let sample = SimulatedSample::by_name(name).unwrap();
            let stated = manifest(
                &SimulatedCameraSettings::default(),
                &RigGeometry::IN_PLANE,
                &sample,
            );
            let read = Manifest::from_toml(&stated.to_toml(), "manifest.toml").unwrap();
            assert_eq!(read, stated);
            assert_eq!(read.material(), sample.material());
        }
    }
}
