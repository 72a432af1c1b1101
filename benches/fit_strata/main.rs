//! The fit against random synthetic series: does it find the minimum, is its status
//! true, do its intervals cover (in the stiff stratum: the profiles)?
//!
//! `cargo bench --bench fit_strata -- --stratum ordinary|stiff|paper|both|traced --cases N --seed S`; the whole
//! proof is `--stratum both --cases 5000`, some hours on two cores, most of them stiff (it prints the time left); runs of fewer
//! cases with other seeds add up to it. `--identifiable --crowd 1` looks at coverage alone, `--constants` at the constants of the
//! search, at half and at twice their values. It ends with one line per requirement
//! and fails (exit 1) where one is not met.
//!
//! These series are painted by the closed form that is fitted, so the model is exact and the
//! observations' own uncertainties are the whole truth. `--stratum traced` has the light of the ray tracer instead.

#![expect(
    clippy::print_stderr,
    clippy::print_stdout,
    reason = "the figures are this program's answer"
)]

mod constants;
mod draw;
mod judge;
mod traced;

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use clap::Parser;
use rayon::prelude::*;
use ridged::fit::one_variant::estimate;
use ridged::fit::problem::Quantity;
use ridged::fit::report::build::report_of;
use ridged::fit::report::{Parameter, Status, VariantName};
use ridged::fit::search_setup::free_quantities;
use ridged::fit::uncertainty::budget::uncertainty;
use ridged::fit::uncertainty::intervals;
use ridged::fit::{FitOptions, VariantChoice};
use ridged::model::Variant;

use draw::Stratum;

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Wanted {
    Ordinary,
    Stiff,
    Paper,
    /// First ordinary, then stiff.
    Both,
    /// Path-traced light of ideal ridges, at 15 and at 108 poses: coverage alone.
    Traced,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum WantedVariant {
    Auto,
    Traced,
}

impl From<WantedVariant> for VariantChoice {
    fn from(wanted: WantedVariant) -> Self {
        match wanted {
            WantedVariant::Auto => VariantChoice::Auto,
            WantedVariant::Traced => VariantChoice::Traced,
        }
    }
}

#[derive(Debug, Parser)]
struct Args {
    #[arg(long, value_enum, default_value_t = Wanted::Ordinary)]
    stratum: Wanted,
    #[arg(long, default_value_t = 200)]
    cases: u64,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Starts of the crowd that the fit is compared with.
    #[arg(long, default_value_t = 256)]
    crowd: usize,
    /// Only the series that are identifiable at the truth; with `--crowd 1`, the truth alone, for coverage in a
    /// tenth of the time.
    #[arg(long)]
    identifiable: bool,
    /// Of those only the series that tell ρd too, as a third of the stiff ones do.
    #[arg(long, requires = "identifiable")]
    determines_rho_d: bool,
    /// Only these cases, by their own seeds as `--verbose` tells them.
    #[arg(long, value_delimiter = ',')]
    only: Vec<u64>,
    /// Begins no case later than this and reports on those begun.
    #[arg(long)]
    max_seconds: Option<f64>,
    /// Prints every case that is not as expected.
    #[arg(long)]
    verbose: bool,
    /// Let the fits look for a misfit of the model, as those of real samples do.
    #[arg(long)]
    misfit: bool,
    /// Runs the search with each constant of `fit::tuning` at half and at twice its value and prints a table.
    #[arg(long)]
    constants: bool,
    /// Variant whose coverage on traced light is counted.
    #[arg(long, value_enum, default_value_t = WantedVariant::Auto)]
    variant: WantedVariant,
    /// Given by cargo.
    #[arg(long)]
    bench: bool,
}

/// What one case showed.
#[derive(Debug)]
struct Outcome {
    seed: u64,
    excess: f64,
    chi2: f64,
    status: Option<Status>,
    identifiable: bool,
    null_with_std: Vec<Quantity>,
    /// (truth − value)/expanded per parameter, only where identifiable at the truth.
    pulls: Vec<(&'static str, f64)>,
    /// Identifiable at the truth, yet null in the report.
    withheld: Vec<&'static str>,
    story: String,
    took: Duration,
}

fn main() -> ExitCode {
    let args = Args::parse();
    let strata = match args.stratum {
        Wanted::Ordinary => vec![Stratum::Ordinary],
        Wanted::Stiff => vec![Stratum::Stiff],
        Wanted::Paper => vec![Stratum::Paper],
        Wanted::Both => vec![Stratum::Ordinary, Stratum::Stiff],
        Wanted::Traced => {
            return match traced::run(args.cases, args.seed, args.variant.into()) {
                true => ExitCode::SUCCESS,
                false => ExitCode::FAILURE,
            };
        }
    };
    let mut met = true;
    for stratum in strata {
        println!("{stratum:?}, seed {}", args.seed);
        if args.constants {
            constants::table(stratum, &args);
            continue;
        }
        met &= run(stratum, &args);
    }
    if met {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// One stratum; whether all requirements are met.
fn run(stratum: Stratum, args: &Args) -> bool {
    let done = AtomicUsize::new(0);
    let started = Instant::now();
    let last = Mutex::new(Instant::now());
    let seeds: Vec<u64> = if args.only.is_empty() {
        let first = args.seed.wrapping_mul(1_000_003);
        (0..args.cases).map(|k| first + k).collect()
    } else {
        args.only.clone()
    };
    let seeds: Vec<u64> = if args.identifiable {
        let identifiable = |seed: &u64| {
            let case = draw::case(stratum, *seed);
            let (free, _) = free_quantities(&case.set, case.variant);
            let linear = judge::linear(&case, &free);
            let is_significant = |q: Quantity| {
                let std = free.iter().zip(&linear.std).find(|(f, _)| **f == q);
                std.is_some_and(|(_, std)| enough(q, *std))
            };
            linear.identifiable && (!args.determines_rho_d || is_significant(Quantity::RhoD))
        };
        seeds.into_par_iter().filter(identifiable).collect()
    } else {
        seeds
    };
    let all = seeds.len();
    if all == 0 {
        println!("none of these series is identifiable");
        return false;
    }
    let late = |limit: f64| started.elapsed().as_secs_f64() > limit;
    let outcomes: Vec<Outcome> = seeds
        .into_par_iter()
        .filter(|_| !args.max_seconds.is_some_and(late))
        .map(|seed| {
            let outcome = one(stratum, seed, args);
            let n = done.fetch_add(1, Ordering::Relaxed) + 1;
            if let Ok(mut last) = last.try_lock()
                && last.elapsed() > Duration::from_secs(10)
            {
                let spent = started.elapsed().as_secs_f64();
                let left = spent / n as f64 * (all - n) as f64;
                eprintln!("{n}/{all} cases, {left:.0} s left");
                *last = Instant::now();
            }
            outcome
        })
        .collect();
    if outcomes.is_empty() {
        println!(
            "no case was begun within {} s",
            args.max_seconds.unwrap_or(0.0)
        );
        return false;
    }
    if outcomes.len() < all {
        println!("time was over after {} of {all} series", outcomes.len());
    }
    report(&outcomes, args.verbose);
    verdict(stratum, &outcomes)
}

/// One line per requirement.
fn verdict(stratum: Stratum, outcomes: &[Outcome]) -> bool {
    let n = outcomes.len();
    let share = |met: usize, of: usize| 100.0 * met as f64 / of.max(1) as f64;
    let at_minimum = outcomes.iter().filter(|o| o.at_minimum()).count();
    let lies = outcomes.iter().filter(|o| o.lies()).count();
    let nulls = outcomes
        .iter()
        .filter(|o| !o.null_with_std.is_empty())
        .count();
    let asked = if stratum == Stratum::Stiff {
        99.5
    } else {
        99.9
    };
    let mut all = true;
    let mut line = |met: bool, text: String| {
        all &= met;
        println!("{} {text}", if met { "met    " } else { "NOT MET" });
    };
    let found = share(at_minimum, n);
    line(
        found >= asked,
        format!(
            "minimum: {at_minimum} of {n} at or below the crowd's best ({found:.2} %, asked {asked})"
        ),
    );
    let missed = outcomes
        .iter()
        .filter(|o| o.identifiable && !o.at_minimum());
    let missed = missed.count();
    line(
        missed == 0,
        format!("minimum: {missed} of the identifiable series missed (asked 0)"),
    );
    line(
        lies == 0,
        format!("status: {lies} successes with Δχ² > 4 (asked 0)"),
    );
    line(
        nulls == 0,
        format!("null directions: {nulls} with a finite std (asked 0)"),
    );
    for (name, (inside, of, _)) in coverage(outcomes) {
        let covered = share(inside, of);
        // Below a thousand cases the share itself is uncertain by 2 √(p (1 − p)/n).
        let slack = if of >= 1000 {
            0.0
        } else {
            200.0 * (0.95 * 0.05 / of as f64).sqrt()
        };
        line(
            (93.0 - slack..=97.0 + slack).contains(&covered),
            format!("coverage of {name}: {covered:.2} % of {of} (asked 93 to 97, n ≥ 1000)"),
        );
    }
    all
}

/// Per parameter: inside, of, worst in expanded uncertainties.
fn coverage(outcomes: &[Outcome]) -> BTreeMap<&'static str, (usize, usize, f64)> {
    let mut cover: BTreeMap<&'static str, (usize, usize, f64)> = BTreeMap::new();
    for (name, pull) in outcomes.iter().flat_map(|o| &o.pulls) {
        let entry = cover.entry(name).or_default();
        entry.0 += usize::from(pull.abs() <= 1.0);
        entry.1 += 1;
        entry.2 = entry.2.max(pull.abs());
    }
    cover
}

impl Outcome {
    fn at_minimum(&self) -> bool {
        judge::is_deepest(self.chi2, self.excess)
    }

    /// A success claimed well above the minimum.
    fn lies(&self) -> bool {
        matches!(self.status, Some(Status::Converged | Status::AtBound)) && self.excess > 4.0
    }
}

/// Whether an identifiable series tells this quantity as well, by its linear standard uncertainty at the truth.
fn enough(quantity: Quantity, std: f64) -> bool {
    match quantity {
        Quantity::AzimuthOffset | Quantity::TiltOffset => std < 2f64.to_radians(),
        Quantity::RhoD => std < 0.1,
        _ => true,
    }
}

fn one(stratum: Stratum, seed: u64, args: &Args) -> Outcome {
    let case = draw::case(stratum, seed);
    let cancel = AtomicBool::new(false);
    let options = FitOptions {
        misfit: args.misfit,
        ..FitOptions::default()
    };
    let begun = Instant::now();
    let fitted = estimate(&case.set, case.variant, &options, None, &cancel);
    let took = begun.elapsed();
    let (best, best_values) = judge::best_of(&case, stratum, args.crowd, seed);
    let Some(e) = fitted else {
        return Outcome {
            seed,
            excess: f64::INFINITY,
            chi2: f64::INFINITY,
            status: None,
            identifiable: false,
            null_with_std: Vec::new(),
            pulls: Vec::new(),
            withheld: Vec::new(),
            story: String::new(),
            took,
        };
    };
    let name = match case.variant {
        Variant::Paper => VariantName::Paper,
        Variant::Sawtooth => VariantName::Sawtooth,
    };
    let mut report = report_of(&e, name);
    let chi2 = judge::chi2(&case, &e.values);
    let linear = judge::linear(&case, e.problem.free());
    if stratum == Stratum::Stiff && linear.identifiable {
        // A parabola is too much to ask of these: their intervals are profiles.
        let options = FitOptions {
            profile: true,
            ..options
        };
        let u = uncertainty(&e);
        intervals::add(&mut report, &e, &u, &options, &|| false, &cancel);
    }
    let named = |q: Quantity| -> Option<(&'static str, &Parameter, f64)> {
        let p = &report.parameters;
        let deg = 1f64.to_radians();
        Some(match q {
            Quantity::ThetaR => ("theta_r_deg", &p.theta_r_deg, deg),
            Quantity::AlphaU => ("alpha_u", &p.alpha_u, 1.0),
            Quantity::AlphaV => ("alpha_v", &p.alpha_v, 1.0),
            Quantity::RhoD => ("rho_d", &p.rho_d, 1.0),
            Quantity::AzimuthOffset => ("azimuth_offset_deg", &p.azimuth_offset_deg, deg),
            Quantity::TiltOffset => ("tilt_offset_deg", &p.tilt_offset_deg, deg),
            _ => return None,
        })
    };
    let nulls = judge::null_parts(&case, &e.values);
    let null_with_std = nulls
        .into_iter()
        .filter(|q| named(*q).is_some_and(|(_, p, _)| p.std.is_some()))
        .collect();
    // (θr, φ) ≡ (−θr, φ + 180°): the truth in either form.
    let judged = |turned: bool| {
        let (mut pulls, mut withheld) = (Vec::new(), Vec::new());
        for (q, std) in e.problem.free().iter().zip(&linear.std) {
            let Some((name, p, unit)) = named(*q) else {
                continue;
            };
            if !enough(*q, *std) {
                continue;
            }
            let mut t = judge::true_value(&case.truth, *q);
            if matches!(q, Quantity::AlphaU | Quantity::AlphaV) {
                t = t.exp();
            }
            let mut t = t / unit;
            if turned {
                match q {
                    Quantity::ThetaR => t = -t,
                    Quantity::AzimuthOffset => t += 180.0,
                    _ => {}
                }
            }
            match (p.value, p.expanded) {
                (Some(v), Some(x)) => {
                    let mut d = t - v;
                    if *q == Quantity::AzimuthOffset {
                        d -= (d / 360.0).round() * 360.0;
                    }
                    // An open end covers all that lies there.
                    let half = match p.profile {
                        None => x,
                        Some(i) if d < 0.0 => i.lower.map_or(f64::INFINITY, |l| v - l),
                        Some(i) => i.upper.map_or(f64::INFINITY, |u| u - v),
                    };
                    pulls.push((name, d / half));
                }
                _ => withheld.push(name),
            }
        }
        (pulls, withheld)
    };
    // The nearer one: that whose ridge angle and azimuth lie less far outside.
    let outside = |pulls: &[(&str, f64)]| {
        let both = pulls
            .iter()
            .filter(|p| ["theta_r_deg", "azimuth_offset_deg"].contains(&p.0));
        both.map(|p| p.1.abs()).fold(0.0, f64::max)
    };
    let (pulls, withheld) = if linear.identifiable {
        let (as_it_is, turned) = (judged(false), judged(true));
        if outside(&turned.0) < outside(&as_it_is.0) {
            turned
        } else {
            as_it_is
        }
    } else {
        Default::default()
    };
    let show = |v: &ridged::fit::problem::Values| {
        format!(
            "θr {:.3} αu {:.5} αv {:.5} ρd {:.4} s {:.4} b {:.3e} daz {:.3} dt {:.3}",
            v.theta_r.to_degrees(),
            v.alpha_u,
            v.alpha_v,
            v.rho_d,
            v.scale,
            v.background,
            v.azimuth_offset.to_degrees(),
            v.tilt_offset.to_degrees()
        )
    };
    let truth = judge::values(&case.truth);
    let story = format!(
        "{:?} m {} absolute {} metal {} peak/σ {:.1}\n    truth {} χ² {:.2}\n    best  {} χ² {:.4}\n    ours  {} χ² {:.4} ({:.4} by the fit) {:?} bound {:?} starts {:?}",
        case.variant,
        case.set.observations.len(),
        case.set.white_reference.is_some(),
        case.truth.surface.rho_d == 0.0,
        case.set
            .observations
            .iter()
            .map(|o| o.signal / o.sigma)
            .fold(0.0, f64::max),
        show(&truth),
        judge::chi2(&case, &truth),
        show(&best_values.folded()),
        best,
        show(&e.values.folded()),
        chi2,
        e.minimum.cost,
        e.minimum.ending,
        e.minimum.at_bound,
        e.starts,
    );
    Outcome {
        seed,
        excess: chi2 - best,
        chi2,
        status: Some(report.status),
        identifiable: linear.identifiable,
        null_with_std,
        pulls,
        withheld,
        story,
        took,
    }
}

fn report(outcomes: &[Outcome], verbose: bool) {
    let n = outcomes.len();
    let known = outcomes.iter().filter(|o| o.identifiable).count();
    let found = outcomes.iter().filter(|o| o.identifiable && o.at_minimum());
    println!(
        "{n} series, {known} of them identifiable at the truth; of these {} at or below the crowd's best",
        found.count()
    );
    let mut statuses: BTreeMap<String, usize> = BTreeMap::new();
    for o in outcomes {
        *statuses.entry(format!("{:?}", o.status)).or_default() += 1;
    }
    println!("statuses: {statuses:?}");
    let mut withheld: BTreeMap<&str, usize> = BTreeMap::new();
    for name in outcomes.iter().flat_map(|o| &o.withheld) {
        *withheld.entry(name).or_default() += 1;
    }
    for (name, (inside, all, worst)) in coverage(outcomes) {
        println!(
            "  {name:20} {inside}/{all} covered ({:.1} %), worst {worst:.1} × expanded, withheld {}",
            100.0 * inside as f64 / all as f64,
            withheld.get(name).unwrap_or(&0)
        );
    }
    let mut times: Vec<f64> = outcomes
        .iter()
        .map(|o| o.took.as_secs_f64() * 1e3)
        .collect();
    times.sort_by(f64::total_cmp);
    println!(
        "ms per fit: median {:.2}, 90 % {:.2}, longest {:.2}",
        times[n / 2],
        times[n * 9 / 10],
        times[n - 1]
    );
    if verbose {
        let slow = Duration::from_secs_f64(times[n * 99 / 100] / 1e3);
        for o in outcomes {
            let late = !o.at_minimum();
            let far = o.pulls.iter().any(|p| p.1.abs() > 3.0);
            if late || far || !o.null_with_std.is_empty() || o.took >= slow {
                println!(
                    "case {} excess {:.4e} {:?} identifiable {} nulls {:?} took {:.2} s\n    {}",
                    o.seed,
                    o.excess,
                    o.status,
                    o.identifiable,
                    o.null_with_std,
                    o.took.as_secs_f64(),
                    o.story
                );
            }
        }
    }
}
