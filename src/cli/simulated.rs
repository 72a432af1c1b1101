//! Options of the simulated rig, shared by `serve`, `scan` and `demo`.

use std::path::PathBuf;

use anyhow::Context;

use super::CliError;
use crate::sim::faults::plan::FaultPlan;
use crate::sim::rig::{Construction, SimulationError};

/// How a simulated rig is built: near or far, and which parts are off their place.
#[derive(Debug, Clone, Copy, PartialEq, Default, clap::Args)]
#[command(next_help_heading = "How the simulated rig is built")]
pub struct ConstructionArgs {
    /// Distance of the camera's pupil from the centre of tilt, 100 mm or more [default: a telecentric lens].
    #[arg(long, value_name = "MM")]
    pub camera_distance_mm: Option<f64>,
    /// Distance of the lamp from the centre of tilt, 100 mm or more [default: a collimated lamp].
    #[arg(long, value_name = "MM")]
    pub light_distance_mm: Option<f64>,
    /// From the frame's centre to the rotation axis, in pixels, for example -6,4.5.
    #[arg(long, value_name = "COLUMNS,ROWS", value_parser = point, allow_hyphen_values = true)]
    pub axis_offset_px: Option<Point>,
    /// From the frame's centre to the centre of tilt, in pixels.
    #[arg(long, value_name = "COLUMNS,ROWS", value_parser = point, allow_hyphen_values = true)]
    pub tilt_centre_offset_px: Option<Point>,
    /// Inclination of the sample's plane to the turntable, up to 5°.
    #[arg(long, value_name = "DEG")]
    pub wedge_deg: Option<f64>,
    /// Azimuth to which the sample's normal is inclined, from the lean direction v, in degrees.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub wedge_azimuth_deg: Option<f64>,
}

impl From<ConstructionArgs> for Construction {
    fn from(args: ConstructionArgs) -> Self {
        Construction {
            camera_distance_mm: args.camera_distance_mm,
            light_distance_mm: args.light_distance_mm,
            axis_offset_px: args.axis_offset_px,
            tilt_centre_offset_px: args.tilt_centre_offset_px,
            wedge_deg: args.wedge_deg,
            wedge_azimuth_deg: args.wedge_azimuth_deg,
        }
    }
}

/// Faults that are put into a simulated rig on purpose.
#[derive(Debug, Clone, PartialEq, Default, clap::Args)]
#[command(next_help_heading = "Faults of the simulated rig")]
pub struct FaultArgs {
    /// Plan of faults (TOML); docs/examples/faults.toml shows all kinds.
    #[arg(long, value_name = "FILE")]
    pub faults: Option<PathBuf>,
    /// Seed of the faults that have a probability below 1.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "faults")]
    pub fault_seed: u64,
}

impl FaultArgs {
    /// Reads the plan, and returns it with its seed.
    ///
    /// # Errors
    /// Bad input for a file that cannot be read or that is no such plan.
    pub fn read(&self) -> Result<Option<(FaultPlan, u64)>, CliError> {
        let Some(file) = &self.faults else {
            return Ok(None);
        };
        let text = std::fs::read_to_string(file)
            .with_context(|| format!("cannot read {}", file.display()))
            .map_err(CliError::bad_input)?;
        let plan = FaultPlan::read(&text)
            .with_context(|| format!("{} is not a plan of faults", file.display()))
            .map_err(CliError::bad_input)?;
        Ok(Some((plan, self.fault_seed)))
    }
}

/// Columns and rows.
pub type Point = [f64; 2];

fn point(text: &str) -> Result<Point, String> {
    let numbers: Vec<Option<f64>> = text.split(',').map(|x| x.trim().parse().ok()).collect();
    match numbers[..] {
        [Some(column), Some(row)] => Ok([column, row]),
        _ => Err(
            "expected columns and rows with a comma between them, for example -6,4.5".to_owned(),
        ),
    }
}

impl From<SimulationError> for CliError {
    fn from(error: SimulationError) -> Self {
        match error {
            SimulationError::OutOfRange {
                setting,
                value,
                least,
                most,
            } => CliError::bad_input(anyhow::anyhow!(
                "--{} {value} is out of range: expected {least} to {most}",
                setting.replace('_', "-")
            )),
            error @ SimulationError::NoPseudoTerminal(_) => CliError::no_result(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::rig::{SimulatedRig, Simulation};

    #[test]
    fn a_rig_that_cannot_be_built_is_refused_by_its_option() {
        let near = ConstructionArgs {
            camera_distance_mm: Some(20.0),
            ..ConstructionArgs::default()
        };
        let simulation = Simulation {
            construction: near.into(),
            ..Simulation::default()
        };
        let error = SimulatedRig::build(simulation).err().map(CliError::from);
        match error {
            Some(CliError::BadInput(error)) => assert_eq!(
                error.to_string(),
                "--camera-distance-mm 20 is out of range: expected 100 to 1000000"
            ),
            other => panic!("{other:?}"),
        }
        assert_eq!(point("-6, 4.5"), Ok([-6.0, 4.5]));
        assert!(point("6").is_err() && point("a,b").is_err() && point("1,2,3").is_err());
    }
}
