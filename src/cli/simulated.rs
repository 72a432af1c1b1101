//! The simulated rig behind `serve --simulated-rig`, `scan --simulated-rig` and `demo`: one world,
//! seen by a controller on a pseudo-terminal and by a camera, and the hands that act in it.
//!
//! The daemon reaches the stages through the pseudo-terminal and the protocol alone, as on a bench.

use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Rotation3, Vector3};

use super::CliError;
use super::daemon::{capped_limit, runner_settings, watch_scan_steps};
use crate::bench::Camera;
use crate::bench::stage::{NoFaults, PortAddress, StageSettings};
use crate::clock::{Clock, ScaledClock};
use crate::config::{CameraSettings, Config};
use crate::lab::{Lab, LabError, RigParts, RigSettings};
use crate::material::Material;
use crate::model::{Surface, Variant};
use crate::scan::plan::PlanDefaults;
use crate::scan::runner::Order;
use crate::scan::{OperatorAction, Rig, StageLink};
use crate::sim::camera::{SampleHandle, SimulatedCamera, SimulatedCameraSettings};
use crate::sim::controller::Controller;
use crate::sim::sample::SimulatedSample;
use crate::sim::server::{PtyServer, serve_pty};
use crate::sim::world::{Mounting, OnTable, World, WorldSettings};
use crate::store::samples::{NewSample, SimulatedSurface};
use crate::units::Angle;

/// How much faster than life a rig may be simulated: a scan sleeps and polls, and needs to keep up.
const TIME_SCALES: RangeInclusive<f64> = 0.01..=1000.0;

/// Refuses what is no scale of time.
///
/// # Errors
/// Bad input, with what is allowed.
pub(super) fn check_time_scale(
    time_scale: f64,
    allowed: RangeInclusive<f64>,
) -> Result<(), CliError> {
    if allowed.contains(&time_scale) {
        return Ok(());
    }
    let (least, most) = allowed.into_inner();
    Err(CliError::bad_input(anyhow::anyhow!(
        "--time-scale is {time_scale}; it must be within {least} to {most}"
    )))
}

/// How a simulated rig is built: near or far, and what is off its place. Distances and points stand in the manifests of its
/// scans; how the sample lies does not.
#[derive(Debug, Clone, Copy, PartialEq, Default, clap::Args)]
#[command(next_help_heading = "How the simulated rig is built")]
pub struct Built {
    /// Distance of the camera's pupil from the centre of tilt, 100 mm or more; a telecentric lens without it.
    #[arg(long, value_name = "MM")]
    pub camera_distance_mm: Option<f64>,
    /// Distance of the lamp from the centre of tilt, 100 mm or more; a collimated one without it.
    #[arg(long, value_name = "MM")]
    pub light_distance_mm: Option<f64>,
    /// From the frame's centre to the rotation axis, in pixels, such as -6,4.5.
    #[arg(long, value_name = "COLUMNS,ROWS", value_parser = point, allow_hyphen_values = true)]
    pub axis_offset_px: Option<Point>,
    /// From the frame's centre to the centre of tilt, in pixels.
    #[arg(long, value_name = "COLUMNS,ROWS", value_parser = point, allow_hyphen_values = true)]
    pub tilt_centre_offset_px: Option<Point>,
    /// How far the sample's plane is inclined to the turntable, up to 5°.
    #[arg(long, value_name = "DEG")]
    pub wedge_deg: Option<f64>,
    /// Where its normal is inclined to, from the lean direction v, in degrees.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub wedge_azimuth_deg: Option<f64>,
}

/// Columns and rows.
pub type Point = [f64; 2];

fn point(text: &str) -> Result<Point, String> {
    let numbers: Vec<Option<f64>> = text.split(',').map(|x| x.trim().parse().ok()).collect();
    match numbers[..] {
        [Some(column), Some(row)] => Ok([column, row]),
        _ => Err("write columns and rows with a comma between them, such as -6,4.5".to_owned()),
    }
}

/// Nearer the field would be as wide as the camera is far, mm.
const DISTANCES_MM: RangeInclusive<f64> = 100.0..=1e6;
/// Columns or rows from the frame's centre.
const OFFSETS_PX: RangeInclusive<f64> = -1000.0..=1000.0;
const WEDGES_DEG: RangeInclusive<f64> = 0.0..=5.0;
const TURN_DEG: RangeInclusive<f64> = -360.0..=360.0;

impl Built {
    fn check(&self) -> Result<(), CliError> {
        let of = |point: Option<Point>, k: usize| point.map(|p| p[k]);
        for (name, value, range) in [
            ("camera-distance-mm", self.camera_distance_mm, DISTANCES_MM),
            ("light-distance-mm", self.light_distance_mm, DISTANCES_MM),
            ("axis-offset-px", of(self.axis_offset_px, 0), OFFSETS_PX),
            ("axis-offset-px", of(self.axis_offset_px, 1), OFFSETS_PX),
            (
                "tilt-centre-offset-px",
                of(self.tilt_centre_offset_px, 0),
                OFFSETS_PX,
            ),
            (
                "tilt-centre-offset-px",
                of(self.tilt_centre_offset_px, 1),
                OFFSETS_PX,
            ),
            ("wedge-deg", self.wedge_deg, WEDGES_DEG),
            ("wedge-azimuth-deg", self.wedge_azimuth_deg, TURN_DEG),
        ] {
            if let Some(value) = value.filter(|value| !range.contains(value)) {
                let (least, most) = range.into_inner();
                return Err(CliError::bad_input(anyhow::anyhow!(
                    "--{name} {value} is not within {least} to {most}"
                )));
            }
        }
        Ok(())
    }

    fn wedge(&self) -> (Angle, Angle) {
        let angle = |deg: Option<f64>| Angle::from_deg(deg.unwrap_or_default());
        (angle(self.wedge_deg), angle(self.wedge_azimuth_deg))
    }

    /// What a wedge adds to the angles of ridges to the turntable: (ridge angle, azimuth).
    #[must_use]
    pub fn wedge_on(&self, theta_r: Angle) -> (Angle, Angle) {
        let (wedge, towards) = self.wedge();
        let ((sin, cos), (lean, up)) = (towards.sin_cos(), theta_r.sin_cos());
        // The facets' normal, v along x, as it is carried along.
        let turn = Rotation3::new(Vector3::new(-sin, cos, 0.0) * wedge.rad());
        let facet = turn * Vector3::new(lean, 0.0, up);
        (
            Angle::from_rad(facet.x.hypot(facet.y).atan2(facet.z)) - theta_r,
            Angle::from_rad(facet.y.atan2(facet.x)),
        )
    }
}

/// What may be different about a simulated rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Simulation {
    /// How much faster than life.
    pub time_scale: f64,
    /// Seed of the noise, the fixed pattern and the mechanics.
    pub seed: u64,
    /// True minus recorded azimuth.
    pub azimuth_offset: Angle,
    /// True minus recorded tilt.
    pub tilt_offset: Angle,
    /// Where its parts are.
    pub built: Built,
}

impl Default for Simulation {
    fn default() -> Self {
        Simulation {
            time_scale: 1.0,
            seed: 1,
            azimuth_offset: Angle::ZERO,
            tilt_offset: Angle::ZERO,
            built: Built::default(),
        }
    }
}

/// A simulated rig; it is there as long as this value is.
pub struct SimulatedRig {
    /// Its time.
    pub clock: Arc<dyn Clock>,
    /// Axes, table and lens cap.
    pub world: Arc<World>,
    on_table: SampleHandle,
    _controller: PtyServer,
}

/// Names of the samples that a fresh store gets beside a simulated rig.
pub const TRACED_SAMPLE: &str = "traced polymer";
const MODEL_SAMPLE: &str = "model 15°";

const POLYMER: Material = Material::Dielectric {
    eta: 1.54,
    eta_std: 0.005,
};

impl SimulatedRig {
    /// Builds world, controller and camera, with real time run at the time scale.
    ///
    /// # Errors
    /// No result if the system has no pseudo-terminal; bad input for a time scale or offsets that
    /// make no sense.
    pub fn build(simulation: Simulation) -> Result<(SimulatedRig, RigParts), CliError> {
        SimulatedRig::with_clock(
            simulation,
            Arc::new(ScaledClock::new(simulation.time_scale)),
        )
    }

    /// The same on a clock of the caller's.
    ///
    /// # Errors
    /// As [`SimulatedRig::build`].
    pub fn with_clock(
        simulation: Simulation,
        clock: Arc<dyn Clock>,
    ) -> Result<(SimulatedRig, RigParts), CliError> {
        let Simulation {
            time_scale,
            seed,
            azimuth_offset,
            tilt_offset,
            built,
        } = simulation;
        check_time_scale(time_scale, TIME_SCALES)?;
        built.check()?;
        let (wedge, wedge_azimuth) = built.wedge();
        for (name, angle, max_deg) in [
            ("--azimuth-offset-deg", azimuth_offset, 180.0),
            ("--tilt-offset-deg", tilt_offset, 5.0),
        ] {
            if !angle.is_finite() || angle.abs() > Angle::from_deg(max_deg) {
                return Err(CliError::bad_input(anyhow::anyhow!(
                    "{name} {} is not within −{max_deg} to {max_deg}",
                    angle.deg_for_tables()
                )));
            }
        }
        let world = Arc::new(World::new(
            Arc::clone(&clock),
            WorldSettings {
                mounting: Mounting {
                    azimuth_offset,
                    tilt_offset,
                    wedge,
                    wedge_azimuth,
                },
                seed,
                ..WorldSettings::default()
            },
        ));
        let controller = serve_pty(Controller::new(&world)).map_err(|error| {
            CliError::no_result(anyhow::anyhow!(
                "the system gives no pseudo-terminal for the simulated rig: {error}"
            ))
        })?;
        let camera = SimulatedCamera::new(
            Arc::clone(&world),
            SimulatedCameraSettings {
                camera_distance_mm: built.camera_distance_mm,
                light_distance_mm: built.light_distance_mm,
                tilt_centre_offset_px: built.tilt_centre_offset_px.unwrap_or_default(),
                axis_offset_px: built.axis_offset_px.unwrap_or_default(),
                seed,
                ..SimulatedCameraSettings::default()
            },
            SimulatedSample::polymer_10(),
            Arc::clone(&clock),
        );
        let on_table = camera.sample_handle();
        let settings = settings(&camera, simulation);
        let link = StageLink {
            port: PortAddress::Serial {
                path: controller.path().to_owned(),
            },
            settings: StageSettings::simulated(),
            clock: Arc::clone(&clock),
            seam: Arc::new(NoFaults),
        };
        let parts = RigParts {
            rig: Rig::new(link, Box::new(camera)),
            settings,
        };
        let rig = SimulatedRig {
            clock,
            world,
            on_table,
            _controller: controller,
        };
        Ok((rig, parts))
    }

    /// Gives a store without samples the two that the simulated rig can show at once.
    ///
    /// # Errors
    /// What the store says.
    pub async fn stock(&self, lab: &Lab) -> Result<(), LabError> {
        if lab.store().newest_sample(None, |_| true).await?.is_some() {
            return Ok(());
        }
        let model = SimulatedSurface::Model {
            theta_r_deg: 15.0,
            alpha_u: 0.10,
            alpha_v: 0.10,
            rho_d: 0.30,
        };
        for (name, surface) in [
            (MODEL_SAMPLE, model),
            (TRACED_SAMPLE, SimulatedSurface::Traced),
        ] {
            lab.store()
                .add_sample(&NewSample {
                    name: name.into(),
                    material: POLYMER,
                    note: None,
                    simulated: Some(surface),
                })
                .await?;
        }
        Ok(())
    }

    /// Starts the hands: whenever a scan waits for a person they do at once, in the world, what it
    /// asks for. With `and_continue` they also say so; else the scan waits for a person's word.
    pub fn hands(&self, lab: &Lab, and_continue: bool) -> tokio::task::JoinHandle<()> {
        let world = Arc::clone(&self.world);
        let on_table = self.on_table.clone();
        let lab = lab.clone();
        tokio::spawn(async move {
            let mut steps = watch_scan_steps(&lab);
            while let Some((scan_id, action)) = steps.recv().await {
                act(&lab, &world, &on_table, scan_id, action).await;
                if and_continue {
                    let continued = lab.order(scan_id, Order::Continue).await;
                    if let Err(error) = continued {
                        tracing::debug!(scan_id, %error, "nothing to continue: {error}");
                    }
                }
            }
        })
    }
}

async fn act(
    lab: &Lab,
    world: &World,
    on_table: &SampleHandle,
    scan_id: i64,
    action: OperatorAction,
) {
    match action {
        OperatorAction::CapLens => world.cap_lens(true),
        OperatorAction::PlaceWhiteReference => {
            world.cap_lens(false);
            world.place(OnTable::WhiteReference);
        }
        OperatorAction::PlaceSample => {
            let sample = async {
                let scan = lab.store().scan(scan_id).await?;
                lab.store().sample(scan.sample_id).await
            };
            match sample.await {
                Ok(sample) => on_table.set(painted(sample.simulated, sample.material)),
                Err(error) => tracing::warn!(%error, "the sample is not known: {error}"),
            }
            world.cap_lens(false);
            world.place(OnTable::Sample);
        }
    }
}

/// What a sample of the store looks like to the simulated camera.
fn painted(surface: Option<SimulatedSurface>, material: Material) -> SimulatedSample {
    match surface {
        None | Some(SimulatedSurface::Traced) => SimulatedSample::polymer_10(),
        Some(SimulatedSurface::Model {
            theta_r_deg,
            alpha_u,
            alpha_v,
            rho_d,
        }) => SimulatedSample::Model {
            variant: Variant::Sawtooth,
            surface: Surface {
                theta_r: theta_r_deg.to_radians(),
                alpha_u,
                alpha_v,
                rho_d,
                amplitude: 1.0,
            },
            material,
        },
    }
}

/// What the settings say of scans, calibrations and the disk. Stages, geometry, camera and white reference
/// are the simulated ones.
pub fn obey(settings: &mut RigSettings, config: &Config) {
    let Config {
        camera,
        flat,
        dark,
        scan,
        store,
        ..
    } = config;
    let hours = |h: f64| Duration::from_secs_f64(h * 3600.0);
    settings.runner = runner_settings(
        &settings.camera,
        scan.attempts_max,
        store.reserve_mb,
        capped_limit(config),
    );
    settings.dark_valid = hours(dark.valid_h);
    settings.flat_valid = hours(flat.valid_h);
    settings.defaults.dark_repeats = dark.repeats;
    settings.defaults.flat_repeats = flat.repeats;
    // Where they say nothing the simulated camera knows better.
    if camera.exposures_s != CameraSettings::default().exposures_s {
        settings
            .defaults
            .exposures_s
            .clone_from(&camera.exposures_s);
        settings
            .defaults
            .flat_exposures_s
            .clone_from(&camera.exposures_s);
    }
    if let Some(exposures_s) = &flat.exposures_s {
        settings.defaults.flat_exposures_s.clone_from(exposures_s);
    }
}

fn settings(camera: &SimulatedCamera, simulation: Simulation) -> RigSettings {
    let manifest = camera.manifest();
    let exposures_s = manifest.camera.exposures_s.clone();
    RigSettings {
        defaults: PlanDefaults {
            flat_exposures_s: exposures_s.clone(),
            exposures_s,
            dark_repeats: 4,
            flat_repeats: 1,
        },
        runner: runner_settings(&manifest.camera, 3, 200, capped_limit(&Config::default())),
        rig: manifest.rig,
        camera: manifest.camera,
        flat: manifest
            .flat
            .expect("the simulated rig has a white reference"),
        dark_valid: Duration::from_secs(24 * 3600),
        flat_valid: Duration::from_secs(24 * 3600),
        simulated: Some(simulation.time_scale),
        // Another world is another rig: its calibrations do not count here.
        label: format!(
            "simulated, {}, seed {}, offsets {:.6} {:.6}{}",
            camera.describe(),
            simulation.seed,
            simulation.azimuth_offset,
            simulation.tilt_offset,
            match simulation.built {
                usual if usual == Built::default() => String::new(),
                built => format!(", {built:?}"),
            }
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wedge_is_ridge_angle_along_v_and_azimuth_across() {
        let built = Built {
            wedge_deg: Some(0.2),
            wedge_azimuth_deg: Some(200.0),
            ..Built::default()
        };
        // As the path-traced series near-off-axis has it.
        let (steeper, turned) = built.wedge_on(Angle::from_deg(9.0));
        assert!((steeper.deg() + 0.188).abs() < 5e-4, "{}", steeper.deg());
        assert!((turned.deg() + 0.441).abs() < 5e-4, "{}", turned.deg());
        let flat = Built::default().wedge_on(Angle::from_deg(9.0));
        assert!(flat.0.abs().deg() < 1e-12 && flat.1 == Angle::ZERO);
    }

    #[test]
    fn a_rig_that_cannot_be_built_is_refused_by_its_option() {
        let refused = |built: Built| {
            let simulation = Simulation {
                built,
                ..Simulation::default()
            };
            match SimulatedRig::build(simulation) {
                Err(CliError::BadInput(error)) => error.to_string(),
                _ => panic!("it was built"),
            }
        };
        let near = refused(Built {
            camera_distance_mm: Some(20.0),
            ..Built::default()
        });
        assert!(near.contains("--camera-distance-mm 20"), "{near}");
        let wild = refused(Built {
            axis_offset_px: Some([0.0, f64::NAN]),
            ..Built::default()
        });
        assert!(wild.contains("--axis-offset-px"), "{wild}");
        assert_eq!(point("-6, 4.5"), Ok([-6.0, 4.5]));
        assert!(point("6").is_err() && point("a,b").is_err() && point("1,2,3").is_err());
    }

    #[test]
    fn settings_count_beside_a_simulated_rig_and_without_any_it_is_as_ever() {
        let (_rig, mut parts) = SimulatedRig::build(Simulation::default()).unwrap();
        let untouched = parts.settings.clone();
        obey(&mut parts.settings, &Config::default());
        assert_eq!(parts.settings.defaults, untouched.defaults);
        assert_eq!(parts.settings.runner, untouched.runner);
        let mut config = Config::default();
        config.store.reserve_mb = 5000;
        config.scan.attempts_max = 7;
        config.dark.repeats = 9;
        config.dark.valid_h = 2.0;
        config.flat.exposures_s = Some(vec![0.5]);
        obey(&mut parts.settings, &config);
        let RigSettings {
            runner,
            defaults,
            dark_valid,
            ..
        } = &parts.settings;
        assert_eq!(runner.disk_reserve_bytes, 5_000_000_000);
        assert_eq!(runner.attempts_max, 7);
        assert_eq!(defaults.dark_repeats, 9);
        assert_eq!(defaults.flat_exposures_s, [0.5]);
        assert_eq!(defaults.exposures_s, untouched.defaults.exposures_s);
        assert_eq!(dark_valid.as_secs(), 7200);
        // The rig stays the simulated one.
        assert_eq!(parts.settings.camera, untouched.camera);
        assert_eq!(parts.settings.rig, untouched.rig);
    }
}
