//! The rig: port, controllers, reference, flags, and with `--frames` a dark and a lit frame. Nothing moves.

use std::io::{BufRead, IsTerminal};
use std::sync::Arc;

use serde_json::Value;

use super::findings::Findings;
use crate::bench::stage::{AxisName, Stage, StageError, StageIdentity};
use crate::bench::{CaptureRequest, Captured};
use crate::cli::client::Client;
use crate::cli::{CliError, say};
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::lab::RigParts;
use crate::program::Program;
use crate::scan::frame_rules::frame_fault;
use crate::sim::world::World;

/// Who makes it dark for the dark frame.
pub enum Darkness {
    /// The lamp's commands.
    Lamp {
        /// Switches it on.
        on: Program,
        /// Switches it off.
        off: Program,
    },
    /// The operator at the terminal, with the lens cap.
    Person,
    /// The simulated operator.
    Simulated(Arc<World>),
    /// No operator and no command: only the lit frame is taken.
    NotPossible,
}

impl Darkness {
    /// Returns what the rig has: a simulated operator, commands for the lamp, or a person at the terminal.
    pub fn of(parts: &RigParts, world: Option<&Arc<World>>) -> Darkness {
        let lamp = (&parts.settings.runner.lamp_on, &parts.settings.lamp_off);
        match (world, lamp) {
            (Some(world), _) => Darkness::Simulated(Arc::clone(world)),
            (None, (Some(on), Some(off))) => Darkness::Lamp {
                on: on.clone(),
                off: off.clone(),
            },
            _ if std::io::stdin().is_terminal() => Darkness::Person,
            _ => Darkness::NotPossible,
        }
    }

    /// Makes it dark or light; returns why it could not.
    async fn set(&self, dark: bool) -> Result<(), String> {
        match self {
            Darkness::Lamp { on, off } => {
                let program = if dark { off } else { on };
                program.run(b"").await.map_err(|error| error.to_string())
            }
            Darkness::Simulated(world) => {
                world.cap_lens(dark);
                Ok(())
            }
            Darkness::Person => {
                say(match dark {
                    true => "put the cap on the lens, then press Enter",
                    false => "take the cap off the lens and switch the lamp on, then press Enter",
                });
                let line = tokio::task::spawn_blocking(|| {
                    let mut line = String::new();
                    std::io::stdin().lock().read_line(&mut line)
                });
                match line.await {
                    Ok(Ok(1..)) => Ok(()),
                    _ => Err("no operator confirmed it".into()),
                }
            }
            Darkness::NotPossible => Ok(()),
        }
    }
}

/// Asks the daemon that owns the rig.
pub fn ask_daemon(client: &Client, findings: &mut Findings) {
    match client.readiness() {
        Ok(ready) if ready["ready"] == true => {
            findings.ok("daemon", format!("it runs at {} and is ready", client.url));
        }
        Ok(ready) => findings.fault(
            "daemon",
            format!(
                "it runs at {} and is not ready: {}",
                client.url,
                ready["problem"].as_str().unwrap_or("it does not say why")
            ),
            "the cause names the way out",
        ),
        Err(error) => findings.error("daemon", &words(&error)),
    }
    let rig = match client.get("/rig") {
        Ok(rig) => rig,
        Err(error) => return findings.error("stages", &words(&error)),
    };
    let (port, activity) = (text(&rig["description"]), text(&rig["activity"]));
    if rig["connected"] != true {
        let why = rig["problem"]["detail"].as_str();
        let found = format!(
            "the daemon does not reach them on {port}: {}",
            why.unwrap_or("no cause")
        );
        return findings.fault("stages", found, "the cause names the way out");
    }
    findings.ok(
        "stages",
        format!("the daemon has them on {port}, activity {activity}"),
    );
    for axis in ["theta_c", "phi_s"] {
        let state = &rig["axes"][axis];
        let warnings = state["warnings"].as_array().into_iter().flatten();
        let serial = format!(
            "{axis}: serial number {}, limits {}° … {}°",
            text(&state["serial"]),
            state["limit_min_deg"],
            state["limit_max_deg"]
        );
        let warnings = warnings.filter_map(Value::as_str).map(str::to_owned);
        report_axis(axis, &serial, state["homed"] == true, warnings, findings);
    }
    findings.note(
        "camera",
        "the daemon has it; stop the daemon to take frames here, or start a scan",
    );
}

/// Returns the words of a client's error.
pub fn words(error: &CliError) -> String {
    match error {
        CliError::BadInput(error) | CliError::NoResult(error) => format!("{error:#}"),
        CliError::Interrupted => "interrupted".into(),
        CliError::Verdict(code) => format!("exit code {code}"),
    }
}

fn text(value: &Value) -> String {
    value
        .as_str()
        .map_or_else(|| value.to_string(), str::to_owned)
}

fn report_axis(
    axis: &str,
    identity: &str,
    homed: bool,
    warnings: impl Iterator<Item = String>,
    findings: &mut Findings,
) {
    findings.ok("stages", identity);
    match homed {
        true => findings.ok("stages", format!("{axis}: has its reference")),
        false => findings.note(
            "stages",
            format!("{axis}: has no reference; the next scan homes it"),
        ),
    }
    // A lost reference has been reported.
    for warning in warnings.filter(|w| !w.starts_with("WR") && !w.starts_with("WH")) {
        findings.warning(
            "stages",
            format!("{axis}: {warning}"),
            "find the cause; homing clears the flags of a stall or a limit",
        );
    }
}

/// Connects the stages and reads them; with `frames`, also takes a dark and a lit frame.
pub async fn check_rig(
    mut parts: RigParts,
    pinned: Option<&StageIdentity>,
    darkness: Option<Darkness>,
    findings: &mut Findings,
) {
    let port = parts.rig.link().port.clone();
    let pose = match parts.rig.connect().await {
        Err(error) => {
            findings.error("stages", &error);
            None
        }
        Ok(stage) => {
            findings.ok("stages", format!("port {port}"));
            match check_stage(&stage, pinned, findings).await {
                Ok(pose) => Some(pose),
                Err(error) => {
                    findings.error("stages", &error);
                    None
                }
            }
        }
    };
    findings.ok("camera", parts.rig.camera.describe());
    match darkness {
        None => findings.note(
            "camera",
            "no frame was taken; --frames takes a dark and a lit one",
        ),
        Some(darkness) => {
            let pose = pose.unwrap_or(Pose::from_deg(0.0, 0.0));
            check_camera(&mut parts, pose, &darkness, findings).await;
        }
    }
}

async fn check_stage(
    stage: &Stage,
    pinned: Option<&StageIdentity>,
    findings: &mut Findings,
) -> Result<Pose, StageError> {
    let identity = stage.identity();
    if let Some(pinned) = pinned.filter(|pinned| !pinned.is_same(&identity)) {
        findings.warning(
            "stages",
            format!(
                "the controllers are {identity}, but those of the data folder's rig are {pinned}"
            ),
            "connect those, or accept the others once the daemon runs; it refuses them until then",
        );
    }
    let status = stage.status().await?;
    for axis in AxisName::ALL {
        let device = match axis {
            AxisName::ThetaC => &identity.theta_c,
            AxisName::PhiS => &identity.phi_s,
        };
        let limits = stage.settings().axis(axis);
        let text = format!(
            "{axis}: serial number {}, device {}, firmware {}, limits {} … {}",
            device.serial, device.device_id, device.firmware, limits.limit_min, limits.limit_max
        );
        let state = status.axis(axis);
        let warnings = state.warnings.iter().cloned();
        report_axis(axis.as_str(), &text, state.homed, warnings, findings);
        if state.moving {
            findings.warning(
                "stages",
                format!("{axis}: is moving"),
                "another program moves it; end that first",
            );
        }
    }
    Ok(status.pose())
}

async fn check_camera(
    parts: &mut RigParts,
    pose: Pose,
    darkness: &Darkness,
    findings: &mut Findings,
) {
    let rules = parts.settings.runner.frame.clone();
    let exposures_s = parts.settings.defaults.exposures_s.clone();
    let longest_s = exposures_s.iter().copied().fold(0.0, f64::max);
    let mut kinds = vec![FrameKind::Dark, FrameKind::Sample];
    if matches!(darkness, Darkness::NotPossible) {
        findings.note(
            "camera",
            "no dark frame: it needs a person at the terminal, or lamp.on and lamp.off in the settings",
        );
        kinds.remove(0);
    }
    for kind in kinds {
        let name = match kind {
            FrameKind::Dark => "dark",
            FrameKind::Flat | FrameKind::Sample => "lit",
        };
        if let Err(error) = darkness.set(kind == FrameKind::Dark).await {
            findings.error("lamp", &error);
            continue;
        }
        let request = CaptureRequest {
            kind,
            pose,
            exposure_s: longest_s,
            repeat: 0,
        };
        let captured = match parts.rig.camera.capture(&request).await {
            Ok(captured) => captured,
            Err(error) => {
                findings.error("camera", &error);
                continue;
            }
        };
        let seen = describe(&captured, longest_s, rules.saturation_dn);
        match frame_fault(captured, longest_s, kind, &rules) {
            None => findings.ok("camera", format!("{name} frame: {seen}")),
            Some(why) => findings.error("camera", &format!("{name} frame: {why} ({seen})")),
        }
    }
    if let Darkness::Lamp { off, .. } = darkness
        && let Err(error) = off.run(b"").await
    {
        findings.error("lamp", &error);
    }
}

fn describe(captured: &Captured, exposure_s: f64, saturation_dn: u16) -> String {
    let frame = &captured.frame;
    let pixels = frame.pixels_dn();
    let sum: u64 = pixels.iter().map(|dn| u64::from(*dn)).sum();
    let full = pixels.iter().filter(|dn| **dn >= saturation_dn).count();
    format!(
        "{} × {} pixels, {exposure_s} s, mean {:.0} DN, {:.1} % full",
        frame.width_px(),
        frame.height_px(),
        sum as f64 / pixels.len() as f64,
        100.0 * full as f64 / pixels.len() as f64
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::rig::{SimulatedRig, Simulation};

    #[tokio::test(flavor = "multi_thread")]
    async fn other_controllers_than_those_of_the_data_folder_are_a_warning() {
        let words = "but those of the data folder's rig are";
        let (_rig, mut parts) = SimulatedRig::build(Simulation::default()).unwrap();
        let own = parts.rig.connect().await.unwrap().identity();
        let mut findings = Findings::default();
        check_rig(parts, Some(&own), None, &mut findings).await;
        assert!(!findings.text().contains(words), "{}", findings.text());

        let mut other = own;
        other.phi_s.serial += 1;
        let (_rig, parts) = SimulatedRig::build(Simulation::default()).unwrap();
        let mut findings = Findings::default();
        check_rig(parts, Some(&other), None, &mut findings).await;
        assert!(findings.text().contains(words), "{}", findings.text());
        assert_eq!(findings.worst().exit_code(), 3);
    }
}
