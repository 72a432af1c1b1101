//! The simulated rig behind `serve --simulated-rig`, `scan --simulated-rig` and `demo`: one world,
//! seen by a controller on a pseudo-terminal and by a camera, and the hands that act in it.
//!
//! The daemon reaches the stages through the pseudo-terminal and the protocol alone, as on a bench.

use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

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
use crate::sim::sample::Sample;
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
}

impl Default for Simulation {
    fn default() -> Self {
        Simulation {
            time_scale: 1.0,
            seed: 1,
            azimuth_offset: Angle::ZERO,
            tilt_offset: Angle::ZERO,
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
        } = simulation;
        check_time_scale(time_scale, TIME_SCALES)?;
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
                seed,
                ..SimulatedCameraSettings::default()
            },
            Sample::polymer_10(),
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
fn painted(surface: Option<SimulatedSurface>, material: Material) -> Sample {
    match surface {
        None | Some(SimulatedSurface::Traced) => Sample::polymer_10(),
        Some(SimulatedSurface::Model {
            theta_r_deg,
            alpha_u,
            alpha_v,
            rho_d,
        }) => Sample::Model {
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
            "simulated, {}, seed {}, offsets {:.6} {:.6}",
            camera.describe(),
            simulation.seed,
            simulation.azimuth_offset,
            simulation.tilt_offset
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
