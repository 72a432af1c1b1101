//! `ridged rig`: look at and stop the rig of a running daemon.

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::anyhow;
use serde_json::Value;

use super::CliError;
use super::client::Client;

/// Looks at, homes or stops the rig of a running daemon.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ridged rig stop        stops both axes at once, whoever moves them"
)]
pub struct Args {
    /// What to do.
    #[command(subcommand)]
    pub action: Action,
    /// Data folder of the daemon.
    #[arg(long, value_name = "DIR", default_value = "ridged-data", global = true)]
    pub data: PathBuf,
    /// One JSON object on stdout.
    #[arg(long, global = true)]
    pub json: bool,
}

/// What to do with the rig.
#[derive(Debug, Clone, Copy, clap::Subcommand)]
pub enum Action {
    /// Where both axes stand.
    #[command(after_help = "Example:\n  ridged rig status --json")]
    Status,
    /// Look for the reference of both axes.
    #[command(after_help = "Example:\n  ridged rig home")]
    Home,
    /// Stop both axes at once; never refused.
    #[command(after_help = "Example:\n  ridged rig stop --data /var/lib/ridged")]
    Stop,
}

/// Runs the command.
///
/// # Errors
/// No result if no daemon runs or the rig refuses.
pub fn run(args: Args) -> Result<(), CliError> {
    let client = Client::require(&args.data)?;
    let answer = match args.action {
        Action::Status => client.get("/rig")?,
        Action::Stop => client.post("/rig/stop", None)?,
        Action::Home => {
            for axis in ["theta_c", "phi_s"] {
                client.post(&format!("/rig/axes/{axis}/home"), None)?;
                until_idle(&client)?;
            }
            client.get("/rig")?
        }
    };
    let text = match args.json {
        true => format!("{answer:#}\n"),
        false => words(&args.action, &answer),
    };
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(CliError::no_result)
}

fn until_idle(client: &Client) -> Result<(), CliError> {
    loop {
        let rig = client.get("/rig")?;
        if rig["connected"] == false {
            let why = rig["problem"]["detail"]
                .as_str()
                .unwrap_or("the rig is not connected");
            return Err(CliError::no_result(anyhow!("{why}")));
        }
        if rig["activity"] == "idle" {
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

fn words(action: &Action, answer: &Value) -> String {
    if matches!(action, Action::Stop) {
        return "stopped\n".into();
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
            Some(deg) => format!("{deg:10.4}°"),
            None => "   unknown".into(),
        };
        let moving = if state["moving"] == true {
            "moving"
        } else {
            "at rest"
        };
        let homed = if state["homed"] == true {
            "homed"
        } else {
            "not homed"
        };
        let warnings: Vec<&str> = state["warnings"]
            .as_array()
            .map(|all| all.iter().filter_map(Value::as_str).collect())
            .unwrap_or_default();
        text.push_str(&format!(
            "{axis:>8} {position}  {moving}, {homed} {}\n",
            warnings.join("; ")
        ));
    }
    text
}
