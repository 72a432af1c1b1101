//! The program `ridged simulate-rig` from the outside. `tests/vendor` tests its protocol.

use std::io::{BufRead, BufReader, Read};
use std::net::TcpListener;
use std::process::{Command, Stdio};

fn simulate_rig(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ridged"));
    command.arg("simulate-rig").args(arguments);
    command
}

#[test]
fn bad_usage_is_two_and_an_address_in_use_is_one() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    for (arguments, code, says) in [
        (&["--pty", "--time-scale", "0"][..], 2, "0.001 to"),
        (&["--pty", "--time-scale", "NaN"], 2, "0.001 to"),
        (&["--pty", "--time-scale", "1e308"], 2, "0.001 to"),
        (&["--tcp", "nowhere"], 2, "is not an address"),
        (&["--pty", "--tcp", "127.0.0.1:0"], 2, "cannot be used with"),
        (&[], 2, "required"),
        (&["--tcp", &address], 1, "is it in use?"),
    ] {
        let output = simulate_rig(arguments).output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {error}");
        assert!(error.contains(says), "{arguments:?}: {error}");
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn it_prints_its_address_and_description() {
    let mut child = simulate_rig(&["--pty", "--describe"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdout = BufReader::new(child.stdout.take().unwrap());
    let mut line = String::new();
    stdout.read_line(&mut line).unwrap();
    assert!(line.starts_with("listening on /dev/"), "{line:?}");
    child.kill().unwrap();
    child.wait().unwrap();
    let mut rest = String::new();
    stdout.read_to_string(&mut rest).unwrap();
    let description: serde_json::Value = serde_json::from_str(&rest).unwrap();
    assert_eq!(description["axes"][1]["name"], "phi_s");
    assert_eq!(description["axes"][1]["address"], 2);
}
