//! Shards of a command: the files of parts that were computed apart, on any machines, and how they become one result.
//!
//! A command with `--shard K/N` calls [`write`]; its `merge` calls [`read`]. A file is one line of JSON ([`Head`]: the run and
//! the shard) and the part in the form of postcard, which keeps every bit of a number. It appears whole or not at all, so a
//! shard that is killed leaves nothing and one that is repeated replaces its file. `ridged trace` has a form of its own, a
//! table that can be resumed, and shares [`ShardSet`].

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{CliError, kept_part, output, output_path};
use crate::shard::Shard;
use crate::version::BUILD;
use crate::wording::{counted, hex};

/// Version of the form of a file.
const FORM: u32 = 1;
/// Missing shards that an error names.
const NAMED: usize = 10;

/// A property that all shards of a run have in common, with its name for messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fact {
    name: String,
    value: String,
}

impl Fact {
    /// Names a property.
    pub fn new(name: impl Into<String>, value: impl Into<String>) -> Self {
        Fact {
            name: name.into(),
            value: value.into(),
        }
    }
}

/// What identifies a run: shards are merged only where all of it is equal.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    command: String,
    facts: Vec<Fact>,
}

impl Run {
    /// The run of a command with these facts about its options and inputs. Program and processor are added: other ones may
    /// round differently.
    pub fn new(command: &str, facts: impl IntoIterator<Item = Fact>) -> Self {
        let arithmetic = format!("{:?}", pulp::Arch::new());
        let registers = arithmetic.split('(').next().unwrap_or_default();
        let mut all = vec![
            Fact::new("program", BUILD),
            Fact::new(
                "processor",
                format!("{} with registers {registers}", std::env::consts::ARCH),
            ),
        ];
        all.extend(facts);
        Run {
            command: command.to_owned(),
            facts: all,
        }
    }
}

/// First line of a file.
#[derive(Debug, Serialize, Deserialize)]
struct Head {
    ridged_shard: u32,
    run: Run,
    shard: u64,
    of: u64,
    /// Seconds that the shard took.
    seconds: f64,
    /// SHA-256 of the rest of the file.
    sha256: String,
}

/// Files and result of a merge.
#[derive(Debug, clap::Args)]
pub struct MergeArgs {
    /// Files that `--shard` wrote.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Folder for the files of the result; created if it does not exist.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// The file that a shard is written to, and how that is reported.
#[derive(Debug, Clone)]
pub struct Target<'a> {
    /// The run that it belongs to.
    pub run: Run,
    /// The shard.
    pub shard: Shard,
    /// Its file.
    pub file: &'a Path,
    /// One JSON object on stdout instead of a sentence.
    pub json: bool,
}

impl<'a> Target<'a> {
    /// Checks that the file can be written, before the work that makes it. A file with the same shard is replaced.
    ///
    /// # Errors
    /// Bad input without a file, or for one that cannot be written or holds another part of a run.
    pub fn new(
        run: Run,
        shard: Shard,
        file: Option<&'a Path>,
        json: bool,
    ) -> Result<Self, CliError> {
        let file = file.ok_or_else(|| {
            CliError::bad_input(anyhow!(
                "--shard {shard}: a shard is a file for the merge; name it with --out FILE"
            ))
        })?;
        if let Some(folder) = file.parent().filter(|p| !p.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot create {}", folder.display()))
                .map_err(CliError::bad_input)?;
        }
        let head =
            kept_part::first_line(file).and_then(|line| serde_json::from_slice::<Head>(&line).ok());
        let is_same = head.is_some_and(|head| {
            head.run == run && (head.shard, head.of) == (shard.number, shard.of)
        });
        match is_same {
            true => output_path::check_writable(file)?,
            false => output_path::check_file(file)?,
        }
        Ok(Target {
            run,
            shard,
            file,
            json,
        })
    }
}

/// What a shard prints.
#[derive(Serialize)]
struct Written<'a> {
    shard: u64,
    of: u64,
    seconds: f64,
    file: &'a Path,
}

/// Writes the part that a shard computed in `seconds`, and reports it on stdout.
///
/// # Errors
/// No result where the file cannot be written.
pub fn write<T: Serialize>(target: &Target<'_>, seconds: f64, part: &T) -> Result<(), CliError> {
    let Target {
        ref run,
        shard,
        file,
        json,
    } = *target;
    let part = postcard::to_allocvec(part).map_err(CliError::no_result)?;
    let head = Head {
        ridged_shard: FORM,
        run: run.clone(),
        shard: shard.number,
        of: shard.of,
        seconds,
        sha256: hex(&Sha256::digest(&part)),
    };
    let mut content = serde_json::to_vec(&head).map_err(CliError::no_result)?;
    content.push(b'\n');
    content.extend(part);
    output_path::write_whole(file, &content)?;
    let written = Written {
        shard: shard.number,
        of: shard.of,
        seconds,
        file,
    };
    output::write(json, &written, || {
        format!(
            "shard {shard} took {seconds:.2} s and is in {}\n",
            file.display()
        )
    })
}

/// All parts of a run.
#[derive(Debug)]
pub struct Parts<T> {
    /// By the number of the shard.
    pub parts: Vec<T>,
    /// Seconds of all shards together.
    pub seconds: f64,
}

/// Reads all shards of one run of a command.
///
/// # Errors
/// Bad input for a file that is not a whole shard of that command, shards of different runs, and shards that are missing or
/// given twice.
pub fn read<T: DeserializeOwned>(command: &str, files: &[PathBuf]) -> Result<Parts<T>, CliError> {
    let mut set = ShardSet::default();
    let mut parts = Vec::new();
    let mut seconds = 0.0;
    for file in files {
        let (head, part) = read_one(command, file)?;
        let shard = Shard {
            number: head.shard,
            of: head.of,
        };
        set.add(file, shard, &head.run.facts)?;
        seconds += head.seconds;
        parts.push((shard.number, part));
    }
    set.check_complete()?;
    parts.sort_by_key(|(number, _)| *number);
    Ok(Parts {
        parts: parts.into_iter().map(|(_, part)| part).collect(),
        seconds,
    })
}

fn read_one<T: DeserializeOwned>(command: &str, file: &Path) -> Result<(Head, T), CliError> {
    let wrong = |what: &str| CliError::bad_input(anyhow!("{}: {what}", file.display()));
    let content = std::fs::read(file)
        .with_context(|| format!("cannot read {}", file.display()))
        .map_err(CliError::bad_input)?;
    let end = content.iter().position(|byte| *byte == b'\n');
    let head = end.and_then(|end| serde_json::from_slice::<Head>(&content[..end]).ok());
    let (Some(end), Some(head)) = (end, head) else {
        return Err(wrong(&format!(
            "this is not the file of a shard, expected one that ridged {command} --shard K/N wrote"
        )));
    };
    if head.run.command != command {
        return Err(wrong(&format!(
            "this is a shard of ridged {other}; merge it with ridged {other} merge",
            other = head.run.command
        )));
    }
    let part = &content[end + 1..];
    let is_whole = head.sha256 == hex(&Sha256::digest(part)) && (1..=head.of).contains(&head.shard);
    let damaged =
        "the file is incomplete or was changed: copy it again, or compute the shard again";
    if !is_whole {
        return Err(wrong(damaged));
    }
    if head.ridged_shard != FORM || head.run.facts.first() != Some(&Fact::new("program", BUILD)) {
        let other = head.run.facts.first().map_or("", |fact| &fact.value);
        return Err(wrong(&format!(
            "{other} wrote this shard and this is {BUILD}: merge with the program that wrote it, or compute the shard again"
        )));
    }
    let part = postcard::from_bytes(part).map_err(|_| wrong(damaged))?;
    Ok((head, part))
}

/// Returns the results of numbered pieces of work in their order.
///
/// # Errors
/// Bad input where a piece is missing or there twice.
pub fn in_order<T>(
    pieces: impl IntoIterator<Item = (usize, T)>,
    count: usize,
) -> Result<Vec<T>, CliError> {
    let mut pieces: Vec<(usize, T)> = pieces.into_iter().collect();
    pieces.sort_by_key(|(index, _)| *index);
    let whole = pieces.iter().map(|(index, _)| *index).eq(0..count);
    match whole {
        true => Ok(pieces.into_iter().map(|(_, piece)| piece).collect()),
        false => Err(CliError::bad_input(anyhow!(
            "the shards do not contain each of {count} results once: compute them again with one program"
        ))),
    }
}

/// Returns the numbers, from 0, of a shard's surfaces in a run that has `count`.
///
/// # Errors
/// Bad input where there are fewer surfaces than shards.
pub fn surfaces_of(shard: Shard, count: usize) -> Result<Vec<usize>, CliError> {
    let all = count as u64;
    if shard.of > all {
        return Err(too_many(shard, all, "surface", all));
    }
    Ok((0..count).filter(|n| shard.has(*n as u64)).collect())
}

/// Refuses a shard of a run that has fewer pieces of work than shards.
pub fn too_many(shard: Shard, amount: u64, what: &str, most: u64) -> CliError {
    let amount = counted(usize::try_from(amount).unwrap_or(usize::MAX), what);
    CliError::bad_input(anyhow!(
        "--shard {shard}: {amount} can be divided into at most {most} shards"
    ))
}

/// The shards of a merge: of one run, each once, none missing.
#[derive(Debug, Default)]
pub struct ShardSet<'f> {
    first: Option<(&'f Path, Vec<Fact>, u64)>,
    seen: Vec<(u64, &'f Path)>,
}

impl<'f> ShardSet<'f> {
    /// Adds a shard with the facts about its run.
    ///
    /// # Errors
    /// Bad input for a shard of another run, naming what differs, and for one that is there already.
    pub fn add(&mut self, file: &'f Path, shard: Shard, facts: &[Fact]) -> Result<(), CliError> {
        let wrong = |what: String| Err(CliError::bad_input(anyhow!("{}: {what}", file.display())));
        let (first, known, of) = self
            .first
            .get_or_insert_with(|| (file, facts.to_owned(), shard.of));
        let first = first.display();
        if let Some((fact, other)) = facts.iter().zip(&*known).find(|(a, b)| a != b) {
            return wrong(format!(
                "this shard belongs to another run than {first}: {} is {}, there {}",
                fact.name, fact.value, other.value
            ));
        }
        if shard.of != *of || facts.len() != known.len() {
            return wrong(format!(
                "this is shard {shard}, and {first} is one of {of}: merge the shards of one run"
            ));
        }
        if let Some((_, other)) = self.seen.iter().find(|(n, _)| *n == shard.number) {
            return wrong(format!(
                "shard {} is already in {}",
                shard.number,
                other.display()
            ));
        }
        self.seen.push((shard.number, file));
        Ok(())
    }

    /// Checks that no shard is missing.
    ///
    /// # Errors
    /// Bad input with the numbers of those that are.
    pub fn check_complete(&self) -> Result<(), CliError> {
        let of = self.first.as_ref().map_or(0, |(_, _, of)| *of);
        let missing: Vec<String> = (1..=of)
            .filter(|n| !self.seen.iter().any(|(s, _)| s == n))
            .map(|n| n.to_string())
            .take(NAMED)
            .collect();
        match missing.is_empty() {
            true => Ok(()),
            false => Err(CliError::bad_input(anyhow!(
                "of {of} shards these are missing: {}",
                missing.join(", ")
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(seed: u64) -> Run {
        Run::new("wear", [Fact::new("--seed", seed.to_string())])
    }

    fn written(file: &Path, number: u64, of: u64, seed: u64, part: &[f64]) {
        let shard = Shard { number, of };
        let target = Target::new(run(seed), shard, Some(file), true).unwrap();
        write(&target, 0.5, &part).unwrap();
    }

    fn refusal(command: &str, files: &[PathBuf]) -> String {
        match read::<Vec<f64>>(command, files) {
            Err(CliError::BadInput(error)) => error.to_string(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn parts_come_back_bit_by_bit_in_the_order_of_their_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let file = |number: u64| folder.path().join(format!("new/{number}.shard"));
        let odd = f64::from_bits(0xfff8_0000_0000_0123);
        let parts = [vec![0.1 + 0.2, -0.0], vec![f64::INFINITY, odd], vec![]];
        for (n, part) in parts.iter().enumerate() {
            written(&file(n as u64 + 1), n as u64 + 1, 3, 1, part);
        }
        let merged = read::<Vec<f64>>("wear", &[file(3), file(1), file(2)]).unwrap();
        let bits = |parts: &[Vec<f64>]| -> Vec<Vec<u64>> {
            let bits = |part: &Vec<f64>| part.iter().map(|x| x.to_bits()).collect();
            parts.iter().map(bits).collect()
        };
        assert_eq!(bits(&merged.parts), bits(&parts));
        assert_eq!(merged.seconds, 1.5);
    }

    #[test]
    fn shards_that_are_missing_double_or_of_another_run_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        written(&file("a"), 1, 3, 1, &[1.0]);
        written(&file("b"), 2, 3, 1, &[1.0]);
        written(&file("c"), 3, 3, 2, &[1.0]);
        written(&file("d"), 3, 4, 1, &[1.0]);
        let said = refusal("wear", &[file("a"), file("b")]);
        assert!(
            said.contains("of 3 shards") && said.ends_with(": 3"),
            "{said}"
        );
        let said = refusal("wear", &[file("a"), file("b"), file("a")]);
        assert!(said.contains("shard 1 is already in"), "{said}");
        let said = refusal("wear", &[file("a"), file("b"), file("c")]);
        assert!(said.contains("--seed is 2, there 1"), "{said}");
        let said = refusal("wear", &[file("a"), file("b"), file("d")]);
        assert!(said.contains("this is shard 3/4"), "{said}");
        let said = refusal("model-error", &[file("a")]);
        assert!(said.contains("ridged wear merge"), "{said}");
    }

    #[test]
    fn a_file_that_was_cut_changed_or_written_by_another_program_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        written(&file, 1, 1, 1, &[1.0, 2.0]);
        let whole = std::fs::read(&file).unwrap();
        let changed = |content: &[u8]| {
            std::fs::write(&file, content).unwrap();
            refusal("wear", std::slice::from_ref(&file))
        };
        assert!(changed(&whole[..whole.len() - 1]).contains("incomplete"));
        let mut flipped = whole.clone();
        *flipped.last_mut().unwrap() ^= 1;
        assert!(changed(&flipped).contains("incomplete"));
        assert!(changed(b"").contains("not the file of a shard"));
        assert!(changed(&whole[..10]).contains("not the file of a shard"));
        let end = whole.iter().position(|byte| *byte == b'\n').unwrap();
        let head = String::from_utf8(whole[..end].to_vec()).unwrap();
        let older = head.replace(BUILD, "ridged 0.0.1");
        let older = [older.as_bytes(), &whole[end..]].concat();
        assert!(changed(&older).contains("ridged 0.0.1 wrote this shard"));
    }

    #[test]
    fn a_shard_replaces_itself_and_no_other_part_of_a_run() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        let shard = Shard { number: 1, of: 3 };
        written(&file, 1, 3, 1, &[1.0]);
        written(&file, 1, 3, 1, &[1.0]);
        let before = std::fs::read(&file).unwrap();
        let others = [
            (run(2), shard),
            (run(1), Shard { number: 2, of: 3 }),
            (run(1), Shard { number: 1, of: 4 }),
        ];
        for (run, shard) in others {
            let Err(CliError::BadInput(error)) = Target::new(run, shard, Some(&file), true) else {
                panic!("{shard} replaces another one");
            };
            assert!(
                error.to_string().contains("holds shard 1/3 of ridged wear"),
                "{error}"
            );
        }
        assert_eq!(std::fs::read(&file).unwrap(), before);
    }

    #[test]
    fn a_shard_without_a_file_is_refused() {
        let shard = Shard { number: 1, of: 2 };
        let Err(CliError::BadInput(error)) = Target::new(run(1), shard, None, false) else {
            panic!("it has no file");
        };
        assert!(error.to_string().contains("--out FILE"), "{error}");
    }

    #[test]
    fn pieces_are_in_the_order_of_their_numbers_and_all_there() {
        assert_eq!(in_order([(1, 'b'), (0, 'a')], 2).unwrap(), ['a', 'b']);
        for pieces in [
            vec![(0, 'a')],
            vec![(0, 'a'), (0, 'a')],
            vec![(1, 'a'), (2, 'b')],
        ] {
            assert!(in_order(pieces, 2).is_err());
        }
    }
}
