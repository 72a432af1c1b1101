//! From the settings of the daemon to a rig that the lab can own: [`real_rig`] makes its camera and the link to its stages.

use std::sync::Arc;
use std::time::Duration;

use super::{RigParts, RigSettings};
use crate::bench::Camera;
use crate::bench::stage::{AxisName, NoFaults};
use crate::bench::watched_folder::{WatchedFolder, WatchedFolderError, WatchedFolderSettings};
use crate::clock::Clock;
use crate::config::{CameraSection, Config};
use crate::geometry::Pose;
use crate::program::Program;
use crate::scan::frame_rules::{CappedLimit, Confirmed, FrameRules};
use crate::scan::plan::PlanDefaults;
use crate::scan::reference::ReferenceRules;
use crate::scan::runner::{RunnerSettings, SuspendRules};
use crate::scan::tag_history::TagRules;
use crate::scan::{Rig, StageLink};
use crate::series::{CameraFacts, Manifest};

/// Why the settings name no rig that can be used.
#[derive(Debug, thiserror::Error)]
pub enum AssemblyError {
    /// Stages without a camera.
    #[error(
        "the settings name a port but no camera: set camera.folder to the folder into which the camera's program \
         writes frames (ridged.example.toml shows how)"
    )]
    NoCamera,
    /// The camera's folder or program cannot be used.
    #[error(transparent)]
    Camera(#[from] WatchedFolderError),
}

/// Assembles the real rig of the settings; `None` if they name no port. Nothing is connected yet.
///
/// # Errors
/// [`AssemblyError`] for a port without a camera, or a camera that cannot be used.
pub fn real_rig(
    config: &Config,
    clock: &Arc<dyn Clock>,
) -> Result<Option<RigParts>, AssemblyError> {
    let Some(port) = config.port.clone() else {
        return Ok(None);
    };
    let stage = config
        .stage
        .clone()
        .expect("checked settings have a stage beside a port");
    let camera = camera_of(&config.camera, clock)?;
    let camera_facts = config.camera_facts();
    let settings = RigSettings {
        rig: config.rig_facts(),
        flat: config.flat_facts(),
        defaults: config.plan_defaults(),
        runner: runner_settings(&camera_facts, config),
        camera: camera_facts,
        dark_valid: hours(config.dark.valid_h),
        flat_valid: hours(config.flat.valid_h),
        park: park(config),
        lamp_off: lamp(config, &config.lamp.off),
        fit_at_end: config.scan.fit_at_end,
        queue_on_failure: config.queue.on_failure,
        simulated: None,
        label: String::new(),
    };
    let link = StageLink {
        port,
        settings: stage,
        clock: Arc::clone(clock),
        seam: Arc::new(NoFaults),
    };
    Ok(Some(RigParts {
        rig: Rig::new(link, camera),
        settings,
    }))
}

/// Makes the camera of the settings. A further kind of camera is chosen here.
fn camera_of(
    section: &CameraSection,
    clock: &Arc<dyn Clock>,
) -> Result<Box<dyn Camera>, AssemblyError> {
    let folder = section.folder.clone();
    let settings = WatchedFolderSettings {
        folder: folder.ok_or(AssemblyError::NoCamera)?,
        command: section.command.clone(),
        timeout_s: section.timeout_s,
        delete_read_frames: section.delete_read_frames,
    };
    Ok(Box::new(WatchedFolder::new(settings, Arc::clone(clock))?))
}

impl RigParts {
    /// Applies the settings to a simulated rig: what [`RigSettings::apply`] applies, and where the stages may move. Logs the keys
    /// of the stages that have no effect.
    #[must_use]
    pub fn simulating(mut self, config: &Config) -> Self {
        self.settings.apply(config);
        let Some(stated) = &config.stage else {
            return self;
        };
        let mut link = self.rig.link().clone();
        link.settings = stated.on_simulated_stages();
        for axis in AxisName::ALL {
            let (stated, own) = (stated.axis(axis), link.settings.axis(axis));
            for (key, stated, own) in [
                ("limit_min_deg", stated.limit_min, own.limit_min),
                ("limit_max_deg", stated.limit_max, own.limit_max),
            ] {
                if stated != own {
                    let (stated, own) = (stated.deg(), own.deg());
                    tracing::warn!(
                        "the simulated rig has stage.{axis}.{key} = {own:.3}, since it does not go to {stated:.3}"
                    );
                }
            }
        }
        tracing::info!(
            "the simulated rig has limit_min_deg and limit_max_deg of stage.theta_c and stage.phi_s, stage.forbidden and \
             stage.homing from the settings; port and the other keys of stage have no effect on it"
        );
        self.rig = Rig::new(link, self.rig.camera);
        self
    }
}

impl RigSettings {
    /// The settings of a simulated rig with this manifest, all else by default. `time_scale` is how many times faster
    /// than real time it runs; `label` keeps its calibrations apart from those of other simulated rigs.
    #[must_use]
    pub fn of_simulation(manifest: Manifest, time_scale: f64, label: String) -> Self {
        let config = Config::default();
        let exposures_s = manifest.camera.exposures_s.clone();
        RigSettings {
            defaults: PlanDefaults {
                flat_exposures_s: exposures_s.clone(),
                exposures_s,
                dark_repeats: config.dark.repeats,
                flat_repeats: config.flat.repeats,
                reference_every: config.scan.reference_every,
            },
            runner: runner_settings(&manifest.camera, &config),
            rig: manifest.rig,
            camera: manifest.camera,
            flat: manifest
                .flat
                .expect("the simulated rig has a white reference"),
            dark_valid: hours(config.dark.valid_h),
            flat_valid: hours(config.flat.valid_h),
            park: None,
            lamp_off: None,
            fit_at_end: config.scan.fit_at_end,
            queue_on_failure: config.queue.on_failure,
            simulated: Some(time_scale),
            label,
        }
    }

    /// Applies what the settings state about scans, calibrations and the disk. Stages, geometry, camera and white
    /// reference stay those of the rig.
    pub fn apply(&mut self, config: &Config) {
        let Config {
            camera, flat, dark, ..
        } = config;
        self.runner = runner_settings(&self.camera, config);
        self.park = park(config);
        self.lamp_off = lamp(config, &config.lamp.off);
        self.dark_valid = hours(dark.valid_h);
        self.flat_valid = hours(flat.valid_h);
        self.defaults.dark_repeats = dark.repeats;
        self.defaults.flat_repeats = flat.repeats;
        self.defaults.reference_every = config.scan.reference_every;
        self.fit_at_end = config.scan.fit_at_end;
        self.queue_on_failure = config.queue.on_failure;
        // The default exposures are those of no camera in particular; the rig's own fit it better.
        if camera.exposures_s != CameraSection::default().exposures_s {
            self.defaults.exposures_s.clone_from(&camera.exposures_s);
            self.defaults
                .flat_exposures_s
                .clone_from(&camera.exposures_s);
        }
        if let Some(exposures_s) = &flat.exposures_s {
            self.defaults.flat_exposures_s.clone_from(exposures_s);
        }
    }
}

/// How a scan with this camera deals with faults.
fn runner_settings(camera: &CameraFacts, config: &Config) -> RunnerSettings {
    let pixels = u64::from(camera.width_px) * u64::from(camera.height_px);
    RunnerSettings {
        faults: config.scan.fault_policy(),
        lamp_on: lamp(config, &config.lamp.on),
        disk_reserve_bytes: config.store.reserve_bytes(),
        // Noise does not compress: two bytes per pixel, and PNG's own.
        frame_bytes_max: pixels * 2 + pixels / 64 + 4096,
        tags: TagRules {
            serial: config.camera.serial.clone(),
            clock_tolerance: seconds(config.camera.clock_tolerance_s),
            temperature_c: config.camera.temperature_c,
            temperature_tolerance_k: config.camera.temperature_tolerance_k,
        },
        reference: ReferenceRules {
            every: config.scan.reference_every,
            time_share_max: config.scan.reference_time_share,
            change_max: config.scan.reference_change_max,
        },
        suspend: SuspendRules {
            times_max: config.scan.suspend_times_max,
            calm: seconds(config.scan.suspend_calm_s),
            longest: seconds(config.scan.suspend_for_max_s),
            watched: config.suspend.clone(),
        },
        frame: FrameRules {
            size_px: (camera.width_px, camera.height_px),
            black_level_dn: camera.black_level_dn.unwrap_or(0.0),
            read_noise_dn: camera.read_noise_electrons_rms.unwrap_or(2.0)
                * camera.gain_dn_per_electron,
            gain_dn_per_electron: camera.gain_dn_per_electron,
            unlit_share_max: config.scan.unlit_share_max,
            dark_sigmas: 10.0,
            saturation_dn: camera.full_count(),
            confirmed: Confirmed::default(),
            capped: CappedLimit {
                mean_dn_max: config.scan.capped_mean_dn_max,
                dark_dn_per_s: config.camera.dark_current_electrons_per_s
                    * config.camera.gain_dn_per_electron,
            },
        },
    }
}

fn park(config: &Config) -> Option<Pose> {
    let place = config.park?;
    Some(Pose::from_deg(place.theta_c_deg, place.phi_s_deg))
}

fn lamp(config: &Config, words: &[String]) -> Option<Program> {
    Program::of(words, config.lamp.time_limit_s)
}

fn seconds(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

fn hours(hours: f64) -> Duration {
    Duration::from_secs_f64(hours * 3600.0)
}
