//! Decides which terms a map omits within a tolerance: before any frame is read, on typical surfaces ([`plan`]), and
//! during the map, on the surfaces that represent most of its pixels.
//!
//! Without a stated tolerance nothing is omitted. The terms that can be omitted share the tolerance: double
//! reflections by integration, which take most of the time before the fit, come first; each pixel's own directions
//! get the remainder. Approximations that every map makes are listed with their error, whatever the tolerance.

use super::double_reflection::Integrated;
use super::field_variation::Anywhere;
use super::higher_order_terms::Costly;
use super::signals;
use super::signals::view::View;
use super::solve::kernel::{Geometry, Parameters};
use crate::geometry::Pose;
use crate::model::{Optics, Surface, left_out};
use crate::plan::series::{SURFACES, layers, polarisation};
use crate::plan::{Basis, ComputationPlan, Decision, PlanChoice, TOLERANCE};
use crate::reduction::FrameSource;
use crate::units::Angle;

/// Largest number of poses at which errors are evaluated before any frame is read.
const POSES_MAX: usize = 60;

/// Plans the map of a series before any frame is read. Without `target_error` nothing is omitted to save time.
#[must_use]
pub fn plan(source: &dyn FrameSource, target_error: Option<f64>) -> ComputationPlan {
    let manifest = source.manifest();
    let view = View::new(manifest);
    let material = manifest.material();
    let all = signals::poses(source);
    let every = all.len().div_ceil(POSES_MAX).max(1);
    let poses: Vec<Pose> = all.iter().step_by(every).map(|group| group.pose).collect();
    let centre = |pose: &Pose| view.central(*pose);
    let geometry: Vec<Geometry> = poses.iter().map(centre).collect();
    let costly = Costly::new(
        view.imaging.rig,
        material,
        poses,
        geometry,
        Integrated::default(),
    );
    let fifth = if costly.is_amplitude() { 1.0 } else { 0.35 };
    let surfaces = SURFACES.map(|(theta_r_deg, alpha)| {
        let theta_r = Angle::from_deg(theta_r_deg).rad();
        [theta_r, 0.0, alpha.ln(), alpha.ln(), fifth]
    });
    decide(&costly, &view, &surfaces, target_error)
}

/// Decides on given surfaces.
pub(super) fn decide(
    costly: &Costly,
    view: &View,
    surfaces: &[Parameters],
    target_error: Option<f64>,
) -> ComputationPlan {
    let tolerance = target_error.unwrap_or(TOLERANCE);
    let found: Vec<Surface> = surfaces.iter().map(|p| costly.surface(p)).collect();
    let Optics { eta, k, .. } = *costly.optics();
    let turned: Vec<Pose> = match surfaces.first() {
        Some(p) => costly.turned_poses(p).collect(),
        None => Vec::new(),
    };
    let double = double_reflections(costly, surfaces, target_error);
    let spent = if double.included { None } else { double.cost };
    let rest = target_error.map(|all| (all - spent.unwrap_or(0.0)).max(0.0));
    ComputationPlan {
        tolerance,
        quantity: "brightest radiance of a pixel".to_owned(),
        decisions: vec![
            polarisation(&view.imaging.rig, eta, k, &turned, &found, tolerance),
            double,
            layers(),
            cone(view, &found, tolerance),
            own_directions(costly, view, surfaces, rest),
            costly_terms(costly, surfaces),
        ],
        interactions_max: None,
        idle_interfaces: Vec::new(),
    }
}

/// Updates the plan after double reflections were integrated: they include polarisation, unless the pixels are
/// explained better without it.
pub(super) fn with_polarisation(mut plan: ComputationPlan, polarised: bool) -> ComputationPlan {
    let integrated = plan.on(Decision::Bounces).is_some_and(|c| c.included);
    let choice = plan
        .decisions
        .iter_mut()
        .find(|c| c.decision == Decision::Polarisation);
    if let Some(choice) = choice.filter(|_| integrated) {
        choice.included = polarised;
        choice.why = if polarised {
            "the first facet polarises the light that reaches the second one; integrated double reflections include it"
        } else {
            "the pixels are explained better without it, as those of a renderer without polarisation are"
        }
        .to_owned();
    }
    plan
}

/// Returns the largest of some costs; infinite if one is not a number.
fn largest(costs: impl Iterator<Item = f64>) -> f64 {
    costs.fold(0.0, |most, cost| {
        if cost.is_nan() {
            f64::INFINITY
        } else {
            f64::max(most, cost)
        }
    })
}

/// Makes a choice whose cost is an estimate.
fn choice(
    decision: Decision,
    what: &str,
    (included, why): (bool, &str),
    cost: Option<f64>,
) -> PlanChoice {
    PlanChoice {
        decision,
        included,
        what: what.to_owned(),
        why: why.to_owned(),
        cost,
        basis: Basis::Estimate,
    }
}

/// Decides on light reflected twice: integrated on the surfaces that represent most pixels, or the closed
/// approximation.
fn double_reflections(
    costly: &Costly,
    surfaces: &[Parameters],
    target_error: Option<f64>,
) -> PlanChoice {
    let cost = target_error.map(|_| largest(surfaces.iter().map(|p| costly.share_lacking(p))));
    let decided = match target_error.zip(cost) {
        None => (true, "no target error was stated"),
        Some((target, cost)) if cost <= target => (
            false,
            "on the surfaces that represent most pixels they change less than the target error",
        ),
        Some(_) => (
            true,
            "on the surfaces that represent most pixels they change more than the target error",
        ),
    };
    let what = "double reflections by integration";
    choice(Decision::Bounces, what, decided, cost)
}

/// States the closed correction of the lobes' widths, the only one that a map has; it takes no time.
fn cone(view: &View, surfaces: &[Surface], tolerance: f64) -> PlanChoice {
    let narrowest = surfaces
        .iter()
        .map(|s| s.alpha_u.min(s.alpha_v))
        .fold(f64::MAX, f64::min);
    let omitted = left_out::cone_average(&view.imaging.rig.cones, narrowest);
    let why = if omitted.cost.is_none_or(|cost| cost <= tolerance) {
        omitted.why
    } else {
        format!(
            "{}; maps do not average over the cones, fits do",
            omitted.why
        )
    };
    let points = view.imaging.rig.cones.reach() <= 0.0;
    PlanChoice {
        decision: Decision::ConeAverage,
        included: false,
        what: omitted.what,
        why,
        cost: omitted.cost,
        basis: if points {
            Basis::Exact
        } else {
            Basis::Estimate
        },
    }
}

/// Decides on the directions of each pixel if camera or lamp are near.
fn own_directions(
    costly: &Costly,
    view: &View,
    surfaces: &[Parameters],
    allowed: Option<f64>,
) -> PlanChoice {
    let cost = match view.is_telecentric() {
        true => 0.0,
        false => largest(
            surfaces
                .iter()
                .map(|p| off_centre(costly, view, p).followed),
        ),
    };
    let decided = match allowed {
        _ if view.is_telecentric() => (
            false,
            "camera and lamp are far: all pixels have the same directions",
        ),
        None => (
            true,
            "camera or lamp are near, and no target error was stated",
        ),
        Some(allowed) if cost <= allowed => (
            false,
            "camera or lamp are near, but over the field a reflection changes by less than the target error",
        ),
        Some(_) => (
            true,
            "camera or lamp are near: over the field a reflection changes by more than the target error",
        ),
    };
    let what = "each pixel's own directions";
    let estimate = choice(Decision::PerPixelGeometry, what, decided, Some(cost));
    PlanChoice {
        basis: match view.is_telecentric() {
            true => Basis::Exact,
            false => Basis::Estimate,
        },
        ..estimate
    }
}

/// Changes at the border of the field, as shares of the brightest radiance.
struct OffCentre {
    /// Change of the terms that use each pixel's directions: single reflections and the facets' diffuse light.
    followed: f64,
    /// Change of all other terms.
    rest: f64,
}

fn off_centre(costly: &Costly, view: &View, p: &Parameters) -> OffCentre {
    let anywhere = Anywhere::new(costly, view, p);
    let (width, height) = (view.width, view.height);
    let border = [
        0,
        width / 2,
        width - 1,
        height / 2 * width,
        (height / 2 + 1) * width - 1,
        (height - 1) * width,
        (height - 1) * width + width / 2,
        height * width - 1,
    ];
    let mut peak = f64::MIN_POSITIVE;
    let (mut off_followed, mut off_rest) = (0.0f64, 0.0f64);
    for pose in costly.poses() {
        let centre = anywhere.central(pose);
        peak = peak.max(centre.once + centre.diffuse + centre.rest);
        for pixel in border {
            let there = anywhere.light(pose, view.place_mm(pixel));
            let brought = anywhere.brought(&centre, &there);
            off_followed = off_followed
                .max((there.once - centre.once).abs())
                .max((brought - centre.diffuse).abs());
            off_rest = off_rest.max(anywhere.lacks(&centre, &there).abs());
        }
    }
    OffCentre {
        followed: off_followed / peak,
        rest: off_rest / peak,
    }
}

/// Returns the error of using the centre's directions for light reflected between the facets; see [`super::higher_order_terms`].
pub(super) fn centre_for_all(costly: &Costly, view: &View, surfaces: &[Parameters]) -> f64 {
    largest(surfaces.iter().map(|p| off_centre(costly, view, p).rest))
}

/// States the expansion of everything but single reflections. A plan does not decide how often it is recomputed: each
/// pixel's descent does so while it moves by a part of its own uncertainty.
fn costly_terms(costly: &Costly, surfaces: &[Parameters]) -> PlanChoice {
    let cost = largest(surfaces.iter().map(|p| costly.share_expanded(p)));
    let why = "all terms but single reflections are expanded about nearby surfaces, and recomputed while a pixel's descent \
               still moves";
    let what = "the whole closed form at every step of a pixel";
    choice(Decision::CostlyTerms, what, (false, why), Some(cost))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::higher_order_terms::near;
    use crate::series::Series;

    fn checker() -> Series {
        Series::open("tests/data/series/checker".as_ref()).unwrap()
    }

    #[test]
    fn without_a_target_nothing_is_omitted_and_with_one_the_omitted_terms_stay_within_it() {
        let series = checker();
        let all = plan(&series, None);
        assert!(all.on(Decision::Bounces).unwrap().included);
        for target in [1e-4, 3e-3, 0.5] {
            let plan = plan(&series, Some(target));
            assert_eq!(plan.decisions.len(), 6);
            let decided = [Decision::Bounces, Decision::PerPixelGeometry];
            let spent: f64 = decided
                .iter()
                .filter_map(|d| plan.on(*d).filter(|c| !c.included).and_then(|c| c.cost))
                .sum();
            assert!(spent <= target, "{spent} of {target}");
            let double = plan.on(Decision::Bounces).unwrap();
            assert_eq!(double.included, double.cost.unwrap() > target, "{double:?}");
        }
    }

    #[test]
    fn a_near_camera_keeps_its_pixels_directions_unless_the_field_is_small() {
        let decided = |field: f64, target: Option<f64>| {
            let board = near::board(field);
            let poses = vec![Pose::from_deg(-10.0, 0.0), Pose::from_deg(5.0, 40.0)];
            let costly = near::costly(&board, poses);
            let p = [0.2, 0.0, 0.1f64.ln(), 0.1f64.ln(), 0.3];
            let plan = decide(&costly, &board.1, &[p], target);
            let choice = plan.on(Decision::PerPixelGeometry).unwrap();
            (choice.included, choice.cost.unwrap())
        };
        let (wide, cost) = decided(50.0, Some(0.9e-2));
        assert!(wide && cost > 0.05, "{cost}");
        // A field a hundredth as wide changes angles a hundredth as much.
        let (narrow, less) = decided(0.5, Some(0.9));
        assert!(!narrow && less < 0.03 * cost, "{less} {cost}");
        assert!(decided(0.5, None).0);
    }

    #[test]
    fn light_transferred_from_the_centre_of_a_near_field_is_nearly_that_of_the_place() {
        let board = near::board(50.0);
        let costly = near::costly(&board, near::poses());
        for lean in [0.0, 1.9] {
            let p = [0.2, lean, 0.1f64.ln(), 0.15f64.ln(), 0.3];
            let off = off_centre(&costly, &board.1, &p);
            // Light reflected between the facets is a few percent of the peak. Half of it may change over a field that
            // spans a tenth of a radian to each side.
            assert!(off.followed > 0.1, "{}", off.followed);
            assert!(off.rest < 0.02, "{}", off.rest);
        }
    }
}
