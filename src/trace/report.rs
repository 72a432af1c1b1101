//! A run in one object: what `ridged trace --json` prints and `/traces` answers.

use serde::{Deserialize, Serialize, Serializer};

use super::scene::{LeftOut, Prepared, RidgeAngle};
use super::spread::Surfaces;
use super::surface::Interface;
use super::tally::{Energies, Estimate, ORDERS, Totals};
use crate::wording::{percent, significant};

/// Energies, errors and what was left out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Photons launched.
    pub photons: u64,
    /// Time of the run, s, where it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Part of `seconds` for the photons alone, set-up included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run_seconds: Option<f64>,
    /// Part of `run_seconds` before the first photon: where the light falls, and what is certain of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub setup_seconds: Option<f64>,
    /// Before `seconds`: making or reading the surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface_seconds: Option<f64>,
    /// Whether polarisation was followed.
    pub polarised: bool,
    /// Shares of the light.
    pub energy: Energy,
    /// Relative error of the reflected bins, root mean square ([`Totals::relative_error`]).
    pub relative_error: Option<f64>,
    /// Independent replicates behind the standard errors.
    pub batches: u64,
    /// Effective ridge angles of the interfaces that have one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ridge_angles: Vec<RidgeAngle>,
    /// Other surfaces of the same statistics, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surfaces: Option<Surfaces>,
    /// What the standard errors are of, and what they are not.
    pub notes: Vec<String>,
    /// What was left out, why, and what that may cost.
    pub left_out: Vec<LeftOut>,
    /// Who computed it.
    pub program: String,
}

/// Shares of the light; the first four add up to 1.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Energy {
    /// Back to the upper side.
    pub reflected: Estimate,
    /// Through the last interface.
    pub transmitted: Estimate,
    /// By metals, layers and diffuse bodies.
    pub absorbed: Estimate,
    /// Given up.
    pub truncated: Estimate,
    /// R1, R2, … and T1, T2, …: by the number of interactions.
    #[serde(serialize_with = "as_map")]
    pub by_interactions: Vec<(String, Estimate)>,
}

fn as_map<S: Serializer>(list: &[(String, Estimate)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(list.iter().map(|(name, x)| (name, x)))
}

/// What a report tells of the scene besides what was counted. The files of shards carry it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct About {
    /// What is left out.
    pub left_out: Vec<LeftOut>,
    /// Effective ridge angles of the interfaces that have one.
    pub ridge_angles: Vec<RidgeAngle>,
    /// Whether a surface is drawn at random.
    pub is_drawn: bool,
    /// Whether light can come out below.
    #[serde(default)]
    pub is_open_below: bool,
    /// Whether the media are alike all the way, so that nothing is reflected anywhere.
    #[serde(default)]
    pub is_clear: bool,
}

impl About {
    /// Of a scene that is ready to trace.
    #[must_use]
    pub fn of(prepared: &Prepared) -> Self {
        let clear = |interface: &Interface| {
            let back = interface.from_above.at(0.5).reflected;
            back.s + back.p < NOTHING && interface.diffuse.is_none()
        };
        About {
            is_clear: prepared.stack.interfaces.iter().all(clear),
            left_out: prepared.left_out.clone(),
            ridge_angles: prepared.ridge_angles.clone(),
            is_drawn: prepared.is_drawn,
            is_open_below: prepared
                .stack
                .interfaces
                .last()
                .is_some_and(|last| !last.from_above.is_metal() && last.diffuse.is_none()),
        }
    }
}

/// Share of the light that is given up from which on that is said.
const MUCH_TRUNCATED: f64 = 1e-3;

/// What a reader of the standard errors should know of them.
fn notes(totals: &Totals, e: &Energies<Estimate>) -> Vec<String> {
    let all = [&e.reflected_all, &e.transmitted_all, &e.absorbed];
    let mut notes = Vec::new();
    if totals.batches() < 2 {
        notes.push("a single replicate gives no error: launch more photons".to_owned());
    } else if all.iter().all(|x| x.std == 0.0) && e.truncated.value < MUCH_TRUNCATED {
        notes.push(
            "nothing was left to chance: where all light goes is known from the surface, so the standard errors \
             are 0 but for rounding"
                .to_owned(),
        );
    }
    notes.extend(given_up(e.truncated.value));
    notes
}

/// Photons that none of a kind was among leave it a share of this over their number, with a probability of 95 %.
const UNMET: f64 = 3.0;

/// What an end of light that no photon met says, and does not say.
fn unmet(photons: u64, what: &str, other: &str) -> String {
    format!(
        "no photon of {photons} was {what}: that leaves up to {} of the light, and the error of what is {other} is no \
         smaller; more photons would show it",
        significant(UNMET / photons.max(1) as f64)
    )
}

/// Relative error up to which nothing was left to chance: that of rounding is 4e-9 and less.
const DECIDED: f64 = 1e-7;

/// A reflectance that is rounding.
const NOTHING: f64 = 1e-30;

/// Whether anything was left to chance: light by its interactions, since where all goes the same way the sum is certain
/// even if other ways are open.
fn is_chance(energy: &Energy) -> bool {
    let mut all = energy.by_interactions.iter();
    all.any(|(_, x)| x.std > DECIDED * x.value)
}

/// What to know of light that was given up, where that is much.
fn given_up(share: f64) -> Option<String> {
    (share > MUCH_TRUNCATED).then(|| {
        format!(
            "{} of the light was given up on its way (after run.interactions_max interactions, or all but level \
             with the surface): all other shares may lack as much",
            percent(share)
        )
    })
}

impl Report {
    /// Several surfaces were asked for: what they say, or that none but the first was traced in time.
    pub fn spread_over(&mut self, surfaces: Option<Surfaces>) {
        if surfaces.is_some() {
            // The errors over surfaces need no warning; what was given up does.
            self.notes = given_up(self.energy.truncated.value).into_iter().collect();
        } else {
            let none = "no other surface was traced in the time: allow more seconds, or ask for fewer photons";
            self.notes.push(none.to_owned());
        }
        self.surfaces = surfaces;
    }

    /// Of what was counted; times, and what belongs to the scene, are for the caller to fill in.
    #[must_use]
    pub fn new(totals: &Totals, polarised: bool) -> Self {
        let e: Energies<Estimate> = totals.energies();
        let mut by_interactions = Vec::new();
        for (side, orders) in [("R", &e.reflected), ("T", &e.transmitted)] {
            let used = orders
                .iter()
                .rposition(|x| x.value != 0.0)
                .map_or(1, |n| n + 1);
            for (n, x) in orders.iter().take(used).enumerate() {
                let more = if n + 1 == ORDERS { "plus" } else { "" };
                by_interactions.push((format!("{side}{}{more}", n + 1), *x));
            }
        }
        Report {
            photons: totals.photons(),
            seconds: None,
            run_seconds: None,
            setup_seconds: None,
            surface_seconds: None,
            polarised,
            energy: Energy {
                reflected: e.reflected_all,
                transmitted: e.transmitted_all,
                absorbed: e.absorbed,
                truncated: e.truncated,
                by_interactions,
            },
            relative_error: totals.relative_error(),
            batches: totals.batches(),
            ridge_angles: Vec::new(),
            surfaces: None,
            notes: notes(totals, &e),
            left_out: Vec::new(),
            program: format!("ridged {}", env!("CARGO_PKG_VERSION")),
        }
    }

    /// Of a run of a scene.
    #[must_use]
    pub fn of(prepared: &Prepared, totals: &Totals) -> Self {
        Report::new(totals, prepared.polarised).about(About::of(prepared))
    }

    /// With what is to be told of the scene.
    #[must_use]
    pub fn about(mut self, scene: About) -> Self {
        if scene.is_drawn {
            self.notes.push(
                "the errors are the photons' on this one surface; others of the same statistics may differ from it by \
                 more: `--surfaces N` shows by how much"
                    .to_owned(),
            );
        }
        let (up, down) = (self.energy.reflected, self.energy.transmitted);
        let is_chance = is_chance(&self.energy);
        // Equal media, Brewster's angle and total reflection leave nothing to be met.
        if up.value == 0.0 && down.value > 0.0 && is_chance && !scene.is_clear {
            self.notes
                .push(unmet(self.photons, "reflected", "transmitted"));
        }
        if scene.is_open_below && down.value == 0.0 && up.value > 0.0 && is_chance {
            self.notes
                .push(unmet(self.photons, "transmitted", "reflected"));
        }
        self.ridge_angles = scene.ridge_angles;
        self.left_out = scene.left_out;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::super::run::{Shard, trace};
    use super::super::scene::Scene;
    use super::*;

    #[test]
    fn an_end_that_no_photon_met_is_no_proof_that_there_is_none() {
        let told = |below: &str| {
            let scene = format!(
                "[[interface]]\nshape = \"smith\"\nalpha_u = 5.0\nalpha_v = 5.0\nbelow = {below}\n\
                 [run]\nphotons = 60\nseed = 3\n[light]\ntheta_i_deg = 0.0\n"
            );
            let ready = Scene::parse(&scene)
                .unwrap()
                .prepare(&|_| Err(String::new()))
                .unwrap();
            let totals = trace(&ready, Shard::WHOLE, &|_| true);
            let report = Report::of(&ready, &totals);
            let unmet = report.notes.iter().any(|n| n.starts_with("no photon"));
            (unmet, report.energy)
        };
        let (unmet, energy) = told("{ n = 1.5 }");
        assert_eq!(unmet, energy.reflected.value == 0.0, "{energy:?}");
        assert!(unmet);
        // Nothing comes out under a metal.
        assert!(!told("{ n = 0.2, k = 3.0 }").0);
    }

    #[test]
    fn a_boundary_that_decides_where_all_light_goes_leaves_nothing_unmet() {
        let told = |n_top: f64, theta_i_deg: f64, stokes: &str, method: &str, shape: &str| {
            let scene = format!(
                "n_top = {n_top:?}\n[light]\ntheta_i_deg = {theta_i_deg:?}\nstokes = {stokes}\n[[interface]]\n{shape}\n\
                 below = {{ n = 1.0 }}\n[run]\nphotons = 1000\nmethod = \"{method}\"\n"
            );
            let scene = Scene::parse(&scene).unwrap();
            let ready = scene.prepare(&|_| Err(String::new())).unwrap();
            Report::of(&ready, &trace(&ready, Shard::WHOLE, &|_| true))
        };
        let flat = "shape = \"flat\"";
        let smith = "shape = \"smith\"\nalpha_u = 0.1\nalpha_v = 0.1";
        let brewster = (1.0f64 / 1.5).atan().to_degrees();
        let (all, along_p) = ("[1.0, 0.0, 0.0, 0.0]", "[1.0, -1.0, 0.0, 0.0]");
        for method in ["split", "analog"] {
            for (n_top, theta, stokes, shape) in [
                (1.5, 60.0, all, flat),
                (1.0, 30.0, all, flat),
                (1.0, 30.0, all, smith),
                (1.5, brewster, along_p, flat),
            ] {
                let report = told(n_top, theta, stokes, method, shape);
                let unmet = report.notes.iter().any(|n| n.starts_with("no photon"));
                assert!(!unmet, "{n_top} {theta} {method}: {report:?}");
            }
        }
    }

    #[test]
    fn light_that_was_given_up_is_told_whatever_else_is() {
        let scene = "[light]\ntheta_i_deg = 60.0\n[[interface]]\nshape = \"beckmann\"\nalpha_u = 0.5\nalpha_v = 0.5\n\
                     cells = 32\nbelow = { n = 1.5 }\n[run]\nphotons = 4000\ninteractions_max = 1\n";
        let ready = Scene::parse(scene)
            .unwrap()
            .prepare(&|_| Err(String::new()))
            .unwrap();
        let totals = trace(&ready, Shard::WHOLE, &|_| true);
        let mut report = Report::of(&ready, &totals);
        let told = |report: &Report| report.notes.iter().any(|n| n.contains("was given up"));
        assert!(told(&report), "{report:?}");
        let one = report.energy.reflected;
        let between = super::super::spread::Between {
            value: one.value,
            std: one.std,
            std_by_sampling: one.std,
            std_between_surfaces: 0.0,
        };
        report.spread_over(Some(Surfaces {
            count: 2,
            reflected: between,
            transmitted: between,
            absorbed: between,
        }));
        assert!(told(&report) && report.notes.len() == 1, "{report:?}");
    }
}
