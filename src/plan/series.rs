//! The plan of a recorded series, before a frame is read.
//!
//! The surface of the sample is not known yet, so costs are bounds or estimates over typical
//! surfaces: ridges of 5 to 20°, lobes of α 0.05 to 0.2.

use super::{Basis, ComputationPlan, Decision, PlanChoice};
use crate::frame::FrameKind;
use crate::geometry::{Cones, Directions, Pose, RigGeometry};
use crate::model::fresnel::reflectances;
use crate::model::left_out::POLARISATION;
use crate::model::{Optics, Surface, Variant, cone as cubature, radiance};
use crate::series::{FrameRow, Manifest};

/// Typical surfaces, over which costs are maximised: (θr in degrees, α).
pub(crate) const SURFACES: [(f64, f64); 4] = [(5.0, 0.05), (10.0, 0.12), (15.0, 0.06), (20.0, 0.2)];

/// Plans the fit of a series before a frame is read; `tolerance` is relative to the brightest radiance.
#[must_use]
pub fn plan(manifest: &Manifest, rows: &[FrameRow], tolerance: f64) -> ComputationPlan {
    let mut poses: Vec<Pose> = rows
        .iter()
        .filter(|r| r.kind == FrameKind::Sample)
        .map(FrameRow::pose)
        .collect();
    poses.dedup();
    let metal = manifest.material().index().1 > 0.0;
    let surfaces = SURFACES.map(|(theta_r_deg, alpha)| Surface {
        theta_r: theta_r_deg.to_radians(),
        alpha_u: alpha,
        alpha_v: alpha,
        rho_d: if metal { 0.0 } else { 0.35 },
        amplitude: 1.0,
    });
    let mut plan = over(manifest, &poses, &surfaces, tolerance);
    let of_surfaces = |d| matches!(d, Decision::Polarisation | Decision::ConeAverage);
    for choice in &mut plan.decisions {
        // The polarisation of a metal is always part of the model.
        if of_surfaces(choice.decision) && !choice.included && choice.cost.is_some_and(|c| c > 0.0)
        {
            choice.why.push_str(
                "; the cost is the largest over typical surfaces (ridges of 5° to 20°, α 0.05 to 0.2); \
                 a fit reports that of the fitted surface",
            );
        }
    }
    plan
}

/// Plans a fit at the given poses, with the largest costs over the given surfaces: the typical ones, or the fitted one.
#[must_use]
pub fn over(
    manifest: &Manifest,
    poses: &[Pose],
    surfaces: &[Surface],
    tolerance: f64,
) -> ComputationPlan {
    let rig = manifest.rig_geometry();
    let (eta, k) = manifest.material().index();
    ComputationPlan {
        tolerance,
        quantity: "brightest radiance of the series".to_owned(),
        decisions: vec![
            polarisation(&rig, eta, k, poses, surfaces, tolerance),
            bounces(k),
            layers(),
            cone(&rig, eta, k, poses, surfaces, tolerance),
            pixels(manifest),
        ],
        interactions_max: None,
        idle_interfaces: Vec::new(),
    }
}

/// Decides about layers over the surface.
pub(crate) fn layers() -> PlanChoice {
    PlanChoice {
        decision: Decision::Layers,
        included: false,
        what: "layers over the sample's surface".to_owned(),
        why: "the manifest describes one boundary".to_owned(),
        cost: Some(0.0),
        basis: Basis::Exact,
    }
}

/// Decides about polarisation. Lamp and camera do not polarise, so a single reflection does not depend on it. It changes
/// double reflections, because the first reflection polarises the light of the second.
pub(crate) fn polarisation(
    rig: &RigGeometry,
    eta: f64,
    k: f64,
    poses: &[Pose],
    surfaces: &[Surface],
    tolerance: f64,
) -> PlanChoice {
    let mut choice = PlanChoice {
        decision: Decision::Polarisation,
        included: k > 0.0,
        what: "polarisation between the first and the second bounce".to_owned(),
        why: String::new(),
        cost: None,
        basis: Basis::Bound,
    };
    if k > 0.0 {
        // ½(R_s² + R_p²) against F² at 45°, the mean angle in the right-angled valley.
        let (s, p) = reflectances(std::f64::consts::FRAC_1_SQRT_2, eta, k);
        let f = 0.5 * (s + p);
        let more = 0.5 * (s * s + p * p) / (f * f) - 1.0;
        choice.why = format!(
            "it makes doubly reflected light on metal about {:.1} % brighter; in some poses this is the only light",
            100.0 * more
        );
        choice.cost = Some(more);
        choice.basis = Basis::Estimate;
        return choice;
    }
    // The closed form follows polarisation for any positive k.
    let mut cost = 0.0f64;
    for surface in surfaces {
        let (mut peak, mut off) = (0.0f64, 0.0f64);
        for d in some(poses).map(|p| rig.directions(p)) {
            let at = |k: f64| {
                let optics = Optics {
                    eta,
                    k,
                    theta_l: rig.theta_l.rad(),
                    cones: Cones::NONE,
                };
                radiance(Variant::Sawtooth, &d, surface, &optics)
            };
            let (with, without) = (at(1e-9), at(0.0));
            peak = peak.max(without);
            off = off.max((with - without).abs());
        }
        cost = cost.max(off / peak.max(f64::MIN_POSITIVE));
    }
    choice.included = cost > tolerance;
    choice.why = if choice.included {
        "the first facet polarises the light that the second reflects; the integrated second bounce of a \
         fit includes it"
    } else {
        "single reflections do not depend on it (lamp and camera do not polarise) and double reflections are weak"
    }
    .to_owned();
    choice.what = POLARISATION.to_owned();
    choice.cost = Some(cost);
    choice.basis = Basis::Estimate;
    choice
}

/// At most 60 of the poses.
fn some(poses: &[Pose]) -> impl Iterator<Item = Pose> {
    poses
        .iter()
        .step_by(poses.len().div_ceil(60).max(1))
        .copied()
}

fn bounces(k: f64) -> PlanChoice {
    let (what, why) = if k > 0.0 {
        (
            "bounces beyond the third",
            "the closed form has two bounces; the quadrature computes them exactly and adds a third",
        )
    } else {
        (
            "specular bounces beyond the second",
            "the closed form has two bounces and all orders of diffuse exchange",
        )
    };
    // Each further bounce in the valley has at most F times the light of the one before; on plastic F is 5 %.
    PlanChoice {
        decision: Decision::Bounces,
        included: false,
        what: what.to_owned(),
        why: why.to_owned(),
        cost: Some(3e-4),
        basis: Basis::Estimate,
    }
}

/// Decides about the average over the cones of lamp and lens, by comparing it with the closed correction of the lobes'
/// widths.
fn cone(
    rig: &RigGeometry,
    eta: f64,
    k: f64,
    poses: &[Pose],
    surfaces: &[Surface],
    tolerance: f64,
) -> PlanChoice {
    let (lamp, lens) = (rig.cones.lamp.rad() > 0.0, rig.cones.lens.rad() > 0.0);
    let whose = match (lamp, lens) {
        (true, true) => "the cones of lamp and lens",
        (false, true) => "the lens's cone",
        _ => "the lamp's cone",
    };
    let mut choice = PlanChoice {
        decision: Decision::ConeAverage,
        included: false,
        what: format!("average over {whose}"),
        why: "lamp and lens are points".to_owned(),
        cost: Some(0.0),
        basis: Basis::Exact,
    };
    if !lamp && !lens {
        return choice;
    }
    let (mut closed, mut point) = (0.0f64, 0.0f64);
    for surface in surfaces {
        let (c, p) = cone_costs(rig, eta, k, poses, surface);
        (closed, point) = (closed.max(c), point.max(p));
    }
    choice.basis = Basis::Estimate;
    let percent = |x: f64| format!("{:.3} %", 100.0 * x);
    if closed <= tolerance {
        choice.cost = Some(closed);
        choice.why = format!(
            "the closed correction of the lobes' widths (α² + (Rl² + Rc²)/8) is within {} of it (without a correction: {})",
            percent(closed),
            percent(point)
        );
    } else {
        choice.included = true;
        choice.cost = None;
        choice.why = format!(
            "the closed correction of the lobes' widths (α² + (Rl² + Rc²)/8) would be wrong by {}; a fit adds the \
             cubature over {whose} with its higher-order correction",
            percent(closed)
        );
    }
    choice
}

/// Largest differences from the average over the cones, relative to the brightest radiance: with the closed
/// correction, and with points for lamp and lens. At most 60 poses are used.
fn cone_costs(
    rig: &RigGeometry,
    eta: f64,
    k: f64,
    poses: &[Pose],
    surface: &Surface,
) -> (f64, f64) {
    let optics = |cones: Cones| Optics {
        eta,
        k,
        theta_l: rig.theta_l.rad(),
        cones,
    };
    let (wide, points) = (optics(rig.cones), optics(Cones::NONE));
    let at = |d: &Directions, optics: &Optics| radiance(Variant::Sawtooth, d, surface, optics);
    let nodes = cubature::nodes(&rig.cones, surface.alpha_u.min(surface.alpha_v));
    let (mut peak, mut closed, mut point) = (0.0f64, 0.0f64, 0.0f64);
    for d in some(poses).map(|p| rig.directions(p)) {
        let mean: f64 = nodes
            .iter()
            .map(|node| node.weight * at(&cubature::moved(&d, node), &points))
            .sum();
        peak = peak.max(mean);
        closed = closed.max((at(&d, &wide) - mean).abs());
        point = point.max((at(&d, &points) - mean).abs());
    }
    let per_peak = 1.0 / peak.max(f64::MIN_POSITIVE);
    (closed * per_peak, point * per_peak)
}

fn pixels(manifest: &Manifest) -> PlanChoice {
    let far = manifest.is_telecentric();
    PlanChoice {
        decision: Decision::PerPixelGeometry,
        included: !far,
        what: "directions of single pixels".to_owned(),
        why: if far {
            "camera and lamp are distant; all pixels have the same directions".to_owned()
        } else {
            "camera or lamp are near; directions change over the field".to_owned()
        },
        cost: far.then_some(0.0),
        basis: Basis::Exact,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::Series;

    fn planned(name: &str) -> ComputationPlan {
        let folder = std::path::Path::new("tests/data/series").join(name);
        let series = Series::open(&folder).unwrap();
        plan(series.manifest(), series.rows(), 0.01)
    }

    #[test]
    fn plastic_goes_without_polarisation_and_steel_does_not() {
        let plastic = planned("polymer-10");
        assert!(!plastic.on(Decision::Polarisation).unwrap().included);
        assert!(
            planned("steel-15")
                .on(Decision::Polarisation)
                .unwrap()
                .included
        );
    }

    #[test]
    fn the_closed_correction_costs_a_tenth_of_a_point_lamp() {
        // A lobe of α = 0.05 under a lamp of 1° in radius: a few tenths of a percent of its peak.
        let rig = RigGeometry::IN_PLANE;
        let poses: Vec<Pose> = (0..9)
            .map(|t| Pose::from_deg(-20.0 + 5.0 * f64::from(t), 0.0))
            .collect();
        let surface = Surface {
            theta_r: 5f64.to_radians(),
            alpha_u: 0.05,
            alpha_v: 0.05,
            rho_d: 0.35,
            amplitude: 1.0,
        };
        let (closed, point) = cone_costs(&rig, 1.54, 0.0, &poses, &surface);
        assert!(
            closed < 1e-3 && point > 2e-3 && closed < 0.2 * point,
            "{closed} {point}"
        );
    }

    #[test]
    fn what_costs_more_than_the_tolerance_is_in() {
        for name in ["polymer-10", "steel-15", "paper-rig-full", "checker"] {
            let plan = planned(name);
            assert_eq!(plan.decisions.len(), 5);
            for choice in plan.left_out() {
                let cheap = choice.cost.is_some_and(|x| x <= plan.tolerance);
                assert!(cheap, "{name} {choice:?}");
            }
        }
    }
}
