//! The CSV file of direction bins: writing it, and merging it from shards.
//!
//! The file of a shard, or of a stopped run, has three more columns: `exact`, the bin's sums as hexadecimal integers, which
//! add up without rounding; `plane`, in the same form, the covariances of a direction in the plane of incidence, at the
//! first of its bins; and `run`, in its first row, the run that it belongs to and the SHA-256 of all of that. A file that
//! was sorted, edited or copied incompletely is refused, since its sums would be wrong.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::cli::shards::{Fact, ShardSet};
use crate::cli::{CliError, output_path};
use crate::trace::counting::bins;
use crate::trace::counting::bins::BinPlaces;
use crate::trace::counting::grid::DirectionGrid;
use crate::trace::counting::tally::Totals;
use crate::trace::report::About;
use crate::trace::run::{PartialRun, Shard};
use crate::trace::surfaces::height_field::Side;
use crate::version::BUILD;
use crate::wording::hex;

/// The run that the file of a shard or of a stopped run belongs to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct ShardPart {
    /// Program that traced it, with its version.
    #[serde(default)]
    pub program: String,
    /// SHA-256 of the scene, its files and the tolerance.
    pub run: String,
    /// 1 to `of`.
    pub shard: u64,
    /// Number of shards.
    pub of: u64,
    /// Whether all photons of the shard were traced.
    pub complete: bool,
    /// The finished batches as ranges, first and last.
    pub batches: Vec<[u64; 2]>,
    /// Bins over the polar angle.
    pub n_theta: usize,
    /// Bins over the azimuth.
    pub n_phi: usize,
    /// Column of light along ±n.
    #[serde(default)]
    pub straight: usize,
    /// 16 or 1 numbers per bin.
    pub elements: usize,
    /// Rows of the file.
    #[serde(default)]
    pub rows: usize,
    /// Exact sums of the energies.
    pub energies: String,
    /// Bins of the directions in the column `plane`.
    #[serde(default)]
    pub plane: Option<Vec<Vec<usize>>>,
    /// SHA-256 of the fields above and of the columns `exact` and `plane`. Files of older programs, whose sums of squares differ,
    /// have none.
    #[serde(default)]
    pub sums: Option<String>,
    /// The lamp's Stokes vector.
    pub stokes: [f64; 4],
    /// Facts about the scene for the report of the whole run.
    #[serde(default)]
    pub scene: About,
}

impl ShardPart {
    /// Describes the finished part of a shard of the run with this SHA-256.
    pub fn of(
        run: String,
        shard: Shard,
        done: &PartialRun,
        complete: bool,
        stokes: [f64; 4],
        scene: About,
    ) -> Self {
        let totals = &done.totals;
        let mut part = ShardPart {
            program: BUILD.to_owned(),
            run,
            shard: shard.number,
            of: shard.of,
            complete,
            batches: ranges(&done.batches),
            n_theta: totals.grid().n_theta,
            n_phi: totals.grid().n_phi,
            straight: totals.grid().straight,
            elements: totals.elements(),
            rows: bins::sides(totals).len() * totals.grid().per_side(),
            energies: totals.exact_energies(),
            plane: totals.directions(),
            sums: None,
            stokes,
            scene,
        };
        let mut sums = part.begun();
        for side in bins::sides(totals) {
            for bin in 0..totals.grid().per_side() {
                let (exact, plane) = exact_of(totals, side, bin);
                add(&mut sums, &exact, &plane);
            }
        }
        part.sums = Some(hex(&sums.finalize()));
        part
    }

    /// What all shards of a run have in common.
    fn facts(&self) -> Vec<Fact> {
        let scene = "scene with its files, run and --tolerance (SHA-256)";
        vec![
            Fact::new("program", &self.program),
            Fact::new(scene, &self.run),
        ]
    }

    /// Its SHA-256 before the first row of sums.
    fn begun(&self) -> Sha256 {
        let of_run = (&self.run, self.shard, self.of, self.complete, &self.batches);
        let of_bins = (self.n_theta, self.n_phi, self.straight, self.elements);
        let of_file = (self.rows, &self.energies, &self.plane);
        Sha256::new().chain_update(format!("{of_run:?} {of_bins:?} {of_file:?}"))
    }
}

/// The columns `exact` and `plane` of a bin.
fn exact_of(totals: &Totals, side: Side, bin: usize) -> (String, String) {
    let above = (side == Side::Above).then(|| totals.exact_direction(bin));
    let exact = totals.exact_bin(side, bin);
    (
        exact.unwrap_or_default(),
        above.flatten().unwrap_or_default(),
    )
}

/// Adds a row to the SHA-256.
fn add(sums: &mut Sha256, exact: &str, plane: &str) {
    for text in [exact, ",", plane, "\n"] {
        sums.update(text);
    }
}

/// Returns ascending numbers as ranges.
fn ranges(numbers: &[u64]) -> Vec<[u64; 2]> {
    let mut ranges: Vec<[u64; 2]> = Vec::new();
    for &n in numbers {
        match ranges.last_mut() {
            Some([_, last]) if *last + 1 == n => *last = n,
            _ => ranges.push([n, n]),
        }
    }
    ranges
}

/// Reads the state of a stopped run from `file`.
pub(super) fn kept(
    file: &Path,
    run: &str,
    photons: u64,
    shard: Shard,
    polarised: bool,
) -> Result<PartialRun, CliError> {
    let wrong = |what: &str| CliError::bad_input(anyhow!("{}: {what}", file.display()));
    let (part, totals) = read(file)?;
    if part.run != run {
        return Err(wrong(
            "this file belongs to another scene (or the scene's files, run or --tolerance have changed since): give the \
            scene of the stopped run, or start again without --resume",
        ));
    }
    if (part.shard, part.of) != (shard.number, shard.of) {
        return Err(wrong(&match part.of {
            1 => "this file belongs to a whole run: leave out --shard".to_owned(),
            of => format!(
                "this file belongs to a shard: add --shard {}/{of}",
                part.shard
            ),
        }));
    }
    let damaged = || wrong("the column run is damaged");
    if (totals.elements() > 1) != polarised {
        return Err(damaged());
    }
    // No more batches than photons: a damaged file must not ask for all memory.
    let mut batches = Vec::new();
    for [first, last] in part.batches {
        if first > last || last >= photons || last - first > totals.photons() {
            return Err(damaged());
        }
        batches.extend(first..=last);
    }
    PartialRun::kept(totals, batches, photons, shard).ok_or_else(damaged)
}

/// Writes the bins, with DOLP and AOP for the lamp's `stokes`; with a `part`, as a shard. The file appears whole
/// or not at all.
pub(super) fn write(
    path: &Path,
    totals: &Totals,
    stokes: &[f64; 4],
    part: Option<&ShardPart>,
) -> Result<(), CliError> {
    output_path::write_whole(path, text(totals, stokes, part).as_bytes())
}

fn text(totals: &Totals, stokes: &[f64; 4], part: Option<&ShardPart>) -> String {
    let Some(part) = part else {
        return bins::csv(totals, stokes, "", |_, _| String::new());
    };
    let mut first = true;
    bins::csv(totals, stokes, ",exact,plane,run", |side, bin| {
        let (exact, plane) = exact_of(totals, side, bin);
        let sums = format!("{exact},{plane}");
        if std::mem::take(&mut first) {
            let json = serde_json::to_string(part).unwrap_or_default();
            format!(",{sums},\"{}\"", json.replace('"', "\"\""))
        } else {
            format!(",{sums},")
        }
    })
}

/// Merged shards.
#[derive(Debug)]
pub(super) struct MergedShards {
    /// All counts.
    pub totals: Totals,
    /// The lamp's Stokes vector.
    pub stokes: [f64; 4],
    /// Facts about the scene for the report.
    pub scene: About,
}

/// Merges all shards of one run.
pub(super) fn merge(files: &[PathBuf]) -> Result<MergedShards, CliError> {
    let mut merged: Option<(ShardPart, Totals)> = None;
    let mut set = ShardSet::default();
    for file in files {
        let wrong = |what: &str| CliError::bad_input(anyhow!("{}: {what}", file.display()));
        let (part, totals) = read(file)?;
        if !part.complete {
            return Err(wrong(
                "this shard was stopped before its end: finish it with --resume",
            ));
        }
        let shard = Shard {
            number: part.shard,
            of: part.of,
        };
        set.add(file, shard, &part.facts())?;
        match &mut merged {
            None => merged = Some((part, totals)),
            Some((_, sum)) => sum.merge(&totals).map_err(CliError::bad_input)?,
        }
    }
    set.check_complete()?;
    let (first, totals) = merged.ok_or_else(|| CliError::bad_input(anyhow!("no shards given")))?;
    Ok(MergedShards {
        totals,
        stokes: first.stokes,
        scene: first.scene,
    })
}

fn read(file: &Path) -> Result<(ShardPart, Totals), CliError> {
    let wrong = |what: &str| CliError::bad_input(anyhow!("{}: {what}", file.display()));
    let mut reader = csv::Reader::from_path(file)
        .with_context(|| format!("cannot read {}", file.display()))
        .map_err(CliError::bad_input)?;
    let not_a_shard = "this is not the file of a shard (--shard K/N) or of a stopped run; a finished run cannot be resumed";
    let head = reader.headers().map_err(|_| wrong(not_a_shard))?;
    let find = |name: &str| head.iter().position(|h| h == name);
    let (Some(exact), Some(run)) = (find("exact"), find("run")) else {
        return Err(wrong(not_a_shard));
    };
    let older = "an earlier version of ridged wrote this file with other sums of squares: trace this part again";
    let Some(plane) = find("plane") else {
        return Err(wrong(older));
    };
    let mut found: Option<Found> = None;
    let mut rows = 0;
    for (row, record) in reader.records().enumerate() {
        let record = record
            .with_context(|| format!("cannot read {}", file.display()))
            .map_err(CliError::bad_input)?;
        if row == 0 {
            let part: ShardPart = serde_json::from_str(&record[run])
                .map_err(|_| wrong("the column run is damaged"))?;
            let sane = (1..=1440).contains(&part.n_theta)
                && (1..=1440).contains(&part.n_phi)
                && [1, 16].contains(&part.elements)
                && (1..=part.of).contains(&part.shard);
            if !sane || part.straight >= part.n_phi {
                return Err(wrong("the column run is damaged"));
            }
            if part.sums.is_none() {
                return Err(wrong(older));
            }
            let grid = DirectionGrid {
                straight: part.straight,
                ..DirectionGrid::polar(part.n_theta, part.n_phi)
            };
            let known = |bin: &usize| *bin < grid.per_side();
            if !part.plane.iter().flatten().flatten().all(known) {
                return Err(wrong("the column run is damaged"));
            }
            let directions = part.plane.clone();
            let mut totals = Totals::new(grid, part.elements).with_directions(directions);
            totals
                .set_exact_energies(&part.energies)
                .ok_or_else(|| wrong("the column run is damaged"))?;
            found = Some(Found {
                sums: part.begun(),
                places: BinPlaces::of(grid),
                part,
                totals,
            });
        }
        let Some(Found {
            totals,
            sums,
            places,
            ..
        }) = &mut found
        else {
            return Err(wrong(not_a_shard));
        };
        rows = row + 1;
        let per_side = totals.grid().per_side();
        // Rows after both sides are counted and refused at the end.
        if row >= 2 * per_side {
            continue;
        }
        let (side, bin) = if row < per_side {
            (Side::Above, row)
        } else {
            (Side::Below, row - per_side)
        };
        if !places.of_bin(side, bin).eq(record.iter().take(5)) {
            return Err(wrong(&format!(
                "row {} has the wrong bin for its place: the rows were sorted or changed; copy the file again, or trace this \
                part again",
                row + 2
            )));
        }
        add(sums, &record[exact], &record[plane]);
        if !record[exact].is_empty() {
            totals
                .set_exact_bin(side, bin, &record[exact])
                .ok_or_else(|| wrong(&format!("row {} is damaged", row + 2)))?;
        }
        if !record[plane].is_empty() {
            totals
                .set_exact_direction(bin, &record[plane])
                .ok_or_else(|| wrong(&format!("row {} is damaged", row + 2)))?;
        }
    }
    let found = found.ok_or_else(|| wrong("the file has no rows"))?;
    let Found {
        part, totals, sums, ..
    } = found;
    // A file that was truncated between two rows has all its energies and a part of its bins.
    if rows != part.rows {
        return Err(wrong(&format!(
            "the file has {rows} rows of bins, which is not the expected number: copy it again, or trace this part again"
        )));
    }
    if part.sums.as_deref() != Some(&hex(&sums.finalize())) {
        return Err(wrong(
            "the columns exact, plane or run were changed: copy the file again, or trace this part again",
        ));
    }
    Ok((part, totals))
}

/// Content of a file so far.
struct Found {
    part: ShardPart,
    totals: Totals,
    sums: Sha256,
    places: BinPlaces,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::report::TraceReport;
    use crate::trace::run::{StopPolicy, resume};
    use crate::trace::scene::{PreparedScene, Scene};

    fn rough_glass() -> PreparedScene {
        let text = "[light]\ntheta_i_deg = 45.0\n[[interface]]\nshape = \"beckmann\"\nalpha_u = 0.4\n\
                    alpha_v = 0.4\ncells = 64\nbelow = { n = 1.5 }\n[run]\nphotons = 5000\ntheta_bins = 9\n\
                    phi_bins = 12\n";
        Scene::parse(text)
            .unwrap()
            .prepare(&|_| Err(String::new()))
            .unwrap()
    }

    fn traced(prepared: &PreparedScene, shard: Shard) -> Totals {
        resume(prepared, shard, None, StopPolicy::AtLast, &|_| true).totals
    }

    #[test]
    fn merged_files_are_byte_for_byte_those_of_one_run() {
        let prepared = rough_glass();
        let folder = tempfile::tempdir().unwrap();
        let whole = folder.path().join("whole.csv");
        let lamp = [1.0, 0.0, 0.5, 0.0];
        write(&whole, &traced(&prepared, Shard::WHOLE), &lamp, None).unwrap();
        let part = |number, complete| {
            let shard = Shard { number, of: 3 };
            let done = resume(&prepared, shard, None, StopPolicy::AtLast, &|_| true);
            let file = folder.path().join(format!("{number}{complete}.csv"));
            let about = About::of(&prepared);
            let part = ShardPart::of("r".to_owned(), shard, &done, complete, lamp, about);
            write(&file, &done.totals, &lamp, Some(&part)).unwrap();
            file
        };
        let files = [part(3, true), part(1, true), part(2, true)];
        let merged = folder.path().join("merged.csv");
        let sum = merge(&files).unwrap();
        write(&merged, &sum.totals, &sum.stokes, None).unwrap();
        // The facts about the run and the covariances are the same, too.
        let whole_run = traced(&prepared, Shard::WHOLE);
        assert!(whole_run.directions().is_some());
        assert_eq!(sum.totals, whole_run);
        assert_eq!(
            TraceReport::new(&sum.totals, true).about(sum.scene),
            TraceReport::of(&prepared, &whole_run)
        );
        let read = |p: &Path| std::fs::read(p).unwrap();
        assert_eq!(read(&whole), read(&merged));
        let cut = part(2, false);
        for bad in [
            vec![files[0].clone(), files[1].clone()],
            vec![files[0].clone(), files[0].clone(), files[1].clone()],
            vec![files[0].clone(), files[1].clone(), cut],
            vec![whole],
        ] {
            assert!(matches!(merge(&bad), Err(CliError::BadInput(_))));
        }
    }

    #[test]
    fn a_shards_file_without_some_of_its_rows_is_refused_wherever_it_was_cut_off() {
        let prepared = rough_glass();
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        for number in [1, 2] {
            let shard = Shard { number, of: 2 };
            let done = resume(&prepared, shard, None, StopPolicy::AtLast, &|_| true);
            let lamp = [1.0, 0.0, 0.0, 0.0];
            let part = ShardPart::of(
                "r".to_owned(),
                shard,
                &done,
                true,
                lamp,
                About::of(&prepared),
            );
            let name = file(&format!("{number}.csv"));
            write(&name, &done.totals, &lamp, Some(&part)).unwrap();
        }
        assert!(merge(&[file("1.csv"), file("2.csv")]).is_ok());
        let text = std::fs::read_to_string(file("2.csv")).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        // Both sides of glass: one row too many, a few less, and exactly the upper side.
        let twice = [&lines[..], &lines[5..6]].concat();
        for some in [&twice[..], &lines[..lines.len() - 3], &lines[..1 + 9 * 12]] {
            std::fs::write(file("cut.csv"), some.join("\n")).unwrap();
            let Err(CliError::BadInput(error)) = merge(&[file("1.csv"), file("cut.csv")]) else {
                panic!("{} rows", some.len())
            };
            let text = error.to_string();
            assert!(
                text.contains("rows of bins") || text.contains("is damaged"),
                "{text}"
            );
        }
    }

    #[test]
    fn a_shards_file_whose_rows_or_digits_were_changed_is_refused() {
        let prepared = rough_glass();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("1.csv");
        let done = resume(&prepared, Shard::WHOLE, None, StopPolicy::AtLast, &|_| true);
        let (lamp, about) = ([1.0, 0.0, 0.0, 0.0], About::of(&prepared));
        let part = ShardPart::of("r".to_owned(), Shard::WHOLE, &done, true, lamp, about);
        write(&file, &done.totals, &lamp, Some(&part)).unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let exact = lines[0]
            .split(',')
            .position(|name| name == "exact")
            .unwrap();
        let refused = |lines: &[String], says: &str| {
            std::fs::write(&file, lines.join("\n")).unwrap();
            let Err(CliError::BadInput(error)) = merge(std::slice::from_ref(&file)) else {
                panic!("{says}")
            };
            assert!(error.to_string().contains(says), "{error}");
        };
        let own: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
        std::fs::write(&file, own.join("\n")).unwrap();
        assert!(merge(std::slice::from_ref(&file)).is_ok());
        let mut swapped = own.clone();
        swapped.swap(20, 21);
        refused(&swapped, "row 21 has the wrong bin");
        // The last digit of a sum, which no other number of its row reveals.
        let lit = (2..own.len()).find(|n| own[*n].split(',').nth(exact) != Some(""));
        let mut flipped = own;
        let line = &mut flipped[lit.unwrap()];
        let mut words: Vec<String> = line.split(',').map(str::to_owned).collect();
        let last = words[exact].pop().unwrap();
        words[exact].push(if last == '0' { '1' } else { '0' });
        *line = words.join(",");
        refused(&flipped, "were changed");
        // The file's own hash, and a file without it.
        for (part, says) in [
            (
                ShardPart {
                    straight: 3,
                    ..part.clone()
                },
                "were changed",
            ),
            (ShardPart { sums: None, ..part }, "earlier version"),
        ] {
            write(&file, &done.totals, &lamp, Some(&part)).unwrap();
            let Err(CliError::BadInput(error)) = merge(std::slice::from_ref(&file)) else {
                panic!("{says}")
            };
            assert!(error.to_string().contains(says), "{error}");
        }
    }

    #[test]
    fn a_run_stopped_again_and_again_ends_with_the_same_bytes() {
        let prepared = rough_glass();
        let folder = tempfile::tempdir().unwrap();
        let lamp = [1.0, 0.0, 0.0, 0.0];
        for shard in [Shard::WHOLE, Shard { number: 2, of: 3 }] {
            let (file, whole) = (
                folder.path().join("kept.csv"),
                folder.path().join("whole.csv"),
            );
            let save = |file: &Path, done: &PartialRun| {
                let complete = done.is_complete(5000, shard);
                let part = ShardPart::of(
                    "r".to_owned(),
                    shard,
                    done,
                    complete,
                    lamp,
                    About::of(&prepared),
                );
                write(file, &done.totals, &lamp, Some(&part)).unwrap();
                complete
            };
            let load = || kept(&file, "r", 5000, shard, true).unwrap();
            save(
                &whole,
                &resume(&prepared, shard, None, StopPolicy::AtLast, &|_| true),
            );
            let (mut before, mut stops) = (None, 0);
            loop {
                // Each time a few batches of the 64 more than before.
                let start = before
                    .as_ref()
                    .map_or(0, |b: &PartialRun| b.totals.photons());
                let done = resume(&prepared, shard, before, StopPolicy::AtLast, &|p| {
                    p.photons <= start + 400
                });
                if save(&file, &done) {
                    break;
                }
                stops += 1;
                before = Some(load());
                assert_eq!(before.as_ref(), Some(&done));
            }
            assert!(stops > 1, "{stops}");
            assert_eq!(
                std::fs::read(&file).unwrap(),
                std::fs::read(&whole).unwrap()
            );
        }
        let whole = Shard::WHOLE;
        let file = folder.path().join("kept.csv");
        for (run, photons, shard, polarised, says) in [
            (
                "other",
                5000,
                Shard { number: 2, of: 3 },
                true,
                "another scene",
            ),
            ("r", 5000, whole, true, "--shard 2/3"),
            ("r", 6000, Shard { number: 2, of: 3 }, true, "damaged"),
            ("r", 5000, Shard { number: 2, of: 3 }, false, "damaged"),
        ] {
            let Err(CliError::BadInput(error)) = kept(&file, run, photons, shard, polarised) else {
                panic!("{says}")
            };
            assert!(error.to_string().contains(says), "{error}");
        }
    }
}
