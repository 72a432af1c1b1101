//! Untrusted bytes: changed examples of every kind of input go through the parser of that kind. It may refuse them; it
//! must not panic, and what it accepts it must write again as it read it.
//!
//! `make fuzz CASES=2000000` runs more inputs than the suite. An input that fails becomes a test of its parser.

use std::fmt::Debug;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::{Config, RngSeed, TestRunner};
use ridged::bench::wire::zaber::{MessageBody, decode_command, decode_message};
use ridged::bench::wire::zaber_stream::LineSplitter;
use ridged::clock::SteppedClock;
use ridged::frame::Frame;
use ridged::lab::ScanRequest;
use ridged::scan::PlanRequest;
use ridged::series::Manifest;
use ridged::sim::controller::Controller;
use ridged::sim::faults::plan::FaultPlan;
use ridged::sim::world::{World, WorldSettings};
use ridged::trace::scene::Scene;
use ridged::wording::json;

/// Inputs per parser in the suite's own run.
const CASES: u32 = 1000;

/// One change of an input.
#[derive(Debug, Clone)]
enum Change {
    /// A bit flips.
    Flip(Index, u8),
    /// A byte takes another value.
    Set(Index, u8),
    /// Bytes are missing.
    Cut(Index, Index),
    /// A piece comes twice.
    Double(Index, Index),
    /// A word of the format, or an extreme value, stands here.
    Insert(Index, Index),
    /// The rest is missing.
    End(Index),
}

fn change() -> impl Strategy<Value = Change> {
    let place = any::<Index>;
    prop_oneof![
        (place(), 0..8_u8).prop_map(|(at, bit)| Change::Flip(at, bit)),
        (place(), any::<u8>()).prop_map(|(at, byte)| Change::Set(at, byte)),
        (place(), place()).prop_map(|(from, to)| Change::Cut(from, to)),
        (place(), place()).prop_map(|(from, to)| Change::Double(from, to)),
        (place(), place()).prop_map(|(at, word)| Change::Insert(at, word)),
        place().prop_map(Change::End),
    ]
}

/// Words that parsers of text stumble over.
const WORDS: &[&str] = &[
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-0",
    "0",
    "-1",
    "1e-320",
    "9223372036854775808",
    "4294967296",
    "\u{feff}",
    "\"",
    "'",
    "\"\"\"",
    "[",
    "]",
    "{",
    "}",
    "[[",
    "=",
    ":",
    ",",
    "\n",
    "\r\n",
    "\t",
    "\\",
    "\\u0000",
    "null",
    "true",
    "# ",
    "\u{2212}1",
    "é",
    "@",
    "#",
    "!",
    "/",
    " ",
    "99",
    "100",
    "--",
    "\0",
];

impl Change {
    fn apply(&self, bytes: &mut Vec<u8>) {
        if bytes.is_empty() {
            bytes.push(0);
        }
        let n = bytes.len();
        let range = |from: &Index, to: &Index| {
            let (a, b) = (from.index(n), to.index(n));
            a.min(b)..a.max(b).min(a.min(b) + 64)
        };
        match self {
            Change::Flip(at, bit) => bytes[at.index(n)] ^= 1 << bit,
            Change::Set(at, byte) => bytes[at.index(n)] = *byte,
            Change::Cut(from, to) => {
                bytes.drain(range(from, to));
            }
            Change::Double(from, to) => {
                let piece = bytes[range(from, to)].to_vec();
                let at = from.index(n);
                bytes.splice(at..at, piece);
            }
            Change::Insert(at, word) => {
                let at = at.index(n);
                let word = WORDS[word.index(WORDS.len())];
                bytes.splice(at..at, word.bytes());
            }
            Change::End(at) => bytes.truncate(at.index(n)),
        }
    }
}

/// Sends changed examples, and bytes without any form, through a parser.
fn fuzz(examples: &[Vec<u8>], parse: impl Fn(&[u8])) {
    let cases = std::env::var("RIDGED_FUZZ_CASES").ok();
    let cases = cases.map_or(CASES, |text| {
        text.parse().expect("RIDGED_FUZZ_CASES is a number")
    });
    // Longer runs look at other inputs than the suite.
    let rng_seed = match cases == CASES {
        true => RngSeed::Fixed(1),
        false => RngSeed::Random,
    };
    let mut runner = TestRunner::new(Config {
        cases,
        rng_seed,
        failure_persistence: None,
        ..Config::default()
    });
    let input = prop_oneof![
        9 => (any::<Index>(), vec(change(), 1..6)).prop_map(|(example, changes)| {
            let mut bytes = examples[example.index(examples.len())].clone();
            changes.iter().for_each(|change| change.apply(&mut bytes));
            bytes
        }),
        1 => vec(any::<u8>(), 0..200),
    ];
    let tried = runner.run(&input, |bytes| {
        let outcome = catch_unwind(AssertUnwindSafe(|| parse(&bytes)));
        prop_assert!(outcome.is_ok(), "b\"{}\"", bytes.escape_ascii());
        Ok(())
    });
    if let Err(failure) = tried {
        panic!("{failure}");
    }
}

fn bytes_of(texts: &[&str]) -> Vec<Vec<u8>> {
    texts.iter().map(|text| text.as_bytes().to_vec()).collect()
}

/// Sends changed texts through a parser of text.
fn fuzz_text<T: Debug>(examples: &[&str], parse: impl Fn(&str) -> T) {
    fuzz(&bytes_of(examples), |bytes| {
        parse(&String::from_utf8_lossy(bytes));
    });
}

fn file(path: &str) -> String {
    let path = format!("{}/{path}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

#[test]
fn messages_of_a_controller() {
    let examples = bytes_of(&[
        "@01 1 07 OK BUSY -- 51200:8B\r\n",
        "@02 0 00 OK IDLE WR 0:BD\r\n",
        "@01 1 08 RJ IDLE -- BADDATA\r\n",
        "@01 0 OK IDLE FS 02 WR WH\r\n",
        "#01 1 07 a long text \\:5A\r\n#01 1 07 cont its end:11\r\n",
        "!01 1 IDLE --:DA\r\n",
        "@01 0 09 OK IDLE -- 7.38\r\n@02 0 09 OK IDLE -- 7.38\r\n",
    ]);
    fuzz(&examples, |bytes| {
        for line in LineSplitter::of_messages().push(bytes) {
            let Ok(message) = decode_message(&line) else {
                continue;
            };
            let MessageBody::Reply(reply) = message.body else {
                continue;
            };
            let Ok(bytes) = reply.encode(true) else {
                continue;
            };
            let lines = LineSplitter::of_messages().push(&bytes);
            // A long reply continues in lines of their own.
            if let [line] = &lines[..] {
                match decode_message(line).map(|message| message.body) {
                    Ok(MessageBody::Reply(read)) => {
                        // Blanks between words have no meaning.
                        assert!(
                            read.data
                                .split_whitespace()
                                .eq(reply.data.split_whitespace())
                        );
                        assert_eq!((read.id, read.flag), (reply.id, reply.flag));
                    }
                    other => panic!("{other:?}"),
                }
            }
        }
    });
}

#[test]
fn commands_of_a_host() {
    let examples = bytes_of(&[
        "/1 1 10 move abs 200000\n",
        "/0 0 03 get system.serial:2B\n",
        "/1 1 11 home:33\n",
        "/1 0 04 tools echo a b c\\:12\n/1 0 04 cont 1 d e:77\n",
        "/2 1 warnings clear\n/2 1 move vel -9999\n",
        "/1 1 12 set maxspeed 200000\n",
        "/renumber\n/1 1\n/1 stop\n",
    ]);
    fuzz(&examples, |bytes| {
        for line in LineSplitter::of_commands().push(bytes) {
            decode_command(&line).ok();
        }
        let world = World::new(Arc::new(SteppedClock::new()), WorldSettings::default());
        let mut controller = Controller::new(&Arc::new(world));
        for line in LineSplitter::of_messages().push(&controller.receive(bytes)) {
            decode_message(&line).expect("a controller sends what a host understands");
        }
    });
}

/// Small frames of different contents.
fn frames() -> Vec<Frame> {
    let count = |i: u32| (i * 977 % 65_536) as u16;
    [(1, 1), (3, 2), (16, 16)]
        .map(|(w, h)| Frame::new(w, h, (0..w * h).map(count).collect()).unwrap())
        .into()
}

fn read_frame(bytes: &[u8]) {
    if let Ok(frame) = Frame::read(bytes) {
        let png = frame.to_png().unwrap();
        assert_eq!(Frame::from_png(&png).unwrap(), frame);
    }
}

#[test]
fn png_of_a_camera() {
    let mut examples: Vec<Vec<u8>> = frames().iter().map(|f| f.to_png().unwrap()).collect();
    let mut colour = Vec::new();
    let mut encoder = png::Encoder::new(&mut colour, 2, 2);
    encoder.set_color(png::ColorType::Rgb);
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&[7; 12])
        .unwrap();
    examples.push(colour);
    fuzz(&examples, read_frame);
}

#[test]
fn tiff_of_a_camera() {
    use tiff::encoder::{Compression, TiffEncoder, colortype::Gray16};

    let mut examples = Vec::new();
    for frame in frames() {
        for compression in [Compression::Uncompressed, Compression::Lzw] {
            let mut file = std::io::Cursor::new(Vec::new());
            TiffEncoder::new(&mut file)
                .unwrap()
                .with_compression(compression)
                .write_image::<Gray16>(frame.width_px(), frame.height_px(), frame.pixels_dn())
                .unwrap();
            examples.push(file.into_inner());
        }
    }
    fuzz(&examples, read_frame);
}

#[test]
fn settings() {
    let example = file("ridged.example.toml");
    let small = "port = \"/dev/ttyUSB0\"\n[stage.theta_c]\naddress = 1\ndirection = 1\nzero_deg = 0\nlimits_deg = [-60, 60]\n\
                 [camera]\nfolder = \"/tmp\"\nexposures_s = [0.02]\nwidth_px = 64\nheight_px = 48\n";
    fuzz_text(&[&example, small], |text| {
        ridged::config::Config::from_text(text, "settings", [])
    });
}

#[test]
fn manifests_and_scenes() {
    let manifest = file("tests/data/series/steel-15/manifest.toml");
    fuzz_text(&[&manifest], |text| {
        Manifest::from_outside(text, "series.toml")
    });
    let scenes = ["glass-over-rough-gold", "ridged-plastic", "sandpaper"];
    let scenes = scenes.map(|name| file(&format!("scenes/{name}.toml")));
    fuzz_text(&scenes.each_ref().map(String::as_str), Scene::parse);
    let faults = file("docs/examples/faults.toml");
    fuzz_text(&[&faults], FaultPlan::read);
}

#[test]
fn lists_of_frames() {
    let list = "file,kind,theta_c_deg,phi_s_deg,exposure_s,repeat,timestamp\n\
                a.png,dark,0,0,0.02,0,2026-01-01T00:00:00Z\nb.png,sample,10.5,\u{2212}20,0.02,0,2026-01-01T00:00:01Z\n";
    let semicolons = list.replace(',', ";").replace('.', ",");
    fuzz_text(&[list, &semicolons], |text| {
        ridged::series::FrameRow::read_all(text, "frames.csv").map(|rows| rows.len())
    });
}

#[test]
fn bodies_of_requests() {
    let examples = [
        r#"{"sample_id": 2, "plan": {"preset": "paper", "exposures_s": [0.02, 0.06]}}"#,
        r#"{"sample_id": 1, "plan": {"theta_c_deg": {"start": -40, "stop": 40, "step": 4}, "phi_s_deg": [0, 90], "repeats": 2}}"#,
        r#"{"scan_id": 3, "variant": "sawtooth", "fix": {"rho_d": 0.3}, "prior": {"theta_r_deg": [10, 0.5]}}"#,
        r#"{"scan_id": 3, "specification": {"name": "part 17", "limits": {"theta_r_deg": {"lower": 9.5, "upper": 10.5}}}}"#,
        r#"{"scene": "schema = \"scene-1\"", "files": {"a.tif": "AAAA"}, "max_seconds": 30, "compare": true}"#,
    ];
    fuzz(&bytes_of(&examples), |bytes| {
        json::from_slice::<ScanRequest>(bytes).ok();
        json::from_slice::<PlanRequest>(bytes).ok();
        json::from_slice::<ridged::lab::FitRequest>(bytes).ok();
        json::from_slice::<ridged::lab::MapRequest>(bytes).ok();
        json::from_slice::<ridged::lab::ContrastRequest>(bytes).ok();
        json::from_slice::<ridged::lab::VerdictRequest>(bytes).ok();
        json::from_slice::<ridged::lab::TraceRequest>(bytes).ok();
    });
}
