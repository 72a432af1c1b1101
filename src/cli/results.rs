//! `ridged results`: one row per scan of the store, as a table, JSON or CSV.

mod table;

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use serde::Serialize;

use super::result_filters::FilterArgs;
use super::runtime::{self, block_on};
use super::{CliError, terminal};
use crate::store::Store;
use crate::store::disk::RealDisk;
use crate::store::results::{LIMIT_USUAL, ResultPages, ResultQuery, ResultRow, csv_header};
use crate::wording::layout::wrapped;

/// Lists results: one row per scan, newest first, with the value of its newest fit and its newest verdict.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged results                                      the newest 100 scans
  ridged results --latest --verdict fail,cannot-tell  parts that do not pass now
  ridged results --filter theta_r_deg_min=10.2 --sort=-theta_r_deg
  ridged results --since 2026-03-01 --csv > march.csv
docs/reference/results.md lists all columns. `--filter` takes NAME=VALUE for texts, words and numbers of rows, and NAME_min=VALUE \
and NAME_max=VALUE for numbers and times.")]
pub struct Args {
    /// Which rows.
    #[command(flatten)]
    pub filters: FilterArgs,
    /// Column to sort by, with - in front for descending.
    #[arg(long, value_name = "COLUMN", allow_hyphen_values = true)]
    pub sort: Option<String>,
    /// Columns, separated by commas, or `all`.
    #[arg(long, value_name = "COLUMNS")]
    pub fields: Option<String>,
    /// Largest number of rows [default: 100, and all with --csv].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub limit: Option<u32>,
    /// One JSON object on stdout, with the number of all rows that the filters select.
    #[arg(long, conflicts_with = "csv")]
    pub json: bool,
    /// A CSV on stdout.
    #[arg(long)]
    pub csv: bool,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
}

/// Rows with the number of all rows.
#[derive(Serialize)]
struct Listed<T> {
    items: Vec<T>,
    count: i64,
}

/// Runs the command, also beside a running daemon.
///
/// # Errors
/// Bad input for a folder without a store, or a filter that is not valid.
pub fn run(args: Args) -> Result<(), CliError> {
    let mut query = query(&args)?;
    query.limit = match (args.limit, args.csv) {
        (None, false) => Some(LIMIT_USUAL),
        (limit, _) => limit,
    };
    block_on(async {
        let store = Store::open_for_reading(&args.data, Arc::new(RealDisk), runtime::real_clock());
        let store = store
            .await
            .map_err(|error| runtime::lab_error(error.into()))?;
        let done = print(&store, query, &args).await;
        store.close().await;
        done
    })
}

/// Reads the options as the parameters of a query.
fn query(args: &Args) -> Result<ResultQuery, CliError> {
    let mut parameters = args.filters.parameters()?;
    let page = [("sort", &args.sort), ("fields", &args.fields)];
    let page = page.into_iter();
    parameters.extend(page.filter_map(|(name, value)| Some((name, value.as_deref()?))));
    ResultQuery::read(parameters).map_err(CliError::bad_input)
}

async fn print(store: &Store, query: ResultQuery, args: &Args) -> Result<(), CliError> {
    let fault = |error: crate::store::StoreError| runtime::lab_error(error.into());
    let fields = query.fields.clone();
    let mut pages = ResultPages::new(store.clone(), query.clone());
    if args.csv {
        write(&csv_header(&fields))?;
        while let Some(rows) = pages.next().await.map_err(fault)? {
            let lines: String = rows.iter().map(|row| row.csv_line(&fields)).collect();
            write(&lines)?;
        }
        return Ok(());
    }
    let count = store.count_results(&query).await.map_err(fault)?;
    let mut rows: Vec<ResultRow> = Vec::new();
    while let Some(page) = pages.next().await.map_err(fault)? {
        rows.extend(page);
    }
    if args.json {
        let items = rows.iter().map(|row| row.object(&fields)).collect();
        let listed = Listed { items, count };
        let text = serde_json::to_string_pretty(&listed).map_err(CliError::no_result)?;
        return write(&format!("{text}\n"));
    }
    let asked = args.fields.is_some().then_some(fields.as_slice());
    let terminal = terminal::columns();
    let text = table::of(&rows, asked, terminal);
    write(&terminal.map_or(text.clone(), |columns| wrapped(&text, columns)))?;
    match usize::try_from(count) {
        Ok(0) => super::say("no results; `ridged results --help` shows the filters"),
        Ok(count) if count > rows.len() => super::say(&format!(
            "{} of {count} rows; --limit N shows more, --csv writes all",
            rows.len()
        )),
        _ => {}
    }
    Ok(())
}

fn write(text: &str) -> Result<(), CliError> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(CliError::no_result)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(words: &[&str]) -> Result<ResultQuery, String> {
        query(&super::super::parsed::<Args>(words)).map_err(|error| match error {
            CliError::BadInput(error) => error.to_string(),
            other => panic!("{other:?}"),
        })
    }

    #[test]
    fn options_are_the_parameters_of_the_interface() {
        let words = [
            "--part",
            "B-17",
            "--latest",
            "--sort",
            "-theta_r_deg",
            "--filter",
            "alpha_u_max = 0.2",
        ];
        let parameters = [
            ("part", "B-17"),
            ("latest", "true"),
            ("sort", "-theta_r_deg"),
            ("alpha_u_max", "0.2"),
        ];
        let same = ResultQuery::read(parameters).unwrap();
        let mut read = read(&words).unwrap();
        assert_ne!(read, ResultQuery::default());
        read.limit = same.limit;
        assert_eq!(read, same);
    }

    #[test]
    fn a_wrong_filter_is_refused_with_the_way_out() {
        for (filter, part) in [
            ("theta_r_deg", "expected NAME=VALUE"),
            ("limit=5", "expected NAME=VALUE"),
            ("theta_r_degs_min=5", "did you mean `theta_r_deg_min`?"),
            ("verdict=fial", "expected pass, fail"),
        ] {
            let said = read(&["--filter", filter]).unwrap_err();
            assert!(said.contains(part), "{filter}: {said}");
        }
    }
}
