//! `ridged eval`: closed forms over a table of cases.
//!
//! The output has the input's columns, then the computed ones with 17 significant digits; a computed name that the input
//! already has gets the suffix `_ridged`. A row without a result has empty computed fields and the reason in the column
//! `refused`. A new table is one file in `eval/` with a `Table`, and one line in [`Kind::table`].

mod brdf;
mod mueller;
mod sawtooth;
mod stack;
mod visibility;

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, anyhow};

use super::CliError;
use super::output_collision::same_file;
use crate::wording::counted;
use crate::wording::sheet::other_separator;

/// Evaluates closed forms over a table.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    ridged eval stack --cases stacks.csv --out answers.csv\n  \
    ridged eval brdf --cases directions.csv --out radiances.csv")]
pub struct Args {
    /// Which closed form.
    #[arg(value_enum)]
    pub kind: Kind,
    /// CSV file with one case per row.
    #[arg(long, value_name = "IN.csv")]
    pub cases: PathBuf,
    /// CSV file to write: the input's columns and the computed ones.
    #[arg(long, value_name = "OUT.csv")]
    pub out: PathBuf,
}

/// The closed forms that can be tabulated.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Kind {
    /// theta_i, phi_i, theta_o, phi_o, theta_r (rad), alpha_u, alpha_v, rho_d, eta, k → f, d, g,
    /// fresnel of the printed BRDF.
    Brdf,
    /// theta_i, phi_i, theta_o, phi_o, theta_r (rad), alpha_u, alpha_v, rho_d, eta, k, theta_l (rad), translucency, tail,
    /// crest_radius, land_share → f of the sawtooth.
    Sawtooth,
    /// theta_r_deg, theta_i_proj_deg, theta_o_proj_deg → visible_and_lit_fraction of the sawtooth.
    Visibility,
    /// n, k, alpha, theta_i_deg, theta_s_deg, phi_s_deg → m00…m33 of the unmasked single bounce.
    Mueller,
    /// stack, theta_deg → Rs, Rp, m22_re_z, m23_im_z, R_polarised, R_scalar of flat layers.
    Stack,
}

impl Kind {
    /// What the closed form omits, and why.
    const fn left_out(self) -> &'static str {
        match self {
            Kind::Brdf => {
                "risers, diffuse walls and light that bounces twice (the lobe as printed), averages over cones"
            }
            Kind::Sawtooth => {
                "the quadrature of light that bounces twice (a closed approximation takes its place), a third specular \
                reflection, and averages over cones"
            }
            Kind::Visibility => "nothing: the geometry of an ideal sawtooth is exact",
            Kind::Mueller => {
                "masking, shadowing and all bounces after the first (by definition of this form)"
            }
            Kind::Stack => {
                "interference between the faces of a layer (they are treated as incoherent)"
            }
        }
    }

    fn table(self) -> Table {
        match self {
            Kind::Brdf => brdf::TABLE,
            Kind::Sawtooth => sawtooth::TABLE,
            Kind::Visibility => visibility::TABLE,
            Kind::Mueller => mueller::TABLE,
            Kind::Stack => stack::TABLE,
        }
    }
}

/// One closed form as a table: what it reads, what it writes, how.
pub(super) struct Table {
    /// Columns that the input must have.
    pub inputs: &'static [&'static str],
    /// Columns that are written.
    pub outputs: &'static [&'static str],
    /// Computes a row, in the order of `outputs`, or returns why it has no result.
    pub compute: fn(&InputCase<'_>) -> Result<Vec<f64>, String>,
}

/// The needed columns of one case, in the order of [`Table::inputs`].
pub(super) struct InputCase<'a> {
    names: &'static [&'static str],
    fields: Vec<&'a str>,
}

impl InputCase<'_> {
    /// The text in a column.
    pub fn text(&self, column: usize) -> &str {
        self.fields[column].trim()
    }

    /// The finite number in a column.
    pub fn number(&self, column: usize) -> Result<f64, String> {
        let text = self.text(column);
        match text.parse::<f64>() {
            Ok(x) if x.is_finite() => Ok(x),
            _ => Err(format!(
                "{} = {text:?} is not a finite number",
                self.names[column]
            )),
        }
    }
}

/// Runs `ridged eval`.
///
/// # Errors
/// Bad input where the file cannot be read, lacks a column or the output cannot be written.
pub fn run(args: Args) -> Result<(), CliError> {
    let started = Instant::now();
    let (rows, refused) = evaluate(&args.kind.table(), &args.cases, &args.out)?;
    // The table's form is fixed, so time and omissions are printed to stderr.
    super::say(&format_args!(
        "{} in {:.2} s, {refused} refused (column `refused`); exact to the digits that each row's conditioning \
        allows; left out: {}",
        counted(rows, "row"),
        started.elapsed().as_secs_f64(),
        args.kind.left_out()
    ));
    Ok(())
}

/// Number of rows, and of rows without a result.
fn evaluate(table: &Table, cases: &Path, out: &Path) -> Result<(usize, usize), CliError> {
    let (mut rows, mut refused) = (0, 0);
    let mut reader = csv::ReaderBuilder::new()
        .flexible(true)
        .from_path(cases)
        .with_context(|| format!("cannot read the cases {}", cases.display()))
        .map_err(CliError::bad_input)?;
    let headers = reader
        .headers()
        .with_context(|| format!("{} has no header", cases.display()))
        .map_err(CliError::bad_input)?
        .clone();
    let find = |name: &str| headers.iter().position(|h| h.trim() == name);
    let columns = table
        .inputs
        .iter()
        .map(|name| {
            find(name).ok_or_else(|| {
                let way_out = other_separator(&headers)
                    .map(|way_out| format!(": {way_out}"))
                    .unwrap_or_default();
                CliError::bad_input(anyhow!(
                    "{} lacks the column {name}{way_out}",
                    cases.display()
                ))
            })
        })
        .collect::<Result<Vec<_>, _>>()?;
    if same_file(cases, out) {
        return Err(CliError::bad_input(anyhow!(
            "--out is the file of the cases, {}: choose another name for the results",
            cases.display()
        )));
    }
    let mut writer = csv::Writer::from_path(out)
        .with_context(|| format!("cannot write {}", out.display()))
        .map_err(CliError::bad_input)?;
    let written = |name: &str| match find(name) {
        Some(_) => format!("{name}_ridged"),
        None => name.to_owned(),
    };
    let mut head: Vec<String> = headers.iter().map(str::to_owned).collect();
    head.extend(table.outputs.iter().copied().map(written));
    head.push(written("refused"));
    let unwritten = |e: csv::Error| {
        CliError::no_result(anyhow!(e).context(format!("cannot write {}", out.display())))
    };
    writer.write_record(&head).map_err(unwritten)?;
    for record in reader.byte_records() {
        let record = record
            .with_context(|| format!("cannot read a row of {}", cases.display()))
            .map_err(CliError::bad_input)?;
        let texts: Vec<Cow<'_, str>> = record.iter().map(String::from_utf8_lossy).collect();
        // Text that is UTF-8 is borrowed as it is.
        let garbled = texts.iter().position(|t| matches!(t, Cow::Owned(_)));
        let answer = if texts.len() != headers.len() {
            Err(format!(
                "the row has {} fields, the header {}",
                texts.len(),
                headers.len()
            ))
        } else if let Some(column) = garbled {
            Err(format!(
                "{} = {:?} is not UTF-8 text",
                headers[column].trim(),
                texts[column]
            ))
        } else {
            (table.compute)(&InputCase {
                names: table.inputs,
                fields: columns.iter().map(|&i| &*texts[i]).collect(),
            })
        };
        let mut fields: Vec<String> = (0..headers.len())
            .map(|i| texts.get(i).map_or_else(String::new, |t| t.to_string()))
            .collect();
        let reason = match answer {
            Ok(values) if values.iter().all(|v| v.is_finite()) => {
                fields.extend(values.iter().map(|v| format!("{v:.16e}")));
                String::new()
            }
            Ok(_) => "the result is not a finite number".to_owned(),
            Err(reason) => reason,
        };
        rows += 1;
        refused += usize::from(!reason.is_empty());
        fields.resize(headers.len() + table.outputs.len(), String::new());
        fields.push(reason);
        writer.write_record(&fields).map_err(unwritten)?;
    }
    writer
        .flush()
        .with_context(|| format!("cannot write {}", out.display()))
        .map_err(CliError::no_result)?;
    Ok((rows, refused))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run_on(kind: Kind, input: impl AsRef<[u8]>) -> Vec<csv::StringRecord> {
        let folder = tempfile::tempdir().unwrap();
        let (cases, out) = (folder.path().join("in.csv"), folder.path().join("out.csv"));
        std::fs::write(&cases, input).unwrap();
        evaluate(&kind.table(), &cases, &out).unwrap();
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .from_path(&out)
            .unwrap();
        reader.records().map(|r| r.unwrap()).collect()
    }

    #[test]
    fn a_computed_name_that_is_taken_gets_a_suffix_and_a_bad_row_a_reason() {
        let rows = run_on(
            Kind::Stack,
            "id,stack,theta_deg,Rs\na,1.5,10,0\nb,1.5/Xy,10,0\nc,1.5,95,0\nd,1.5,,0\ne,1.5\n",
        );
        let head: Vec<&str> = rows[0].iter().collect();
        assert_eq!(
            head,
            "id,stack,theta_deg,Rs,Rs_ridged,Rp,m22_re_z,m23_im_z,R_polarised,R_scalar,refused"
                .split(',')
                .collect::<Vec<_>>()
        );
        assert!((rows[1][4].parse::<f64>().unwrap() - 0.041_659_486_67).abs() < 1e-11);
        assert_eq!(rows[1][4].trim_start_matches('-').find('e'), Some(18));
        assert_eq!(&rows[1][10], "");
        for bad in &rows[2..] {
            assert_eq!(&bad[4], "");
            assert!(!bad[10].is_empty());
        }
        assert_eq!(rows.len(), 6);
    }

    #[test]
    fn the_reference_table_is_answered_row_by_row_with_its_text_kept() {
        let rows = run_on(
            Kind::Brdf,
            include_str!("../../tests/data/brdf/reference.csv"),
        );
        assert_eq!(rows.len(), 3001);
        let head: Vec<&str> = rows[0].iter().collect();
        assert_eq!(
            &head[16..],
            [
                "f_ridged",
                "d_ridged",
                "g_ridged",
                "fresnel_ridged",
                "refused"
            ]
        );
        for row in &rows[1..] {
            let x = |i: usize| row[i].parse::<f64>().unwrap();
            let (f, cond, ours) = (x(11), x(15), x(16));
            assert!(
                (ours - f).abs() <= 4.0 * 0.5 * f64::EPSILON * (1.0 + cond) * f,
                "{row:?}"
            );
            assert_eq!(&row[20], "");
        }
    }

    #[test]
    fn the_sawtooth_is_answered_with_and_without_the_terms_of_real_samples() {
        let head = "theta_i,phi_i,theta_o,phi_o,theta_r,alpha_u,alpha_v,rho_d,eta,k,theta_l,translucency,tail,crest_radius,land_share";
        let flat = "0.3,1.5,0.3,-1.6415926535897931,0,0.1,0.1,0,1.5,0,0.2,0";
        let rows = run_on(
            Kind::Sawtooth,
            format!(
                "{head}\n{flat},0,0,0\n{flat},1,0,0\n{flat},9,0,0\n0,0,2,0,0,0.1,0.1,0,1.5,0,0.2,0,0,0,0\n{flat},0,0,0.3\n"
            ),
        );
        let f = |row: usize| rows[row][15].parse::<f64>().unwrap();
        // A mirror's angle on a flat surface: D F/(4 cos² θ), with D = 1/(π α²).
        let fresnel = crate::model::fresnel::reflectance(0.3f64.cos(), 1.5, 0.0);
        let expected = fresnel / (4.0 * std::f64::consts::PI * 0.01 * 0.3f64.cos().powi(2));
        assert!((f(1) / expected - 1.0).abs() < 1e-9, "{} {expected}", f(1));
        // All slope distributions have this peak.
        assert!((f(2) / expected - 1.0).abs() < 1e-9, "{} {expected}", f(2));
        // Lands between ridges of no height are more of the same surface.
        assert!((f(5) / expected - 1.0).abs() < 1e-9, "{} {expected}", f(5));
        assert_eq!(&rows[3][16], "tail = 9 is not within 0 and 1.5");
        assert!(rows[4][16].contains("above the surface"));
    }

    #[test]
    fn visibility_rows_out_of_range_are_refused_and_edge_on_is_dark() {
        let rows = run_on(
            Kind::Visibility,
            "theta_r_deg,theta_i_proj_deg,theta_o_proj_deg\n10,0,0\nnan,0,0\n95,0,0\n20,-70,0\n",
        );
        assert_eq!(&rows[1][3], "1.0000000000000000e0");
        assert_eq!(&rows[2][4], "theta_r_deg = \"nan\" is not a finite number");
        assert_eq!(&rows[3][4], "theta_r_deg = 95 is not within 0 and 90");
        assert_eq!(&rows[4][3], "0.0000000000000000e0");
    }

    #[test]
    fn a_row_that_is_not_text_is_refused_and_the_others_are_computed() {
        let rows = run_on(
            Kind::Stack,
            b"id,stack,theta_deg\na,1.5,1\xff0\nb\xe9,1.5,10\nc,1.5,10\n",
        );
        assert_eq!(rows.len(), 4);
        assert_eq!(
            (&rows[1][2], &rows[2][0]),
            ("1\u{fffd}0", "b\u{fffd}"),
            "what can be shown of the input is"
        );
        let (last, answered) = (rows[0].len() - 1, &rows[3]);
        assert_eq!(
            &rows[1][last],
            "theta_deg = \"1\u{fffd}0\" is not UTF-8 text"
        );
        assert_eq!(&rows[2][last], "id = \"b\u{fffd}\" is not UTF-8 text");
        assert_eq!((&rows[2][3], &answered[last]), ("", ""));
        answered[3].parse::<f64>().unwrap();
    }

    #[test]
    fn the_cases_are_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let cases = folder.path().join("in.csv");
        let text = "stack,theta_deg\n1.5,30\n";
        std::fs::write(&cases, text).unwrap();
        let again = folder.path().join(".").join("in.csv");
        let (soft, hard) = (folder.path().join("soft.csv"), folder.path().join("h.csv"));
        std::os::unix::fs::symlink(&cases, &soft).unwrap();
        std::fs::hard_link(&cases, &hard).unwrap();
        for again in [again, soft, hard] {
            let outcome = evaluate(&stack::TABLE, &cases, &again);
            assert!(matches!(outcome, Err(CliError::BadInput(_))));
            assert_eq!(std::fs::read_to_string(&cases).unwrap(), text, "{again:?}");
        }
    }

    #[test]
    fn a_file_without_a_needed_column_is_bad_input() {
        let folder = tempfile::tempdir().unwrap();
        let cases = folder.path().join("in.csv");
        std::fs::write(&cases, "stack\n1.5\n").unwrap();
        let outcome = evaluate(&stack::TABLE, &cases, &folder.path().join("out.csv"));
        assert!(matches!(outcome, Err(CliError::BadInput(_))));
        std::fs::write(&cases, "stack;theta_i_deg\n1,5;3,0\n").unwrap();
        match evaluate(&stack::TABLE, &cases, &folder.path().join("out.csv")) {
            Err(CliError::BadInput(e)) => assert!(e.to_string().contains("by commas"), "{e}"),
            _ => panic!("fields between semicolons are no columns"),
        }
    }
}
