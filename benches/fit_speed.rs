//! Seconds of a whole fit of 108 observations from eight given starts, beside a peer's.
//!
//! `make bench-peers-fit` times scipy first and hands its answer on; alone:
//! `cargo bench --bench fit_speed -- tests/data/series/polymer-10`. The model is the closed form; the peer's is simpler (one
//! lobe with exact visibility and a Lambert term). A fit here is what a search does first: eight starts with exact
//! derivatives as lanes, descent and polish of every different end, and the covariance of the best.

#![expect(clippy::print_stdout, reason = "a bench prints what it measures")]

use std::hint::black_box;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use ridged::fit::estimate::StartReport;
use ridged::fit::least_squares::levenberg_marquardt::Minimum;
use ridged::fit::multistart::from_starts;
use ridged::fit::problem::{Problem, Quantity, Values};
use ridged::fit::uncertainty::covariance::covariance;
use ridged::geometry::{Cones, Pose, RigGeometry};
use ridged::material::Material;
use ridged::model::Variant;
use ridged::observation::{Observation, ObservationSet, Prior};

/// Times that each fit is repeated; the best counts, as it does for the peer.
const REPEATS: usize = 200;
/// Seven, as many as the peer's: the stray light is not among them.
const FREE: [Quantity; 7] = [
    Quantity::ThetaR,
    Quantity::AlphaU,
    Quantity::AlphaV,
    Quantity::RhoD,
    Quantity::Scale,
    Quantity::AzimuthOffset,
    Quantity::TiltOffset,
];

fn main() -> Result<(), anyhow::Error> {
    let words: Vec<String> = std::env::args()
        .skip(1)
        .filter(|word| word != "--bench")
        .collect();
    let folder = words.first().map_or("tests/data/series/polymer-10", |w| w);
    let peer: Option<serde_json::Value> = match words.get(1) {
        Some(text) => Some(serde_json::from_str(text)?),
        None => None,
    };
    let set = radiances(folder)?;
    let sigma = set.observations.iter().map(|o| o.sigma).collect();
    let starts = starts();
    let problem = Problem::new(&set, Variant::Sawtooth, FREE.to_vec(), starts[0]).with_sigma(sigma);
    tell("closed form", &problem, &starts, peer.as_ref());
    Ok(())
}

/// Times one model and prints a line.
fn tell(name: &str, problem: &Problem<'_>, starts: &[Values], peer: Option<&serde_json::Value>) {
    let cancel = AtomicBool::new(false);
    let whole = || -> Option<(Minimum, StartReport)> {
        let (best, report) = from_starts(problem, starts, &cancel)?;
        let m = best.residuals.len();
        black_box(covariance(&best.jacobian, m, &best.residuals));
        Some((best, report))
    };
    let mut seconds = f64::INFINITY;
    let mut last = None;
    for _ in 0..REPEATS {
        let began = Instant::now();
        last = black_box(whole());
        seconds = seconds.min(began.elapsed().as_secs_f64());
    }
    let Some((best, report)) = last else {
        println!("ridged {name}: no start has a value");
        return;
    };
    let values = problem.unpack(&best.parameters).folded();
    println!(
        "ridged {name}: {:.3} ms, θr {:.4}°, cost {:.4}, {:?} after {} evaluations; of {} starts {} at \
         the minimum, {} converged elsewhere, {} not converged",
        1e3 * seconds,
        values.theta_r.to_degrees(),
        best.cost,
        best.ending,
        best.evaluations,
        report.tried,
        report.at_minimum,
        report.elsewhere,
        report.not_converged
    );
    for (model, words) in [
        ("plain", "written as a user would"),
        ("by_hand", "written by hand for speed"),
    ] {
        if let Some(other) = peer.and_then(|p| p[model]["seconds"].as_f64()) {
            println!(
                "  {:.0} × faster than scipy on its model {words} ({:.1} ms)",
                other / seconds,
                1e3 * other
            );
        }
    }
}

/// The eight starts of the peer.
fn starts() -> Vec<Values> {
    let mut starts = Vec::new();
    for theta_r_deg in [5.0f64, 10.0, 15.0, 20.0] {
        for alpha in [0.06, 0.15] {
            starts.push(Values {
                theta_r: theta_r_deg.to_radians(),
                alpha_u: alpha,
                alpha_v: alpha,
                rho_d: 0.1,
                eta: 1.54,
                ..Values::IDEAL
            });
        }
    }
    starts
}

/// The noise-free radiances of a series, weighted as the peer does.
fn radiances(folder: &str) -> Result<ObservationSet, anyhow::Error> {
    let mut observations = Vec::new();
    let mut reader = csv::Reader::from_path(format!("{folder}/radiance.csv"))?;
    let names = reader.headers()?.clone();
    let column = |name: &str| {
        let found = names.iter().position(|n| n == name);
        found.ok_or_else(|| anyhow::anyhow!("radiance.csv has no column {name}"))
    };
    let (tilt, turn) = (column("theta_c_deg")?, column("phi_s_deg")?);
    let (region, radiance) = (column("region")?, column("radiance")?);
    for row in reader.records() {
        let row = row?;
        if &row[region] != "all" {
            continue;
        }
        let signal: f64 = row[radiance].parse()?;
        let pose = Pose::from_deg(row[tilt].parse()?, row[turn].parse()?);
        observations.push(Observation::new(pose, signal, 0.01 * signal + 0.001));
    }
    Ok(ObservationSet::bare(
        RigGeometry {
            cones: Cones::NONE,
            ..RigGeometry::IN_PLANE
        },
        Material::exactly(1.54, 0.0),
        observations,
        Prior {
            mean: 0.0,
            std: 1.0,
        },
    ))
}
