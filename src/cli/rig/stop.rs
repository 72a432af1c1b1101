//! `ridged rig stop`: stops the rigs of all daemons that run on this machine, whatever their data folders.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::mpsc;

use anyhow::anyhow;
use serde_json::{Value, json};

use crate::cli::CliError;
use crate::cli::client::Client;
use crate::store::{DATABASE, Store};

/// How the stop of one data folder ended.
struct Outcome {
    folder: PathBuf,
    result: Result<(String, Value), CliError>,
}

/// Stops the daemon of `folder`, or all that run. `print` gets a line for each rig as soon as it is stopped.
///
/// # Errors
/// No result if nothing was stopped, or not everything.
pub(super) fn stop(folder: Option<&Path>, print: &mut dyn FnMut(&str)) -> Result<Value, CliError> {
    match folder {
        Some(one) => report(stop_each(vec![one.to_owned()], print), folder),
        None => {
            let proc = Path::new("/proc");
            let mut outcomes = stop_each(held_folders(proc), print);
            outcomes.extend(folderless(proc));
            report(outcomes, folder)
        }
    }
}

/// Stops the rig of one daemon, wherever it runs.
///
/// # Errors
/// No result if nothing was stopped.
pub(super) fn stop_at(client: &Client, print: &mut dyn FnMut(&str)) -> Result<Value, CliError> {
    client.stop()?;
    print(&format!("stopped: {}", client.url));
    Ok(json!({ "state": "stopped", "stopped": [{ "url": client.url }] }))
}

/// Stops the daemons of several data folders at the same time. Neither a stop nor its line waits for another daemon.
fn stop_each(folders: Vec<PathBuf>, print: &mut dyn FnMut(&str)) -> Vec<Outcome> {
    let (send, arrived) = mpsc::channel();
    for folder in folders {
        let send = send.clone();
        std::thread::spawn(move || {
            let result = Client::noticed(&folder)
                .and_then(|client| client.stop().map(|answer| (client.url, answer)));
            send.send(Outcome { folder, result }).ok();
        });
    }
    drop(send);
    let mut outcomes = Vec::new();
    for outcome in arrived {
        if let Ok((url, _)) = &outcome.result {
            let folder = outcome.folder.display();
            print(&format!("stopped: {url}, data folder {folder}"));
        }
        outcomes.push(outcome);
    }
    outcomes
}

/// The answer as JSON; an error if a rig may still move.
fn report(outcomes: Vec<Outcome>, asked: Option<&Path>) -> Result<Value, CliError> {
    const NOTHING: &str = "NOTHING WAS STOPPED";
    let (mut stopped, mut failures) = (Vec::new(), Vec::new());
    for Outcome { folder, result } in outcomes {
        match result {
            Ok((url, _)) => {
                stopped.push(json!({ "url": url, "folder": folder.display().to_string() }));
            }
            Err(CliError::BadInput(why) | CliError::NoResult(why)) => failures.push(why),
            Err(other @ (CliError::Interrupted | CliError::Verdict(_))) => return Err(other),
        }
    }
    if stopped.is_empty() && failures.is_empty() {
        return Err(CliError::no_result(anyhow!(
            "{NOTHING}: no daemon of this user runs on this machine; if the stages move, use the hardware emergency switch"
        )));
    }
    if let Some(first) = failures.first() {
        let all: Vec<String> = failures.iter().map(ToString::to_string).collect();
        let others = match (stopped.is_empty(), asked) {
            (true, Some(_)) => {
                "; `ridged rig stop` without --data stops every daemon of this machine"
            }
            _ => "",
        };
        let what = match stopped.is_empty() {
            true => NOTHING,
            false => "NOT EVERYTHING WAS STOPPED",
        };
        return Err(CliError::no_result(match failures.len() {
            1 => anyhow!("{what}: {first}{others}"),
            _ => anyhow!("{what}:\n{}{others}", all.join("\n")),
        }));
    }
    Ok(json!({ "state": "stopped", "stopped": stopped }))
}

/// The system adds this to the name of a file that was deleted while it is open.
const DELETED: &str = "lock (deleted)";

/// Folders in which processes of this machine have a file of one of these names open, with the process, as far as the system
/// shows their files to this user.
fn open_files(
    proc: &Path,
    names: &'static [&'static str],
) -> impl Iterator<Item = (PathBuf, PathBuf)> {
    entries(proc)
        .filter(|process| is_number(process))
        .flat_map(|process| entries(&process.join("fd")).map(move |file| (process.clone(), file)))
        .filter_map(|(process, file)| Some((process, fs::read_link(file).ok()?)))
        .filter(|(_, file)| {
            let own = file.file_name();
            own.is_some_and(|own| names.iter().any(|name| own == *name))
        })
        .filter_map(|(process, file)| Some((process, file.parent()?.to_owned())))
}

/// Data folders of ridged that processes hold.
fn held_folders(proc: &Path) -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = open_files(proc, &["lock", DELETED])
        .map(|(_, folder)| folder)
        .filter(|folder| folder.join(DATABASE).is_file() && Store::is_in_use(folder))
        .collect();
    folders.sort();
    folders.dedup();
    folders
}

/// Processes of ridged whose data folder was deleted: the address of such a daemon is not known.
fn folderless(proc: &Path) -> Vec<Outcome> {
    let gone = open_files(proc, &[DELETED]);
    let of_ridged = gone.filter(|(process, folder)| {
        // A process whose lock alone was deleted has its folder open by the name that it has.
        let has_folder = |file| fs::read_link(file).is_ok_and(|opened| opened == *folder);
        fs::read_to_string(process.join("comm")).is_ok_and(|name| name.trim() == "ridged")
            && !entries(&process.join("fd")).any(has_folder)
    });
    of_ridged
        .map(|(process, folder)| Outcome {
            result: Err(CliError::no_result(anyhow!(
                "process {0} of ridged drives a rig, but its data folder {1} was deleted: `kill -INT {0}` stops it",
                process.file_name().unwrap_or_default().display(),
                folder.display()
            ))),
            folder,
        })
        .collect()
}

fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> + use<> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    entries.filter_map(|entry| Some(entry.ok()?.path()))
}

fn is_number(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| name.bytes().all(|b| b.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufRead as _, BufReader, Write as _};
    use std::net::TcpListener;
    use std::os::unix::fs::symlink;
    use std::time::{Duration, Instant};

    use crate::daemon::NOTICE_FILE;

    #[test]
    fn daemons_are_found_by_the_folders_they_hold() {
        let all = tempfile::tempdir().unwrap();
        let (proc, held, free) = (
            all.path().join("proc"),
            all.path().join("held"),
            all.path().join("free"),
        );
        for folder in [&held, &free] {
            fs::create_dir_all(folder).unwrap();
            fs::write(folder.join(DATABASE), "").unwrap();
        }
        let lock = fs::File::create(held.join("lock")).unwrap();
        lock.lock().unwrap();
        fs::File::create(free.join("lock")).unwrap();
        for (process, file) in [("7", &held), ("8", &held), ("9", &free), ("self", &free)] {
            let files = proc.join(process).join("fd");
            fs::create_dir_all(&files).unwrap();
            symlink(file.join("lock"), files.join("3")).unwrap();
            symlink(file.join("other"), files.join("4")).unwrap();
        }
        assert!(held_folders(&proc).iter().eq([&held]));
        // Another program's lock.
        fs::remove_file(held.join(DATABASE)).unwrap();
        assert!(held_folders(&proc).is_empty());
        // A daemon without its folder is named.
        assert!(folderless(&proc).is_empty());
        let files = proc.join("7").join("fd");
        symlink("/gone/lock (deleted)", files.join("5")).unwrap();
        fs::write(proc.join("7").join("comm"), "other\n").unwrap();
        assert!(folderless(&proc).is_empty());
        fs::write(proc.join("7").join("comm"), "ridged\n").unwrap();
        let found = folderless(&proc);
        assert_eq!(found.len(), 1);
        let Err(CliError::NoResult(why)) = report(found, None) else {
            panic!("it is no success");
        };
        assert!(why.to_string().contains("kill -INT 7"), "{why}");
    }

    #[test]
    fn a_daemon_whose_lock_was_deleted_is_found_by_its_folder() {
        let all = tempfile::tempdir().unwrap();
        let (proc, held) = (all.path().join("proc"), all.path().join("held"));
        fs::create_dir(&held).unwrap();
        fs::write(held.join(DATABASE), "").unwrap();
        let locked = fs::File::open(&held).unwrap();
        locked.lock().unwrap();
        let files = proc.join("7").join("fd");
        fs::create_dir_all(&files).unwrap();
        fs::write(proc.join("7").join("comm"), "ridged\n").unwrap();
        symlink(held.join(DELETED), files.join("3")).unwrap();
        symlink(&held, files.join("4")).unwrap();
        assert!(held_folders(&proc).iter().eq([&held]));
        assert!(folderless(&proc).is_empty());
    }

    #[test]
    fn a_stop_that_reached_no_rig_says_so_in_capitals() {
        let failed = |why: &str| Outcome {
            folder: PathBuf::from("b"),
            result: Err(CliError::no_result(anyhow!("{why}"))),
        };
        let done = || Outcome {
            folder: PathBuf::from("a"),
            result: Ok(("http://127.0.0.1:1".into(), Value::Null)),
        };
        let message = |outcomes| match report(outcomes, None) {
            Err(CliError::NoResult(why)) => why.to_string(),
            other => panic!("{other:?}"),
        };
        assert!(message(vec![]).starts_with("NOTHING WAS STOPPED"));
        assert!(message(vec![failed("silent")]).starts_with("NOTHING WAS STOPPED: silent"));
        let partly = message(vec![done(), failed("silent")]);
        assert_eq!(partly, "NOT EVERYTHING WAS STOPPED: silent");
        let answer = report(vec![done(), done()], None).unwrap();
        assert_eq!(answer["stopped"].as_array().unwrap().len(), 2);
    }

    #[test]
    fn a_frozen_daemon_delays_neither_the_stop_of_another_nor_its_line() {
        let all = tempfile::tempdir().unwrap();
        let daemon = |name: &str, answer: Option<&'static str>| {
            let listener = TcpListener::bind("127.0.0.1:0").unwrap();
            let folder = all.path().join(name);
            fs::create_dir(&folder).unwrap();
            let url = format!("http://{}", listener.local_addr().unwrap());
            let notice = json!({ "url": url }).to_string();
            fs::write(folder.join(NOTICE_FILE), notice).unwrap();
            let lock = fs::File::create(folder.join("lock")).unwrap();
            lock.lock().unwrap();
            std::thread::spawn(move || {
                for stream in listener.incoming().flatten() {
                    let lines = BufReader::new(&stream).lines();
                    assert!(lines.map_while(Result::ok).any(|line| line.is_empty()));
                    match answer {
                        Some(answer) => (&stream).write_all(answer.as_bytes()).unwrap(),
                        // The system accepts connections for a process that is frozen.
                        None => drop(Box::leak(Box::new(stream))),
                    }
                }
            });
            (folder, lock)
        };
        let answer = "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 2\r\nConnection: close\r\n\r\n{}";
        let (frozen, _lock_1) = daemon("frozen", None);
        let (well, _lock_2) = daemon("well", Some(answer));
        let (began, mut printed) = (Instant::now(), Vec::new());
        let mut print = |line: &str| printed.push((line.to_owned(), began.elapsed()));
        let outcomes = stop_each(vec![frozen, well.clone()], &mut print);
        let took = began.elapsed();
        assert!(took < Duration::from_secs(10), "{took:?}");
        let [(line, after)] = &printed[..] else {
            panic!("{printed:?}");
        };
        assert!(line.contains(&well.display().to_string()), "{line}");
        assert!(*after < took, "{after:?} of {took:?}");
        let Err(CliError::NoResult(why)) = report(outcomes, None) else {
            panic!("one rig may still move");
        };
        let why = why.to_string();
        assert!(why.starts_with("NOT EVERYTHING WAS STOPPED: "), "{why}");
        assert!(why.contains("hardware emergency switch"), "{why}");
    }
}
