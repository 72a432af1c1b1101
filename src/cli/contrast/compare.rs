//! `--compare`: a prediction beside a table of radiances from another source.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use serde::Serialize;

use crate::cli::CliError;
use crate::contrast::ReportedFindings;
use crate::model::contrast::{Exposure, Findings, PAIRS, Table};
use crate::units::Angle;

/// Differences of absolute contrasts over the lines that both tables have, at least one.
#[derive(Debug, Clone)]
pub(super) struct TableComparison {
    file: PathBuf,
    n_contrasts: usize,
    rms: f64,
    worst: f64,
    /// In the file.
    largest_contrast: f64,
    /// In the file.
    findings: Option<Findings>,
}

impl TableComparison {
    /// The same with relative differences.
    pub(super) fn report(&self) -> ReportedComparison {
        ReportedComparison {
            file: self.file.display().to_string(),
            n_contrasts: self.n_contrasts,
            rms: self.rms,
            worst: self.worst,
            largest_contrast: self.largest_contrast,
            rms_relative: self.rms / self.largest_contrast,
            worst_relative: self.worst / self.largest_contrast,
            findings: self.findings.map(ReportedFindings::from),
        }
    }
}

/// A comparison as `--json` prints it; relative differences are null for a file without contrast.
#[derive(Debug, Serialize)]
pub(super) struct ReportedComparison {
    file: String,
    n_contrasts: usize,
    rms: f64,
    worst: f64,
    largest_contrast: f64,
    rms_relative: f64,
    worst_relative: f64,
    findings: Option<ReportedFindings>,
}

impl fmt::Display for TableComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (file, n) = (self.file.display(), self.n_contrasts);
        write!(f, "against {file}: {n} contrasts, ")?;
        if self.largest_contrast > 0.0 {
            let share = |difference: f64| 100.0 * difference / self.largest_contrast;
            let (rms, worst) = (share(self.rms), share(self.worst));
            write!(
                f,
                "rms difference {rms:.3} %, worst {worst:.3} % of the largest"
            )
        } else {
            let (rms, worst) = (self.rms, self.worst);
            write!(
                f,
                "rms difference {rms:.3e}, worst {worst:.3e}; the file has no contrast"
            )
        }
    }
}

/// Reads the radiances of a table; rows of another alpha are left out.
///
/// # Errors
/// Bad input for a file that is not such a table.
pub(super) fn read_radiances(path: &Path, alpha: f64) -> Result<Table, CliError> {
    let bad = |why: String| CliError::bad_input(anyhow!("{}: {why}", path.display()));
    let mut reader = csv::Reader::from_path(path)
        .with_context(|| format!("cannot read {}", path.display()))
        .map_err(CliError::bad_input)?;
    let headers = reader.headers().map_err(|e| bad(e.to_string()))?.clone();
    let find = |name: &str| headers.iter().position(|h| h.trim() == name);
    let need = |name: &str| find(name).ok_or_else(|| bad(format!("lacks the column {name}")));
    let columns = [
        need("theta_r_deg")?,
        need("theta_c_deg")?,
        need("phi_s_deg")?,
        need("radiance")?,
    ];
    let alpha_column = find("alpha");
    let mut exposures = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| bad(e.to_string()))?;
        let number = |column: usize| {
            record[column]
                .trim()
                .parse::<f64>()
                .map_err(|_| bad(format!("{:?} is not a number", &record[column])))
        };
        if let Some(column) = alpha_column
            && (number(column)? - alpha).abs() > 1e-9
        {
            continue;
        }
        let [theta_r, theta_c, phi_s, radiance] = columns;
        exposures.push(Exposure {
            theta_r: Angle::from_deg(number(theta_r)?),
            theta_c: Angle::from_deg(number(theta_c)?),
            phi_s: Angle::from_deg(number(phi_s)?),
            radiance: number(radiance)?,
        });
    }
    let table = Table::of(&exposures);
    if table.lines.is_empty() {
        return Err(bad(format!(
            "no line has the azimuths 0, 90 and 180 degrees (alpha {alpha})"
        )));
    }
    Ok(table)
}

/// Compares a prediction with the table of the file at `path`.
///
/// # Errors
/// Bad input where they have no line in common.
pub(super) fn comparison(
    ours: &Table,
    theirs: &Table,
    path: &Path,
) -> Result<TableComparison, CliError> {
    let near = |x: Angle, y: Angle| (x - y).abs() < Angle::from_deg(5e-4);
    let mut differences = Vec::new();
    let mut largest_contrast: f64 = 0.0;
    for a in &ours.lines {
        for b in &theirs.lines {
            if near(a.theta_r, b.theta_r) && near(a.theta_c, b.theta_c) {
                for pair in 0..PAIRS.len() {
                    largest_contrast = largest_contrast.max(b.contrast[pair].absolute);
                    differences.push(a.contrast[pair].absolute - b.contrast[pair].absolute);
                }
            }
        }
    }
    if differences.is_empty() {
        return Err(CliError::bad_input(anyhow!(
            "{} has no ridge angle and tilt in common with the prediction",
            path.display()
        )));
    }
    let n = differences.len() as f64;
    Ok(TableComparison {
        file: path.to_owned(),
        n_contrasts: differences.len(),
        rms: (differences.iter().map(|d| d * d).sum::<f64>() / n).sqrt(),
        worst: differences.iter().map(|d| d.abs()).fold(0.0, f64::max),
        largest_contrast,
        findings: theirs.findings(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::contrast::predicted;
    use crate::cli::parsed;

    #[test]
    fn the_comparison_takes_the_rows_of_its_alpha() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/data/contrast-raytraced-paper-rig.csv");
        let other = read_radiances(&path, 0.06).unwrap();
        let (table, _) = predicted(&parsed(&["--alpha", "0.06", "--rho-d", "0.342"])).unwrap();
        let found = comparison(&table, &other, &path).unwrap();
        assert_eq!(found.n_contrasts, 40);
        assert!(found.rms / found.largest_contrast < 0.002);
        assert!(
            found
                .to_string()
                .contains("40 contrasts, rms difference 0.")
        );
        assert_eq!(found.report().n_contrasts, 40);
        assert!(read_radiances(&path, 0.5).is_err());
    }

    #[test]
    fn tables_with_nothing_in_common_are_not_compared() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/contrast-raytraced.csv");
        let args: crate::cli::contrast::Args = parsed(&["--theta-r-deg", "7"]);
        let other = read_radiances(&path, args.scene.alpha).unwrap();
        let (table, _) = predicted(&args).unwrap();
        let Err(CliError::BadInput(refused)) = comparison(&table, &other, &path) else {
            panic!("7 degrees are not in the file");
        };
        let said = refused.to_string();
        assert!(
            said.ends_with("has no ridge angle and tilt in common with the prediction"),
            "{said}"
        );
    }
}
