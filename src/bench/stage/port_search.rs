//! Finds the controllers of a rig on another port than the named one: serial ports change their names when they are
//! plugged in again.
//!
//! Only ports of the same kind are asked, and only for the serial numbers of the controllers, so that no other device
//! receives a command that does anything.

use std::collections::BTreeSet;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::settings::StageSettings;
use crate::bench::AxisName;
use crate::bench::line::{LineSettings, PortLine};
use crate::bench::port::{PortAddress, PortSeam};
use crate::bench::wire::zaber::DeviceCommand;

/// Most ports that are asked.
const PORTS_MAX: usize = 16;

/// Returns the port on which the controllers with these serial numbers (θc, φs) answer at the addresses of the
/// settings. `named` is left out; a TCP address has no other ports.
pub(super) async fn find(
    named: &PortAddress,
    settings: &StageSettings,
    serials: [u32; 2],
    seam: &Arc<dyn PortSeam>,
) -> Option<PortAddress> {
    let PortAddress::Serial { path } = named else {
        return None;
    };
    for path in ports_like(path) {
        let address = PortAddress::Serial { path };
        if answer_on(&address, settings, serials, seam).await {
            return Some(address);
        }
    }
    None
}

async fn answer_on(
    address: &PortAddress,
    settings: &StageSettings,
    serials: [u32; 2],
    seam: &Arc<dyn PortSeam>,
) -> bool {
    let line_settings = LineSettings {
        reply_timeout: Duration::from_millis(settings.reply_timeout_ms),
        attempts: 1,
    };
    let (port, baud, seam) = (address.clone(), settings.baud, Arc::clone(seam));
    let opening = move || PortLine::open(&port, baud, line_settings, seam.as_ref());
    let opened = tokio::task::spawn_blocking(opening).await;
    // A port that another program uses, or that cannot be opened, is not this rig's.
    let Ok(line) = opened.expect("opening a port does not panic") else {
        return false;
    };
    let mut all_there = true;
    for (axis, serial) in AxisName::ALL.into_iter().zip(serials) {
        let address = settings.axis(axis).address;
        let question = DeviceCommand::new(address, 0, "get system.serial");
        let answer = line.ask(&question).await;
        all_there &= answer.is_ok_and(|reply| reply.data.trim() == serial.to_string());
        if !all_there {
            break;
        }
    }
    line.close();
    line.closed().await;
    all_there
}

/// Returns the serial ports beside `named` whose names differ only in their number, each device once. In
/// `/dev/serial/by-id` all names are of one kind.
fn ports_like(named: &Path) -> Vec<PathBuf> {
    let (Some(folder), Some(name)) = (named.parent(), name_of(named)) else {
        return Vec::new();
    };
    let of_udev = folder.parent() == Some(Path::new("/dev/serial"));
    let kind = without_number(&name);
    // Terminals of people are named by a number only.
    if kind.is_empty() && !of_udev {
        return Vec::new();
    }
    let mut seen: BTreeSet<PathBuf> = named.canonicalize().into_iter().collect();
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path != named)
        .filter(|path| of_udev || name_of(path).is_some_and(|n| without_number(&n) == kind))
        .filter(|path| is_character_device(path))
        .collect();
    paths.sort();
    paths.retain(|path| path.canonicalize().is_ok_and(|device| seen.insert(device)));
    paths.truncate(PORTS_MAX);
    paths
}

fn name_of(path: &Path) -> Option<String> {
    Some(path.file_name()?.to_str()?.to_owned())
}

fn without_number(name: &str) -> &str {
    name.trim_end_matches(|c: char| c.is_ascii_digit())
}

fn is_character_device(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|file| file.file_type().is_char_device())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_ports_of_the_same_kind_are_asked_and_each_once() {
        let folder = tempfile::tempdir().unwrap();
        let link = |name: &str, to: &str| {
            std::os::unix::fs::symlink(to, folder.path().join(name)).unwrap();
        };
        link("ttyRIG0", "/dev/null");
        link("ttyRIG1", "/dev/zero");
        link("ttyRIG2", "/dev/zero");
        link("ttyLAMP0", "/dev/full");
        std::fs::write(folder.path().join("ttyRIG3"), "a file").unwrap();
        let named = folder.path().join("ttyRIG0");
        assert_eq!(ports_like(&named), [folder.path().join("ttyRIG1")]);
        std::fs::remove_file(&named).unwrap();
        assert_eq!(ports_like(&named), [folder.path().join("ttyRIG1")]);
        // The terminals of people.
        assert!(ports_like(Path::new("/dev/pts/0")).is_empty());
    }
}
