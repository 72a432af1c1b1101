//! Closed forms and the quadrature against 60-digit tables and against path-traced radiances.

use std::time::Instant;

use super::plan_check::{PlanCheck, PlanPart};
use super::{AccuracyEffort, AccuracyPoint};
use crate::cases::reference::{PRINTED_BRDF, ReferenceTable, directions_of, surface_of};
use crate::cases::{RECORDED_SERIES, RecordedSeries, RecordedTruth};
use crate::geometry::{Cones, Directions, Pose};
use crate::model::brdf::{self, Case};
use crate::model::prepared::OpticsTable;
use crate::model::quadrature::Quadrature;
use crate::model::{Optics, Variant, cone, radiance};
use crate::plan::{self, Decision, TOLERANCE};

pub(super) fn measure(effort: AccuracyEffort, points: &mut Vec<AccuracyPoint>) {
    printed(points);
    for series in RECORDED_SERIES {
        recorded(&series, effort, points);
    }
}

/// Seconds of one call, repeated until the clock resolves them.
fn seconds_of(mut call: impl FnMut()) -> f64 {
    let started = Instant::now();
    let mut calls = 0u32;
    while started.elapsed().as_secs_f64() < 0.02 || calls == 0 {
        call();
        calls += 1;
    }
    started.elapsed().as_secs_f64() / f64::from(calls)
}

fn printed(points: &mut Vec<AccuracyPoint>) {
    let table = ReferenceTable::read(PRINTED_BRDF);
    let rows = table.rows().map(|row| (row.case(), row.number("f")));
    // Relative errors need values that doubles can hold.
    let rows: Vec<(Case, f64)> = rows.filter(|(_, f)| *f > 1e-250).collect();
    let count = rows.len() as f64;
    let mut add = |method: &str, f: &dyn Fn(&Case) -> f64| {
        let seconds = seconds_of(|| {
            for (case, _) in &rows {
                std::hint::black_box(f(case));
            }
        });
        let mut errors: Vec<f64> = rows.iter().map(|(c, e)| (f(c) / e - 1.0).abs()).collect();
        errors.sort_by(f64::total_cmp);
        let at = |share: f64| errors[((share * count) as usize).min(errors.len() - 1)];
        for (name, error) in [("median", at(0.5)), ("99 % of cases", at(0.99))] {
            points.push(AccuracyPoint {
                scene: "printed BRDF".to_owned(),
                method: method.to_owned(),
                seconds: seconds / count,
                // No result is more exact than its rounding.
                error: error.max(f64::EPSILON / 4.0),
                quantity: format!("relative error of f, {name}"),
                reference: "60-digit arithmetic".to_owned(),
            });
        }
    };
    add("double-double", &|c| {
        brdf::evaluate(c).map_or(f64::NAN, |e| e.f)
    });
    add("doubles", &|c| {
        let (surface, optics) = surface_of(c);
        let d = directions_of(c);
        radiance(Variant::Paper, &d, &surface, &optics) / d.incident.z
    });
}

fn recorded(series: &RecordedSeries, effort: AccuracyEffort, points: &mut Vec<AccuracyPoint>) {
    let RecordedTruth {
        surface,
        optics,
        rows,
        ..
    } = series.truth();
    let peak = rows.iter().map(|r| r.2).fold(0.0, f64::max);
    let count = rows.len() as f64;
    let directions: Vec<Directions> = rows.iter().map(|r| r.1).collect();
    let mut add = |method: String, f: &dyn Fn() -> Vec<f64>| {
        let values = f();
        let seconds = seconds_of(|| {
            std::hint::black_box(f());
        });
        let squares: f64 = values
            .iter()
            .zip(&rows)
            .map(|(v, r)| ((v - r.2) / peak).powi(2))
            .sum();
        points.push(AccuracyPoint {
            scene: format!("series {}", series.name),
            method,
            seconds,
            error: (squares / count).sqrt(),
            quantity: "rms over all poses as a share of the peak".to_owned(),
            reference: "path tracer (Mitsuba 3.9.1), 0.1 % noise".to_owned(),
        });
    };
    let with_cones = |variant: Variant, cones: Cones| {
        let optics = Optics { cones, ..optics };
        let d = &directions;
        move || {
            d.iter()
                .map(|d| radiance(variant, d, &surface, &optics))
                .collect::<Vec<f64>>()
        }
    };
    add(
        "closed form, as printed".to_owned(),
        &with_cones(Variant::Paper, optics.cones),
    );
    add(
        "closed form, sawtooth, point lamp".to_owned(),
        &with_cones(Variant::Sawtooth, Cones::NONE),
    );
    add(
        "closed form, sawtooth".to_owned(),
        &with_cones(Variant::Sawtooth, optics.cones),
    );
    let tolerances: &[f64] = match effort {
        AccuracyEffort::Quick => &[1e-1, 1e-2, 1e-3],
        AccuracyEffort::Full => &[1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 1e-4, 1e-5],
    };
    for tolerance in tolerances {
        add("two-bounce quadrature".to_owned(), &|| {
            // The renderer of the reference ignores polarisation on plastic.
            Quadrature::new(&surface, &OpticsTable::new(&optics))
                .with_polarisation(optics.k > 0.0)
                .radiances(&directions, tolerance * peak)
                .iter()
                .map(|e| e.value)
                .collect()
        });
    }
}

/// Points per axis of the raster of pixels in a full computation: the fewest that show a trend over the field.
const RASTER: usize = 2;

/// Compares the plan of every series with a full computation: two bounces integrated for every node
/// of the lamp's disc and a raster of pixels, with polarisation.
pub(super) fn check_plans(effort: AccuracyEffort, checks: &mut Vec<PlanCheck>) {
    for series in &RECORDED_SERIES {
        checks.push(plan_check(series.name, &series.truth(), effort));
    }
}

fn plan_check(name: &str, truth: &RecordedTruth, effort: AccuracyEffort) -> PlanCheck {
    let poses: Vec<Pose> = truth.rows.iter().map(|r| r.0).collect();
    let planned_for = || plan::series::over(&truth.manifest, &poses, &[truth.surface], TOLERANCE);
    let plan = planned_for();
    // A quick run uses every sixth pose.
    let step = match effort {
        AccuracyEffort::Quick => 6,
        AccuracyEffort::Full => 1,
    };
    let directions: Vec<Directions> = truth.rows.iter().step_by(step).map(|r| r.1).collect();
    let peak = truth.rows.iter().map(|r| r.2).fold(0.0, f64::max);
    // The error of the reference is negligible beside the tolerance.
    let exactness = 0.01 * TOLERANCE * peak;
    let nodes = cone::nodes(
        &truth.optics.cones,
        truth.surface.alpha_u.min(truth.surface.alpha_v),
    );
    let compute = |cone: bool, polarised: bool, pixels: bool| -> Vec<f64> {
        let optics = Optics {
            cones: if cone {
                Cones::NONE
            } else {
                truth.optics.cones
            },
            ..truth.optics
        };
        let quadrature = Quadrature::new(&truth.surface, &OpticsTable::new(&optics))
            .with_polarisation(polarised);
        let times = if pixels { RASTER * RASTER } else { 1 };
        let each: &[cone::Node] = if cone { &nodes } else { &[cone::Node::CENTRE] };
        let all: Vec<Directions> = directions
            .iter()
            // Camera and lamp are distant, so all pixels have the same directions.
            .flat_map(|d| std::iter::repeat_n(*d, times))
            .flat_map(|d| each.iter().map(move |node| cone::moved(&d, node)))
            .collect();
        let per_view = each.len() * times;
        quadrature
            .radiances(&all, exactness)
            .chunks(per_view)
            .map(|c| {
                let weights = each.iter().map(|n| n.weight).cycle();
                c.iter().zip(weights).map(|(e, w)| e.value * w).sum::<f64>() / times as f64
            })
            .collect()
    };
    let wanted = |d: Decision| plan.on(d).is_none_or(|c| c.included);
    let planned_way = [
        wanted(Decision::ConeAverage),
        wanted(Decision::Polarisation),
        wanted(Decision::PerPixelGeometry),
    ];
    let full = compute(true, true, true);
    let planned = compute(planned_way[0], planned_way[1], planned_way[2]);
    let off = full
        .iter()
        .zip(&planned)
        .map(|(a, b)| (a - b).abs() / peak)
        .fold(0.0, f64::max);
    let seconds = |cone: bool, polarised: bool, pixels: bool| {
        seconds_of(|| {
            std::hint::black_box(compute(cone, polarised, pixels));
        })
    };
    let full_s = seconds(true, true, true);
    let parts = plan.left_out().map(|c| PlanPart {
        decision: c.decision,
        what: c.what.clone(),
        cost: c.cost,
        speed_up: match c.decision {
            Decision::ConeAverage => Some(full_s / seconds(false, true, true)),
            Decision::Polarisation => Some(full_s / seconds(true, false, true)),
            Decision::PerPixelGeometry => Some(full_s / seconds(true, true, false)),
            Decision::Bounces | Decision::Layers | Decision::CostlyTerms => None,
        },
    });
    let parts = parts.collect();
    let started = Instant::now();
    std::hint::black_box(planned_for());
    let planning_s = started.elapsed().as_secs_f64();
    let brightest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let allowed = TOLERANCE + exactness / peak;
    PlanCheck {
        scene: format!("series {name}"),
        quantity: "radiance of every pose over the brightest, largest difference".to_owned(),
        tolerance: TOLERANCE,
        full: [brightest(&full), exactness],
        planned: [brightest(&planned), exactness],
        off,
        allowed,
        holds: off <= allowed,
        full_s,
        planned_s: seconds(planned_way[0], planned_way[1], planned_way[2]) + planning_s,
        planning_s,
        parts,
    }
}
