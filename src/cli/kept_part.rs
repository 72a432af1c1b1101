//! Parts of runs in files: what an output must not overwrite.
//!
//! A file of `ridged trace` is a table with the columns `exact` and `run` (`cli::trace`), that of another command begins with
//! a line of JSON (`cli::shards`).

use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;

use anyhow::anyhow;
use serde::Deserialize;

use super::CliError;
use crate::shard::Shard;

/// Longest first line that is read, in bytes.
const HEAD_BYTES_MAX: u64 = 1 << 16;
/// Most bytes of a trace that are read.
const ROW_BYTES_MAX: u64 = 1 << 26;

/// The part of a run that a file holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptPart {
    /// Command that wrote it.
    pub command: String,
    /// Which part it is; none where the file does not state it.
    pub shard: Option<Shard>,
    /// Whether it was finished.
    pub is_complete: bool,
    /// Identifies the run of a trace.
    pub run_id: Option<String>,
}

/// First line of a shard's file.
#[derive(Deserialize)]
struct Head {
    #[serde(rename = "ridged_shard")]
    _form: u32,
    run: Run,
    shard: u64,
    of: u64,
}

#[derive(Deserialize)]
struct Run {
    command: String,
}

/// Column `run` of a trace, in its first row.
#[derive(Deserialize)]
struct Traced {
    run: String,
    shard: u64,
    of: u64,
    complete: bool,
}

impl KeptPart {
    /// Reads which part of a run a file holds; none for other files.
    pub fn read(path: &Path) -> Option<KeptPart> {
        let head = first_line(path)?;
        if let Ok(head) = serde_json::from_slice::<Head>(&head) {
            return Some(KeptPart {
                command: head.run.command,
                shard: Some(Shard {
                    number: head.shard,
                    of: head.of,
                }),
                is_complete: true,
                run_id: None,
            });
        }
        let head = String::from_utf8(head).ok()?;
        let has = |name: &str| head.trim_end().split(',').any(|column| column == name);
        (has("exact") && has("run")).then(|| {
            let traced = traced(path);
            KeptPart {
                command: "trace".to_owned(),
                shard: traced.as_ref().map(|part| Shard {
                    number: part.shard,
                    of: part.of,
                }),
                is_complete: traced.as_ref().is_some_and(|part| part.complete),
                run_id: traced.map(|part| part.run),
            }
        })
    }

    /// Refuses to overwrite it.
    fn refusal(&self, path: &Path) -> CliError {
        let (path, command) = (path.display(), &self.command);
        let what = match self.shard {
            Some(shard) if self.is_complete => format!("shard {shard}"),
            Some(Shard::WHOLE) | None => "a stopped run".to_owned(),
            Some(shard) => format!("the stopped shard {shard}"),
        };
        let resume = match self.is_complete {
            true => String::new(),
            false => format!("continue it with --resume {path}, "),
        };
        CliError::bad_input(anyhow!(
            "{path} holds {what} of ridged {command}: {resume}choose another name, or remove the file"
        ))
    }
}

/// Returns the first line of a file, or its start; none for what is not a file.
pub fn first_line(path: &Path) -> Option<Vec<u8>> {
    // A pipe or a device holds nothing, and reading it would wait.
    if !path.metadata().is_ok_and(|metadata| metadata.is_file()) {
        return None;
    }
    let mut line = Vec::new();
    let mut file = BufReader::new(File::open(path).ok()?.take(HEAD_BYTES_MAX));
    file.read_until(b'\n', &mut line).ok()?;
    Some(line)
}

fn traced(path: &Path) -> Option<Traced> {
    let mut reader = csv::Reader::from_reader(File::open(path).ok()?.take(ROW_BYTES_MAX));
    let run = reader.headers().ok()?.iter().position(|h| h == "run")?;
    let first = reader.records().next()?.ok()?;
    serde_json::from_str(first.get(run)?).ok()
}

/// Refuses an output file that holds a stopped run or a shard.
///
/// # Errors
/// Bad input, with the ways out.
pub fn none_in(path: &Path) -> Result<(), CliError> {
    match KeptPart::read(path) {
        Some(part) => Err(part.refusal(path)),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_with_a_part_of_a_run_are_refused_with_the_ways_out() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        let refused = |content: &str| {
            std::fs::write(&file, content).unwrap();
            let refusal = none_in(&file).err();
            refusal.map(|error| match error {
                CliError::BadInput(error) => error.to_string(),
                other => panic!("{other:?}"),
            })
        };
        let head = r#"{"ridged_shard":1,"run":{"command":"wear","facts":[]},"shard":1,"of":4,"seconds":1.0,"sha256":""}"#;
        let text = refused(&format!("{head}\n\0\0")).unwrap();
        assert!(
            text.contains("holds shard 1/4 of ridged wear: choose another name"),
            "{text}"
        );
        let traced = |shard: u64, of: u64, complete: bool| {
            let part = format!(
                r#"{{""run"":""r"",""shard"":{shard},""of"":{of},""complete"":{complete}}}"#
            );
            refused(&format!("side,hits,exact,plane,run\nup,0,,,\"{part}\"\n")).unwrap()
        };
        let text = traced(1, 1, false);
        assert!(text.contains("holds a stopped run of ridged trace: continue it with --resume "));
        assert!(traced(2, 3, false).contains("the stopped shard 2/3"));
        let text = traced(2, 3, true);
        assert!(
            text.contains("holds shard 2/3 of ridged trace: choose"),
            "{text}"
        );
        // Part of such a file is one, too.
        assert!(refused("side,hits,exact,plane,run\n").is_some());
        for other in [
            "",
            "side,hits\nup,0\n",
            "{\"shard\": 1}\n",
            "a run, exact\n",
        ] {
            assert_eq!(refused(other), None, "{other}");
        }
        assert!(none_in(folder.path()).is_ok());
        assert!(none_in(&folder.path().join("none")).is_ok());
    }
}
