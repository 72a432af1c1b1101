//! `ridged simulate-rig`: only the simulated controller, on a pty or a TCP port.

use std::io::Write;
use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::Arc;

use anyhow::{Context, anyhow};
use serde_json::{Value, json};

use super::CliError;
use super::interrupt;
use super::simulated::FaultArgs;
use crate::bench::AxisName;
use crate::clock::{Clock, ScaledClock};
use crate::sim::controller::Controller;
use crate::sim::faults::controller::FaultyController;
use crate::sim::faults::injector::FaultInjector;
use crate::sim::rig::{TIME_SCALES_OF_CONTROLLER, check_range};
use crate::sim::server::{serve_pty, serve_tcp};
use crate::sim::world::{World, WorldSettings};

/// Serves the simulated two-axis controller (Zaber ASCII) until Ctrl-C.
///
/// Address 1 turns theta_c, address 2 phi_s, one axis each; with --one-controller address 1 turns both, as its axes 1
/// and 2. When ready it prints one line, "listening on PATH_OR_ADDR".
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    ridged simulate-rig --tcp 127.0.0.1:55550 --time-scale 20\n  \
    ridged simulate-rig --pty --describe")]
#[command(group = clap::ArgGroup::new("line").required(true).args(["pty", "tcp"]))]
pub struct Args {
    /// Listen on a new pseudo-terminal, to be opened like a serial port.
    #[arg(long)]
    pub pty: bool,
    /// Listen on this TCP address; port 0 picks a free one.
    #[arg(long, value_name = "ADDR")]
    pub tcp: Option<String>,
    /// How many times faster than real time the rig runs.
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    pub time_scale: f64,
    /// Both stages on one controller, at address 1: axis 1 is theta_c, axis 2 phi_s.
    #[arg(long)]
    pub one_controller: bool,
    /// Describe the rig as JSON, after the line with its address.
    #[arg(long)]
    pub describe: bool,
    /// What goes wrong with it. A plan's faults of camera, disk and plug need `serve --simulated-rig`.
    #[command(flatten)]
    pub faults: FaultArgs,
}

/// Serves until Ctrl-C, SIGTERM or SIGHUP.
///
/// # Errors
/// Bad input for an invalid time scale or address; no result if the line cannot be opened.
pub fn run(args: Args) -> Result<(), CliError> {
    check_range("time_scale", args.time_scale, TIME_SCALES_OF_CONTROLLER)?;
    let clock: Arc<dyn Clock> = Arc::new(ScaledClock::new(args.time_scale));
    let world = Arc::new(World::new(clock, WorldSettings::default()));
    let controller = match args.one_controller {
        true => Controller::with_both_axes(&world),
        false => Controller::new(&world),
    };
    let text = args.faults.read()?;
    let (text, seed) = text.unwrap_or_default();
    if let Some(kind) = text
        .fault
        .iter()
        .find(|fault| !fault.kind.is_of_controller())
    {
        return Err(CliError::bad_input(anyhow!(
            "the fault {} is not one of the controller: run `ridged serve --simulated-rig --faults` for it",
            kind.kind_name()
        )));
    }
    let plan = FaultInjector::new(Arc::clone(&world), text, seed);
    let controller = FaultyController::new(controller, plan);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(CliError::no_result)?;
    runtime.block_on(async {
        // Before the line with the address, since a reader of it may send the signal at once.
        let stop = interrupt::signals().map_err(CliError::no_result)?;
        match &args.tcp {
            Some(address) => {
                let address = parse_address(address)?;
                let server = serve_tcp(controller, address)
                    .with_context(|| format!("cannot listen on {address}; is it in use?"))
                    .map_err(CliError::no_result)?;
                announce(&server.address().to_string(), &args, &world)?;
                stop.await;
            }
            None => {
                let server = serve_pty(controller)
                    .context("the system gives no pseudo-terminal")
                    .map_err(CliError::no_result)?;
                announce(&server.path().display().to_string(), &args, &world)?;
                stop.await;
            }
        }
        Ok(())
    })
}

fn parse_address(text: &str) -> Result<SocketAddr, CliError> {
    text.to_socket_addrs()
        .ok()
        .and_then(|mut found| found.next())
        .ok_or_else(|| {
            let error = anyhow!("{text:?} is not an address; write it like 127.0.0.1:55550");
            CliError::bad_input(error)
        })
}

fn announce(place: &str, args: &Args, world: &World) -> Result<(), CliError> {
    let mut out = std::io::stdout().lock();
    let mut text = format!("listening on {place}\n");
    if args.describe {
        text.push_str(&format!("{:#}\n", describe(world, args)));
    }
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .context("standard output is closed")
        .map_err(CliError::no_result)
}

/// Describes the rig for a client.
fn describe(world: &World, args: &Args) -> Value {
    let axis = |name: AxisName, address: u8, axis: u8| {
        let m = world.mechanics(name);
        json!({
            "name": name,
            "address": address,
            "axis": axis,
            "counts_per_turn": m.counts_per_turn,
            "zero_deg": m.zero.deg(),
            "travel_min_deg": m.travel_min.deg(),
            "travel_max_deg": m.travel_max.deg(),
            "speed_deg_s": m.speed_deg_s,
            "acceleration_deg_s2": m.acceleration_deg_s2,
            "backlash_deg": m.backlash.deg(),
        })
    };
    let turn = match args.one_controller {
        true => axis(AxisName::PhiS, 1, 2),
        false => axis(AxisName::PhiS, 2, 1),
    };
    json!({
        "protocol": "zaber-ascii, firmware 7",
        "baud": 115_200,
        "time_scale": args.time_scale,
        "axes": [axis(AxisName::ThetaC, 1, 1), turn],
    })
}
