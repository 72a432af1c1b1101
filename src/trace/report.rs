//! The report of a run: the output of `ridged trace --json` and of `/traces`.

use serde::{Deserialize, Serialize, Serializer};

use super::counting::tally::{Energies, MonteCarloEstimate, ORDERS, Totals};
use super::photons::interface::Interface;
use super::scene::{LeftOut, PreparedScene, RidgeAngle};
use super::surface_spread::Surfaces;
use crate::wording::{percent, significant};

/// Energies, errors and effects left out.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = TraceResult)]
pub struct TraceReport {
    /// Photons launched.
    pub photons: u64,
    /// Duration of the run, s, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Part of `seconds` spent on the photons, set-up included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run_seconds: Option<f64>,
    /// Part of `run_seconds` before the first photon: finding the illuminated parts and the
    /// analytic part of the result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub setup_seconds: Option<f64>,
    /// Time before `seconds` spent building or reading the surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface_seconds: Option<f64>,
    /// Whether polarisation was followed.
    pub polarised: bool,
    /// Fractions of the light.
    pub energy: Energy,
    /// Relative error of the reflected bins, root mean square ([`Totals::relative_error`]).
    pub relative_error: Option<f64>,
    /// Number of independent replicates behind the standard errors.
    pub batches: u64,
    /// Effective ridge angles of the interfaces that have one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ridge_angles: Vec<RidgeAngle>,
    /// Other realisations of the surfaces, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surfaces: Option<Surfaces>,
    /// Scope and limits of the standard errors.
    pub notes: Vec<String>,
    /// Effects left out, with reason and cost.
    pub left_out: Vec<LeftOut>,
    /// Program and version.
    pub program: String,
}

/// Fractions of the light; the first four sum to 1.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = TraceEnergy)]
pub struct Energy {
    /// Reflected to the upper side.
    pub reflected: MonteCarloEstimate,
    /// Transmitted through the last interface.
    pub transmitted: MonteCarloEstimate,
    /// Absorbed by metals, layers and diffuse bodies.
    pub absorbed: MonteCarloEstimate,
    /// Given up.
    pub truncated: MonteCarloEstimate,
    /// R1, R2, … and T1, T2, …: by number of interactions.
    #[serde(serialize_with = "as_map")]
    #[schema(value_type = std::collections::BTreeMap<String, MonteCarloEstimate>)]
    pub by_interactions: Vec<(String, MonteCarloEstimate)>,
}

fn as_map<S: Serializer>(
    list: &[(String, MonteCarloEstimate)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_map(list.iter().map(|(name, x)| (name, x)))
}

/// Facts about the scene in a report. The files of shards contain them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct About {
    /// Effects left out.
    pub left_out: Vec<LeftOut>,
    /// Effective ridge angles of the interfaces that have one.
    pub ridge_angles: Vec<RidgeAngle>,
    /// Whether a surface is random.
    pub is_drawn: bool,
    /// Whether light can leave on the lower side.
    #[serde(default)]
    pub is_open_below: bool,
    /// Whether all media are equal, so that nothing is reflected.
    #[serde(default)]
    pub is_clear: bool,
}

impl About {
    /// Takes the facts from a prepared scene.
    #[must_use]
    pub fn of(prepared: &PreparedScene) -> Self {
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

/// Least fraction of light given up that is reported.
const MUCH_TRUNCATED: f64 = 1e-3;

/// Notes on the standard errors.
fn notes(totals: &Totals, e: &Energies<MonteCarloEstimate>) -> Vec<String> {
    let all = [&e.reflected_all, &e.transmitted_all, &e.absorbed];
    let mut notes = Vec::new();
    if totals.batches() < 2 {
        notes.push("a single replicate gives no error: trace more photons".to_owned());
    } else if all.iter().all(|x| x.std == 0.0) && e.truncated.value < MUCH_TRUNCATED {
        notes.push(
            "the result is exact: the surface determines all directions of the light, so the standard errors \
             are 0 except for rounding"
                .to_owned(),
        );
    }
    notes.extend(given_up(e.truncated.value));
    notes
}

/// If no photon was of a kind, its fraction is below this over the number of photons, with a
/// probability of 95 %.
const UNMET: f64 = 3.0;

/// Explains what an outcome without photons implies.
fn unmet(photons: u64, what: &str, other: &str) -> String {
    format!(
        "no photon of {photons} was {what}: up to {} of the light may be, and the error of the {other} light is at least \
         as large; trace more photons to find it",
        significant(UNMET / photons.max(1) as f64)
    )
}

/// Relative error below which the result counts as exact: rounding errors are at most 4e-9.
const DECIDED: f64 = 1e-7;

/// Reflectances below this are rounding errors.
const NOTHING: f64 = 1e-30;

/// Whether the result is random: tested on the light by interactions, because the sum is exact if
/// all light goes the same way, even if others were possible.
fn is_chance(energy: &Energy) -> bool {
    let mut all = energy.by_interactions.iter();
    all.any(|(_, x)| x.std > DECIDED * x.value)
}

/// A note on light that was given up, if it is significant.
fn given_up(share: f64) -> Option<String> {
    (share > MUCH_TRUNCATED).then(|| {
        format!(
            "{} of the light was given up (after run.interactions_max interactions, or almost parallel to \
             the surface): every other fraction may be too small by as much",
            percent(share)
        )
    })
}

impl TraceReport {
    /// Adds the results of several realisations, or a note that only the first was traced in time.
    pub fn spread_over(&mut self, surfaces: Option<Surfaces>) {
        if surfaces.is_some() {
            // The errors over realisations need no warning, but light given up does.
            self.notes = given_up(self.energy.truncated.value).into_iter().collect();
        } else {
            let none = "no other surface was traced within the time limit: allow more seconds or trace fewer photons";
            self.notes.push(none.to_owned());
        }
        self.surfaces = surfaces;
    }

    /// Makes a report of the counted light; the caller fills in times and facts about the scene.
    #[must_use]
    pub fn new(totals: &Totals, polarised: bool) -> Self {
        let e: Energies<MonteCarloEstimate> = totals.energies();
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
        TraceReport {
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

    /// Makes a report of a run of a scene.
    #[must_use]
    pub fn of(prepared: &PreparedScene, totals: &Totals) -> Self {
        TraceReport::new(totals, prepared.polarised).about(About::of(prepared))
    }

    /// Adds facts about the scene.
    #[must_use]
    pub fn about(mut self, scene: About) -> Self {
        if scene.is_drawn {
            self.notes.push(
                "the errors are those of the photons on this one surface; trace several surfaces to see how far others of the \
                 same statistics differ"
                    .to_owned(),
            );
        }
        let (up, down) = (self.energy.reflected, self.energy.transmitted);
        let is_chance = is_chance(&self.energy);
        // Equal media, Brewster's angle and total reflection leave no outcome to be missed.
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
    fn an_outcome_without_photons_is_noted_as_possible() {
        let report_of = |below: &str| {
            let scene = format!(
                "[[interface]]\nshape = \"smith\"\nalpha_u = 5.0\nalpha_v = 5.0\nbelow = {below}\n\
                 [run]\nphotons = 60\nseed = 3\n[light]\ntheta_i_deg = 0.0\n"
            );
            let ready = Scene::parse(&scene)
                .unwrap()
                .prepare(&|_| Err(String::new()))
                .unwrap();
            let totals = trace(&ready, Shard::WHOLE, &|_| true);
            let report = TraceReport::of(&ready, &totals);
            let unmet = report.notes.iter().any(|n| n.starts_with("no photon"));
            (unmet, report.energy)
        };
        let (unmet, energy) = report_of("{ n = 1.5 }");
        assert_eq!(unmet, energy.reflected.value == 0.0, "{energy:?}");
        assert!(unmet);
        // No light leaves below a metal.
        assert!(!report_of("{ n = 0.2, k = 3.0 }").0);
    }

    #[test]
    fn an_outcome_that_the_boundary_excludes_is_not_noted() {
        let report_of = |n_top: f64, theta_i_deg: f64, stokes: &str, method: &str, shape: &str| {
            let scene = format!(
                "n_top = {n_top:?}\n[light]\ntheta_i_deg = {theta_i_deg:?}\nstokes = {stokes}\n[[interface]]\n{shape}\n\
                 below = {{ n = 1.0 }}\n[run]\nphotons = 1000\nmethod = \"{method}\"\n"
            );
            let scene = Scene::parse(&scene).unwrap();
            let ready = scene.prepare(&|_| Err(String::new())).unwrap();
            TraceReport::of(&ready, &trace(&ready, Shard::WHOLE, &|_| true))
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
                let report = report_of(n_top, theta, stokes, method, shape);
                let unmet = report.notes.iter().any(|n| n.starts_with("no photon"));
                assert!(!unmet, "{n_top} {theta} {method}: {report:?}");
            }
        }
    }

    #[test]
    fn light_that_was_given_up_is_always_noted() {
        let scene = "[light]\ntheta_i_deg = 60.0\n[[interface]]\nshape = \"beckmann\"\nalpha_u = 0.5\nalpha_v = 0.5\n\
                     cells = 32\nbelow = { n = 1.5 }\n[run]\nphotons = 4000\ninteractions_max = 1\n";
        let ready = Scene::parse(scene)
            .unwrap()
            .prepare(&|_| Err(String::new()))
            .unwrap();
        let totals = trace(&ready, Shard::WHOLE, &|_| true);
        let mut report = TraceReport::of(&ready, &totals);
        let has_note =
            |report: &TraceReport| report.notes.iter().any(|n| n.contains("was given up"));
        assert!(has_note(&report), "{report:?}");
        let one = report.energy.reflected;
        let between = super::super::surface_spread::Between {
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
        assert!(has_note(&report) && report.notes.len() == 1, "{report:?}");
    }
}
