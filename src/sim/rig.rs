//! A whole simulated rig: one world, the controller on a pseudo-terminal, the camera, and the link through which the
//! daemon reaches the stages.
//!
//! [`SimulatedRig::build`] gives the rig and the parts that a lab takes. The lab reaches the stages only through the
//! pseudo-terminal and the protocol, as on a bench. What a person does at a real rig is done by the simulated
//! [`operator`](super::operator).

use std::ops::RangeInclusive;
use std::sync::Arc;

use nalgebra::{Rotation3, Vector3};

use super::camera::{SampleHandle, SimulatedCamera, SimulatedCameraSettings};
use super::controller::Controller;
use super::faults::FaultySeam;
use super::faults::camera::FaultyCamera;
use super::faults::injector::FaultInjector;
use super::faults::plan::FaultPlan;
use super::sample::SimulatedSample;
use super::server::{PtyServer, serve_pty};
use super::world::{Mounting, World, WorldSettings};
use crate::bench::Camera;
use crate::bench::stage::{NoFaults, PortAddress, StageSettings};
use crate::clock::{Clock, ScaledClock};
use crate::lab::{RigParts, RigSettings};
use crate::scan::{Rig, StageLink};
use crate::units::Angle;

/// How much faster than real time a whole rig may run: a scan sleeps and polls, and needs to keep up.
const TIME_SCALES: RangeInclusive<f64> = 0.01..=1000.0;
/// How much faster than real time a controller without a scan may run: it only answers.
pub const TIME_SCALES_OF_CONTROLLER: RangeInclusive<f64> = 1e-3..=1e6;
/// Distances of camera and lamp, mm. Nearer, the field would be as wide as the camera is far.
const DISTANCES_MM: RangeInclusive<f64> = 100.0..=1e6;
/// Offsets from the frame's centre, in columns or rows.
const OFFSETS_PX: RangeInclusive<f64> = -1000.0..=1000.0;
const WEDGES_DEG: RangeInclusive<f64> = 0.0..=5.0;
const TURN_DEG: RangeInclusive<f64> = -360.0..=360.0;
const AZIMUTH_OFFSETS_DEG: RangeInclusive<f64> = -180.0..=180.0;
const TILT_OFFSETS_DEG: RangeInclusive<f64> = -5.0..=5.0;

/// Why a simulated rig cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// A value is out of range.
    #[error("{setting} {value} is out of range: expected {least} to {most}")]
    OutOfRange {
        /// Name of the value, for example `camera_distance_mm`.
        setting: &'static str,
        /// The value as given.
        value: f64,
        /// Least allowed value.
        least: f64,
        /// Largest allowed value.
        most: f64,
    },
    /// The system has no pseudo-terminal.
    #[error("the system gives no pseudo-terminal for the simulated rig: {0}")]
    NoPseudoTerminal(std::io::Error),
}

/// Refuses a value outside its range.
///
/// # Errors
/// [`SimulationError::OutOfRange`] with the name of the value.
pub fn check_range(
    setting: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
) -> Result<(), SimulationError> {
    if range.contains(&value) {
        return Ok(());
    }
    let (least, most) = range.into_inner();
    Err(SimulationError::OutOfRange {
        setting,
        value,
        least,
        most,
    })
}

/// Where the parts of a simulated rig are. The manifests of its scans state distances and points; they do not state
/// how the sample is mounted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Construction {
    /// Distance of the camera's pupil from the centre of tilt, mm; a telecentric lens if not given.
    pub camera_distance_mm: Option<f64>,
    /// Distance of the lamp from the centre of tilt, mm; a collimated lamp if not given.
    pub light_distance_mm: Option<f64>,
    /// From the frame's centre to the rotation axis: columns, rows.
    pub axis_offset_px: Option<[f64; 2]>,
    /// From the frame's centre to the centre of tilt: columns, rows.
    pub tilt_centre_offset_px: Option<[f64; 2]>,
    /// Inclination of the sample's plane to the turntable, degrees.
    pub wedge_deg: Option<f64>,
    /// Azimuth to which its normal is inclined, from the lean direction v, degrees.
    pub wedge_azimuth_deg: Option<f64>,
}

impl Construction {
    fn check(&self) -> Result<(), SimulationError> {
        let of = |point: Option<[f64; 2]>, k: usize| point.map(|p| p[k]);
        let (axis, tilt) = (self.axis_offset_px, self.tilt_centre_offset_px);
        for (setting, value, range) in [
            ("camera_distance_mm", self.camera_distance_mm, DISTANCES_MM),
            ("light_distance_mm", self.light_distance_mm, DISTANCES_MM),
            ("axis_offset_px", of(axis, 0), OFFSETS_PX),
            ("axis_offset_px", of(axis, 1), OFFSETS_PX),
            ("tilt_centre_offset_px", of(tilt, 0), OFFSETS_PX),
            ("tilt_centre_offset_px", of(tilt, 1), OFFSETS_PX),
            ("wedge_deg", self.wedge_deg, WEDGES_DEG),
            ("wedge_azimuth_deg", self.wedge_azimuth_deg, TURN_DEG),
        ] {
            if let Some(value) = value {
                check_range(setting, value, range)?;
            }
        }
        Ok(())
    }

    fn wedge(&self) -> (Angle, Angle) {
        let angle = |deg: Option<f64>| Angle::from_deg(deg.unwrap_or_default());
        (angle(self.wedge_deg), angle(self.wedge_azimuth_deg))
    }

    /// Returns what the wedge adds to the angles of ridges relative to the turntable: (ridge angle, azimuth).
    #[must_use]
    pub fn wedge_on(&self, theta_r: Angle) -> (Angle, Angle) {
        let (wedge, towards) = self.wedge();
        let ((sin, cos), (lean, up)) = (towards.sin_cos(), theta_r.sin_cos());
        // The facets' normal, with v along x, turned with the sample.
        let turn = Rotation3::new(Vector3::new(-sin, cos, 0.0) * wedge.rad());
        let facet = turn * Vector3::new(lean, 0.0, up);
        (
            Angle::from_rad(facet.x.hypot(facet.y).atan2(facet.z)) - theta_r,
            Angle::from_rad(facet.y.atan2(facet.x)),
        )
    }
}

/// What may differ between simulated rigs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Simulation {
    /// How many times faster than real time it runs.
    pub time_scale: f64,
    /// Seed of the noise, the fixed pattern and the mechanics.
    pub seed: u64,
    /// True minus recorded azimuth.
    pub azimuth_offset: Angle,
    /// True minus recorded tilt.
    pub tilt_offset: Angle,
    /// Where its parts are.
    pub construction: Construction,
}

impl Default for Simulation {
    fn default() -> Self {
        Simulation {
            time_scale: 1.0,
            seed: 1,
            azimuth_offset: Angle::ZERO,
            tilt_offset: Angle::ZERO,
            construction: Construction::default(),
        }
    }
}

impl Simulation {
    fn check(&self) -> Result<(), SimulationError> {
        check_range("time_scale", self.time_scale, TIME_SCALES)?;
        self.construction.check()?;
        for (setting, angle, range) in [
            (
                "azimuth_offset_deg",
                self.azimuth_offset,
                AZIMUTH_OFFSETS_DEG,
            ),
            ("tilt_offset_deg", self.tilt_offset, TILT_OFFSETS_DEG),
        ] {
            check_range(setting, angle.deg_for_tables(), range)?;
        }
        Ok(())
    }
}

/// A simulated rig; its controller answers as long as this value lives.
pub struct SimulatedRig {
    /// Its time.
    pub clock: Arc<dyn Clock>,
    /// Axes, table and lens cap.
    pub world: Arc<World>,
    pub(super) on_table: SampleHandle,
    _controller: PtyServer,
}

impl SimulatedRig {
    /// Builds world, controller and camera, with real time run at the time scale.
    ///
    /// # Errors
    /// [`SimulationError`] if the system has no pseudo-terminal or a value is out of range.
    pub fn build(simulation: Simulation) -> Result<(SimulatedRig, RigParts), SimulationError> {
        let clock = Arc::new(ScaledClock::new(simulation.time_scale));
        SimulatedRig::with_clock(simulation, clock)
    }

    /// Does the same on the caller's clock.
    ///
    /// # Errors
    /// As [`SimulatedRig::build`].
    pub fn with_clock(
        simulation: Simulation,
        clock: Arc<dyn Clock>,
    ) -> Result<(SimulatedRig, RigParts), SimulationError> {
        simulation.check()?;
        let Simulation {
            seed,
            azimuth_offset,
            tilt_offset,
            construction,
            ..
        } = simulation;
        let (wedge, wedge_azimuth) = construction.wedge();
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
        let controller =
            serve_pty(Controller::new(&world)).map_err(SimulationError::NoPseudoTerminal)?;
        let camera = SimulatedCamera::new(
            Arc::clone(&world),
            SimulatedCameraSettings {
                camera_distance_mm: construction.camera_distance_mm,
                light_distance_mm: construction.light_distance_mm,
                tilt_centre_offset_px: construction.tilt_centre_offset_px.unwrap_or_default(),
                axis_offset_px: construction.axis_offset_px.unwrap_or_default(),
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

    /// Puts the faults of a plan into the stages, the camera and the line between stages and lab. The faults of the disk
    /// need a [`FaultyDisk`](super::faults::disk::FaultyDisk) over the lab's disk.
    #[must_use]
    pub fn with_faults(
        &self,
        parts: RigParts,
        text: FaultPlan,
        seed: u64,
    ) -> (RigParts, Arc<FaultInjector>) {
        let plan = FaultInjector::new(Arc::clone(&self.world), text, seed);
        let RigParts { rig, settings } = parts;
        let mut link = rig.link().clone();
        link.seam = Arc::new(FaultySeam::over(link.seam, plan.clone()));
        let camera = FaultyCamera::new(rig.camera, plan.clone());
        let rig = Rig::new(link, Box::new(camera));
        (RigParts { rig, settings }, plan)
    }
}

fn settings(camera: &SimulatedCamera, simulation: Simulation) -> RigSettings {
    // Another world is another rig: its calibrations do not apply here.
    let label = format!(
        "simulated, {}, seed {}, offsets {:.6} {:.6}{}",
        camera.describe(),
        simulation.seed,
        simulation.azimuth_offset,
        simulation.tilt_offset,
        match simulation.construction {
            usual if usual == Construction::default() => String::new(),
            // The name in the labels of data folders that exist.
            built => format!(", {built:?}").replacen("Construction", "Built", 1),
        }
    );
    RigSettings::of_simulation(camera.manifest(), simulation.time_scale, label)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wedge_is_ridge_angle_along_v_and_azimuth_across() {
        let wedged = Construction {
            wedge_deg: Some(0.2),
            wedge_azimuth_deg: Some(200.0),
            ..Construction::default()
        };
        // As the path-traced series near-off-axis has it.
        let (steeper, turned) = wedged.wedge_on(Angle::from_deg(9.0));
        assert!((steeper.deg() + 0.188).abs() < 5e-4, "{}", steeper.deg());
        assert!((turned.deg() + 0.441).abs() < 5e-4, "{}", turned.deg());
        let flat = Construction::default().wedge_on(Angle::from_deg(9.0));
        assert!(flat.0.abs().deg() < 1e-12 && flat.1 == Angle::ZERO);
    }

    #[test]
    fn a_rig_that_cannot_be_built_is_refused_by_the_name_of_the_value() {
        let refused = |construction: Construction| {
            let simulation = Simulation {
                construction,
                ..Simulation::default()
            };
            match SimulatedRig::build(simulation) {
                Err(error) => error.to_string(),
                Ok(_) => panic!("it was built"),
            }
        };
        let near = refused(Construction {
            camera_distance_mm: Some(20.0),
            ..Construction::default()
        });
        assert_eq!(
            near,
            "camera_distance_mm 20 is out of range: expected 100 to 1000000"
        );
        let wild = refused(Construction {
            axis_offset_px: Some([0.0, f64::NAN]),
            ..Construction::default()
        });
        assert!(wild.contains("axis_offset_px"), "{wild}");
    }

    #[test]
    fn a_simulated_rig_moves_where_the_settings_permit_it() {
        use crate::bench::stage::{ForbiddenRegion, HomingOrder};
        use crate::config::Config;

        let own = StageSettings::simulated();
        let mut stated = own.clone();
        stated.theta_c.limit_min = Angle::from_deg(-10.0);
        stated.theta_c.limit_max = Angle::from_deg(75.0);
        stated.theta_c.zero = Angle::from_deg(3.0);
        stated.theta_c.serial = Some(7);
        stated.homing.order = HomingOrder::ThetaCFirst;
        stated.forbidden = vec![ForbiddenRegion {
            name: "lamp arm".into(),
            reason: String::new(),
            theta_c_deg: [30.0, 45.0],
            phi_s_deg: [80.0, 100.0],
        }];
        let config = Config {
            stage: Some(stated.clone()),
            ..Config::default()
        };
        let (_rig, parts) = SimulatedRig::build(Simulation::default()).unwrap();
        let settings = parts.simulating(&config).rig.link().settings.clone();
        assert_eq!(settings.forbidden, stated.forbidden);
        assert_eq!(settings.homing, stated.homing);
        assert_eq!(settings.theta_c.limit_min, stated.theta_c.limit_min);
        // No further than the simulated stage goes, whose devices stay its own.
        assert_eq!(settings.theta_c.limit_max, own.theta_c.limit_max);
        assert_eq!(settings.theta_c.zero, own.theta_c.zero);
        assert_eq!(settings.theta_c.serial, own.theta_c.serial);
        assert_eq!(settings.phi_s, own.phi_s);
    }

    #[test]
    fn the_default_settings_leave_a_simulated_rig_as_it_is() {
        use crate::config::Config;

        let (_rig, mut parts) = SimulatedRig::build(Simulation::default()).unwrap();
        let untouched = parts.settings.clone();
        parts.settings.apply(&Config::default());
        assert_eq!(parts.settings.defaults, untouched.defaults);
        assert_eq!(parts.settings.runner, untouched.runner);
        let mut config = Config::default();
        config.store.reserve_mb = 5000;
        config.scan.attempts_max = 7;
        config.dark.repeats = 9;
        config.dark.valid_h = 2.0;
        config.flat.exposures_s = Some(vec![0.5]);
        parts.settings.apply(&config);
        let RigSettings {
            runner,
            defaults,
            dark_valid,
            ..
        } = &parts.settings;
        assert_eq!(runner.disk_reserve_bytes, 5_000_000_000);
        assert_eq!(runner.faults.attempts_max, 7);
        assert_eq!(defaults.dark_repeats, 9);
        assert_eq!(defaults.flat_exposures_s, [0.5]);
        assert_eq!(defaults.exposures_s, untouched.defaults.exposures_s);
        assert_eq!(dark_valid.as_secs(), 7200);
        // Camera and geometry stay the simulated ones.
        assert_eq!(parts.settings.camera, untouched.camera);
        assert_eq!(parts.settings.rig, untouched.rig);
    }
}
