//! `ridged rig`: commands for the rig of a running daemon.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::anyhow;
use serde_json::{Value, json};

mod lease;

use super::client::{Client, ConnectionArgs};
use super::{CliError, output};
use lease::LeaseAction;
use preview::PreviewArgs;

mod preview;
mod stop;

/// Shows, previews, homes, moves, jogs, unparks or stops the rig of a running daemon.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ridged rig stop        stops both axes of every rig at once, whatever moves them"
)]
pub struct Args {
    /// The action.
    #[command(subcommand)]
    pub action: Action,
    /// Data folder of the daemon [default: ridged-data; stop: those of all daemons that run].
    #[arg(long, value_name = "DIR", global = true)]
    pub data: Option<PathBuf>,
    /// One JSON object on stdout.
    #[arg(long, global = true)]
    pub json: bool,
    /// Address, token and lease.
    #[command(flatten)]
    pub connection: ConnectionArgs,
}

/// An action on the rig.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Action {
    /// Show the positions of both axes.
    #[command(after_help = "Example:\n  ridged rig status --json")]
    Status,
    /// Home both axes.
    #[command(after_help = "Example:\n  ridged rig home")]
    Home,
    /// Move one axis or both to absolute positions, and wait until they arrive.
    #[command(after_help = "Example:\n  ridged rig move --theta-c-deg 20 --phi-s-deg 90")]
    Move(MoveArgs),
    /// Unpark axes that another program parked, without moving them.
    #[command(after_help = "Example:\n  ridged rig unpark")]
    Unpark,
    /// Move an axis slowly while the command runs; Ctrl-C ends it.
    #[command(after_help = "Example:\n  ridged rig jog phi_s --speed-deg-s -2 --for-s 3")]
    Jog(JogArgs),
    /// Take a frame per exposure at the present pose and show its figures; nothing moves and nothing is stored.
    #[command(
        after_help = "Examples:\n  ridged rig preview\n  ridged rig preview --exposure-ms 20 -o look.png"
    )]
    Preview(PreviewArgs),
    /// Accept the controllers that answer instead of those of the rig.
    #[command(after_help = "Example:\n  ridged rig accept-stages")]
    AcceptStages,
    /// Stop both axes at once; never refused. Without --data or --url it stops the rigs of all daemons that run on this
    /// machine.
    #[command(
        after_help = "Examples:\n  ridged rig stop\n  ridged rig stop --data /var/lib/ridged\n  \
                      ridged rig stop --url https://rig-2:8787 --token-file ~/.ridged-token"
    )]
    Stop,
    /// Show, take or return the lease: while it lasts, only orders that present it are accepted.
    #[command(after_help = "Example:\n  ridged rig lease show")]
    Lease {
        /// The action.
        #[command(subcommand)]
        action: LeaseAction,
    },
}

/// Options of `rig jog`.
#[derive(Debug, Clone, clap::Args)]
pub struct JogArgs {
    /// theta_c or phi_s.
    pub axis: String,
    /// Speed and direction, degrees per second; at most the speed of the axis.
    #[arg(long, value_name = "DEG_S", allow_negative_numbers = true)]
    pub speed_deg_s: f64,
    /// Duration in seconds, 0.1 to 600.
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    pub for_s: f64,
}

/// Options of `rig move`.
#[derive(Debug, Clone, clap::Args)]
#[group(required = true, multiple = true)]
pub struct MoveArgs {
    /// Camera tilt θc to move to, degrees.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub theta_c_deg: Option<f64>,
    /// Sample azimuth φs to move to, degrees.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub phi_s_deg: Option<f64>,
}

/// Time between two renewals of a jog: the daemon ends it after 0.5 s without one.
const RENEW_EVERY: Duration = Duration::from_millis(150);

/// Runs the command.
///
/// # Errors
/// No result if no daemon runs or the rig refuses.
pub fn run(args: Args) -> Result<(), CliError> {
    let folder = args.data.as_deref();
    let client = || {
        let folder = folder.unwrap_or(Path::new("ridged-data"));
        Client::require(folder, &args.connection)
    };
    let mut text = None;
    let answer = match &args.action {
        Action::Status => client()?.rig()?,
        Action::Stop => {
            // What is stopped is shown at once, whatever the other daemons do. With --json, stdout has one object.
            let mut print = |line: &str| match args.json {
                true => writeln!(std::io::stderr(), "{line}").unwrap_or(()),
                false => writeln!(std::io::stdout(), "{line}").unwrap_or(()),
            };
            text = Some(String::new());
            match args.connection.url {
                Some(_) => stop::stop_at(&client()?, &mut print)?,
                // A token file that cannot be read must not prevent the stop, which needs none here.
                None => stop::stop(folder, &mut print)?,
            }
        }
        Action::Lease { action } => lease::run(&client()?, action)?,
        Action::Home => {
            let client = client()?;
            client.post("/rig/home", None)?;
            for axis in ["theta_c", "phi_s"] {
                until_homed(&client, axis)?;
            }
            client.get("/rig")?
        }
        Action::Move(targets) => {
            let client = client()?;
            move_and_wait(&client, targets)?;
            client.get("/rig")?
        }
        Action::Jog(jog) => {
            let client = client()?;
            jog_for(&client, jog)?;
            client.get("/rig")?
        }
        Action::Preview(args) => preview::run(&client()?, args)?,
        Action::AcceptStages => {
            let client = client()?;
            let refused = client.get("/rig")?["refused_stages"].take();
            if refused.is_null() {
                return Err(CliError::no_result(anyhow!(
                    "no other controllers answer than those of the rig; `ridged rig status` shows its state"
                )));
            }
            let body = json!({
                "theta_c_serial": refused["theta_c"]["serial"],
                "phi_s_serial": refused["phi_s"]["serial"],
            });
            client.post("/rig/accept-stages", Some(&body))?
        }
        Action::Unpark => {
            let client = client()?;
            for axis in ["theta_c", "phi_s"] {
                client.post(&format!("/rig/axes/{axis}/unpark"), None)?;
            }
            client.get("/rig")?
        }
    };
    output::write(args.json, &answer, || {
        text.unwrap_or_else(|| words(&args.action, &answer))
    })
}

/// Moves the axes, and waits until they have arrived.
fn move_and_wait(client: &Client, targets: &MoveArgs) -> Result<(), CliError> {
    let mut body = json!({});
    for (key, target) in [
        ("theta_c_deg", targets.theta_c_deg),
        ("phi_s_deg", targets.phi_s_deg),
    ] {
        if let Some(deg) = target {
            body[key] = json!(deg);
        }
    }
    let begun = client.post("/rig/move", Some(&body))?;
    loop {
        let motion = client.get(&format!("/rig/moves/{}?wait_s=1", begun["id"]))?;
        match motion["state"].as_str() {
            Some("moving") => {}
            Some("arrived") => return Ok(()),
            _ => {
                let why = motion["problem"]["detail"].as_str();
                let why = why
                    .unwrap_or("the motion has ended before its target")
                    .to_owned();
                return Err(CliError::no_result(anyhow!("{why}")));
            }
        }
    }
}

/// Jogs an axis: the daemon stops it by itself if this process ends.
fn jog_for(client: &Client, args: &JogArgs) -> Result<(), CliError> {
    if !(0.1..=600.0).contains(&args.for_s) {
        return Err(CliError::bad_input(anyhow!(
            "--for-s {} is out of range: expected 0.1 to 600",
            args.for_s
        )));
    }
    let order = |speed_deg_s: f64, jog: Option<&Value>| {
        let mut body = json!({ "axis": args.axis, "speed_deg_s": speed_deg_s });
        if let Some(jog) = jog {
            body["jog"] = jog.clone();
        }
        client.post("/rig/jog", Some(&body))
    };
    let began = std::time::Instant::now();
    let mut state = order(args.speed_deg_s, None)?;
    let jog = state["jog"].clone();
    while began.elapsed().as_secs_f64() < args.for_s && state["at_end"].is_null() {
        std::thread::sleep(RENEW_EVERY);
        state = order(args.speed_deg_s, Some(&jog))?;
    }
    if let Some(why) = state["at_end"].as_str() {
        writeln!(std::io::stderr(), "{why}").ok();
    }
    order(0.0, Some(&jog)).map(|_| ())
}

/// Waits until the motion is over and checks that the axis has a reference from it.
fn until_homed(client: &Client, axis: &str) -> Result<(), CliError> {
    loop {
        let rig = client.get("/rig")?;
        if let Some(outcome) = homed(&rig, axis) {
            return outcome.map_err(|why| CliError::no_result(anyhow!("{why}")));
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Returns whether homing an axis succeeded, or why not; `None` while it moves.
fn homed(rig: &Value, axis: &str) -> Option<Result<(), String>> {
    let why = |problem: &Value| problem["detail"].as_str().map(str::to_owned);
    if rig["connected"] == false {
        return Some(Err(
            why(&rig["problem"]).unwrap_or_else(|| "the rig is not connected".into())
        ));
    }
    if rig["activity"] != "idle" {
        return None;
    }
    if let Some(failure) = why(&rig["failure"]) {
        return Some(Err(failure));
    }
    // The controller may have been switched off and on in the meantime.
    Some(match rig["axes"][axis]["homed"] == true {
        true => Ok(()),
        false => Err(format!(
            "{axis} has no reference after homing; check the rig, then home it again"
        )),
    })
}

fn words(action: &Action, answer: &Value) -> String {
    match action {
        Action::Lease { action } => return lease::words(action, answer),
        Action::Preview(args) => return preview::words(args, answer),
        Action::AcceptStages => {
            let serial = |axis: &str| answer[axis]["serial"].as_str().unwrap_or("?").to_owned();
            return format!(
                "accepted: theta_c has serial number {}, phi_s has {}; home both axes and check their zeros before you measure\n",
                serial("theta_c"),
                serial("phi_s")
            );
        }
        Action::Status
        | Action::Home
        | Action::Move(_)
        | Action::Jog(_)
        | Action::Unpark
        | Action::Stop => {}
    }
    let mut text = match answer["problem"]["detail"].as_str() {
        Some(problem) => format!("not connected: {problem}\n"),
        None => format!(
            "{}, {}\n",
            answer["description"].as_str().unwrap_or("connected"),
            answer["activity"].as_str().unwrap_or("idle")
        ),
    };
    for axis in ["theta_c", "phi_s"] {
        let state = &answer["axes"][axis];
        let position = match state["position_deg"].as_f64() {
            Some(deg) if state["referenced"] == true => format!("{deg:10.4}°"),
            _ => "position unknown".into(),
        };
        let moving = match state["moving"].as_bool() {
            Some(true) => "moving",
            Some(false) => "at rest",
            None => "motion unknown (it may be moving)",
        };
        let homed = match (answer["connected"] == false, state["homed"] == true) {
            (true, _) => "reference unknown",
            (false, true) => "homed",
            (false, false) => "not homed: run `ridged rig home`",
        };
        let warnings: Vec<&str> = state["warnings"]
            .as_array()
            .map(|all| all.iter().filter_map(Value::as_str).collect())
            .unwrap_or_default();
        let line = format!(
            "{axis:>8} {position}  {moving}, {homed} {}",
            warnings.join("; ")
        );
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_without_connection_is_not_reported_at_rest() {
        let axis = json!({ "position_deg": null, "moving": null, "homed": false, "warnings": [] });
        let gone = json!({
            "connected": false, "problem": { "code": "stage-silent", "detail": "no reply" },
            "activity": "idle", "axes": { "theta_c": axis, "phi_s": axis },
        });
        let said = words(&Action::Status, &gone);
        assert!(said.starts_with("not connected: no reply\n"), "{said}");
        assert_eq!(said.matches("motion unknown").count(), 2, "{said}");
        assert!(
            !said.contains("rest") && !said.contains("not homed"),
            "{said}"
        );
    }

    #[test]
    fn homing_succeeds_only_where_the_axis_has_a_reference() {
        let rig = |activity: &str, reference: bool| {
            json!({
                "connected": true, "problem": null, "failure": null, "activity": activity,
                "axes": { "theta_c": { "homed": reference }, "phi_s": { "homed": true } },
            })
        };
        assert_eq!(homed(&rig("homing", false), "theta_c"), None);
        assert_eq!(homed(&rig("idle", true), "theta_c"), Some(Ok(())));
        let unknown = homed(&rig("idle", false), "theta_c").unwrap().unwrap_err();
        assert!(unknown.contains("theta_c"), "{unknown}");
        // An earlier reference does not make a failed motion a success.
        let mut failed = rig("idle", true);
        failed["failure"] = json!({ "code": "stage-stalled", "detail": "theta_c stalled" });
        assert_eq!(
            homed(&failed, "theta_c"),
            Some(Err("theta_c stalled".into()))
        );
        let mut gone = rig("homing", false);
        gone["connected"] = json!(false);
        gone["problem"] = json!({ "code": "stage-silent", "detail": "no reply" });
        assert_eq!(homed(&gone, "theta_c"), Some(Err("no reply".into())));
    }
}
