//! Budgets beside profiles, bootstraps and propagated distributions, and what a budget leaves out.

use super::*;

#[test]
fn where_the_model_is_linear_profile_and_bootstrap_agree_with_the_budget() {
    let set = series(5);
    let asked = FitOptions {
        profile: true,
        bootstrap: 200,
        ..options()
    };
    let report = fit_without_higher_order(&set, &asked, &AtomicBool::new(false));
    let p = &report.parameters.theta_r_deg;
    let (value, budget) = (p.value.expect("known"), p.budget.expect("known"));
    let half = 2.0 * budget.counting.hypot(budget.background);
    let profile = p.profile.expect("asked for");
    let (lower, upper) = (
        profile.lower.expect("closed"),
        profile.upper.expect("closed"),
    );
    assert!(
        ((value - lower) / half - 1.0).abs() < 0.1,
        "{lower} {value} {half}"
    );
    assert!(
        ((upper - value) / half - 1.0).abs() < 0.1,
        "{upper} {value} {half}"
    );
    let drawn = p.bootstrap.expect("asked for");
    let width = drawn.upper.expect("closed") - drawn.lower.expect("closed");
    // The ends of 95.45 % of 200 draws scatter by 9 % of the half width each; three times that.
    assert!((width / (2.0 * half) - 1.0).abs() < 0.2, "{width} {half}");
}

#[test]
fn the_budget_agrees_with_propagated_distributions() {
    // JCGM 101: draw every source from its distribution, fit, and compare the spread.
    let mut set = series(6);
    for o in &mut set.observations {
        o.shared = SharedErrors {
            white_reference: 0.005 / 0.99 * o.signal,
            led_drift: 0.002 * o.signal,
            detector: 0.0,
            theta_c_zero: Angle::from_deg(0.02),
            phi_s_zero: Angle::from_deg(0.03),
        };
    }
    let e = run(&set, &options());
    let report = report_of(&e, VariantName::Sawtooth);
    let u = uncertainty(&e);
    let mut draw = Draw::new(7);
    const DRAWS: usize = 300;
    let mut sums = vec![[0.0; 2]; e.problem.free().len()];
    let clean = e.problem.predicted(&e.values);
    for _ in 0..DRAWS {
        let mut drawn = set.clone();
        let gain = 1.0 + 0.005 / 0.99 * draw.normal() + 0.002 * draw.normal();
        let tilt = Angle::from_deg(0.02 * draw.normal());
        let turn = Angle::from_deg(0.03 * draw.normal());
        let (scale, aside) = (
            Angle::from_deg(0.02 * draw.normal()),
            [(); 2].map(|()| Angle::from_deg(0.03 * draw.normal())),
        );
        let tilts = || set.observations.iter().map(|o| o.pose.theta_c.deg());
        let (low, high) = (
            tilts().fold(f64::INFINITY, f64::min),
            tilts().fold(f64::NEG_INFINITY, f64::max),
        );
        for (o, c) in drawn.observations.iter_mut().zip(&clean) {
            o.signal =
                gain * (c - e.values.background) + e.values.background + o.sigma * draw.normal();
            let (along, (sin, cos)) = (
                (2.0 * o.pose.theta_c.deg() - low - high) / (high - low),
                o.pose.phi_s.sin_cos(),
            );
            o.pose.theta_c += tilt + scale * along;
            o.pose.phi_s += turn + aside[0] * sin + aside[1] * cos;
        }
        drawn.background.mean = e.values.background + set.background.std * draw.normal();
        let free = e.problem.free().to_vec();
        let p = Problem::new(&drawn, Variant::Sawtooth, free, e.values);
        let never = AtomicBool::new(false);
        let m = p.descend(&e.minimum.parameters, &Settings::DEFAULT, &never);
        assert!(m.ending.is_success());
        for (sum, (x, best)) in sums
            .iter_mut()
            .zip(m.parameters.iter().zip(&e.minimum.parameters))
        {
            let d = x - best;
            sum[0] += d;
            sum[1] += d * d;
        }
    }
    for (j, q) in e.problem.free().iter().enumerate() {
        if *q == Quantity::Background {
            // Its budget adds the certificate that defines its scale.
            continue;
        }
        let n = DRAWS as f64;
        let spread = ((sums[j][1] - sums[j][0] * sums[j][0] / n) / (n - 1.0)).sqrt();
        let stated = u.budgets[j].combined();
        // The spread of 300 draws is known to 4 %; four times that.
        assert!(
            (spread / stated - 1.0).abs() < 0.16,
            "{q:?}: {spread} drawn, {stated} stated"
        );
    }
    for (name, p) in report.parameters.named() {
        let k = p.std.map(|_| coverage_factor(p.degrees_of_freedom));
        assert_eq!(p.coverage_factor, k, "{name}");
    }
}

#[test]
fn a_retraced_descent_ends_at_the_minimum_and_a_bootstrap_past_the_time_limit_draws_nothing() {
    let set = series(4);
    let cancel = AtomicBool::new(false);
    let ticks = std::sync::atomic::AtomicU32::new(0);
    // A clock that advances by a second at each reading.
    let now = || f64::from(ticks.fetch_add(1, std::sync::atomic::Ordering::Relaxed));
    let time = Time {
        now: &now,
        limit_s: Some(0.0),
        retrace: true,
    };
    let tracer = Tracer {
        time: Some(time),
        ..Tracer::PLAIN
    };
    let options = FitOptions {
        bootstrap: 50,
        ..options()
    };
    let report = fit_with_tracer(&set, &options, None, &tracer, &cancel);
    let (first, last) = (
        report.iterations.first().unwrap(),
        report.iterations.last().unwrap(),
    );
    assert!(
        report
            .iterations
            .windows(2)
            .all(|w| w[0].seconds < w[1].seconds)
    );
    // The start is many standard uncertainties away, the last accepted step none.
    assert!(first.error > 1.0 && last.error < 1e-6, "{first:?} {last:?}");
    assert!(
        last.cost < 0.1 * first.cost && last.gradient < 1e-6,
        "{last:?}"
    );
    assert!(report.parameters.theta_r_deg.bootstrap.is_none());
    assert!(
        report
            .warnings
            .iter()
            .any(|w| w.contains("within the time"))
    );
}

#[test]
fn a_stated_wedge_is_in_the_budget_and_an_unstated_one_is_listed_as_left_out() {
    let bare = series(5);
    let stated = ObservationSet {
        wedge_std: Some(Angle::from_deg(0.1)),
        ..bare.clone()
    };
    let [without, with] = [&bare, &stated]
        .map(|set| fit_without_higher_order(set, &options(), &AtomicBool::new(false)));
    let listed = |r: &crate::fit::FitReport| r.left_out.iter().any(|l| l.what.contains("wedge"));
    assert!(listed(&without) && !listed(&with));
    assert_eq!(without.reference_plane, ReferencePlane::Turntable);
    assert_eq!(with.reference_plane, ReferencePlane::Sample);
    // The uncertainty of the azimuth itself excludes the wedge.
    let of = |r: &crate::fit::FitReport| r.wedge_across.unwrap().azimuth_std_deg;
    assert!((of(&with) / of(&without) - 1.0).abs() < 1e-9);
    let text = |r: &crate::fit::FitReport| {
        crate::fit::report::text::table(r, &crate::fit::report::text::Form::PLAIN)
    };
    assert!(text(&without).contains("refer to the turntable"));
    assert!(text(&with).contains("refer to the plane of the sample"));
    let line = |p: &crate::fit::report::Parameter| p.budget.unwrap().wedge;
    let p = &with.parameters;
    assert!((line(&p.theta_r_deg) - 0.1).abs() < 1e-12);
    let theta_r = p.theta_r_deg.value.unwrap().to_radians();
    assert!((line(&p.azimuth_offset_deg) - 0.1 / theta_r.tan()).abs() < 1e-9);
    assert_eq!(line(&p.alpha_u), 0.0);
    let (wide, narrow) = (
        p.theta_r_deg.std.unwrap(),
        without.parameters.theta_r_deg.std.unwrap(),
    );
    assert!((wide - narrow.hypot(0.1)).abs() < 1e-9, "{wide} {narrow}");
}

#[test]
fn a_stated_lamp_angle_error_is_in_the_budget_and_an_unstated_one_is_listed_as_left_out() {
    let fitted =
        |set: &ObservationSet| fit_without_higher_order(set, &options(), &AtomicBool::new(false));
    let bare = series(5);
    let std = 0.2;
    let stated = ObservationSet {
        theta_l_std: Some(Angle::from_deg(std)),
        ..bare.clone()
    };
    let [without, with] = [&bare, &stated].map(fitted);
    let listed = |r: &crate::fit::FitReport| {
        r.left_out
            .iter()
            .any(|l| l.what.contains("lamp and camera"))
    };
    assert!(listed(&without) && !listed(&with));
    // The line of the budget equals the result of a fit to the same signals with the lamp moved.
    let moved = fitted(&bare.with_lamp_moved(Angle::from_deg(std)));
    let parameters = |r: &crate::fit::FitReport| {
        let p = &r.parameters;
        [&p.theta_r_deg, &p.azimuth_offset_deg, &p.tilt_offset_deg].map(Clone::clone)
    };
    let all = parameters(&without).into_iter().zip(parameters(&with));
    for ((before, after), elsewhere) in all.zip(parameters(&moved)) {
        let line = |p: &crate::fit::report::Parameter| p.budget.unwrap().angles;
        let added = (line(&after).powi(2) - line(&before).powi(2))
            .max(0.0)
            .sqrt();
        let shift = (elsewhere.value.unwrap() - before.value.unwrap()).abs();
        assert!((added - shift).abs() < 0.02 * std, "{added} {shift}");
    }
    let tilt = |r: &crate::fit::FitReport| r.parameters.tilt_offset_deg.value.unwrap();
    assert!(((tilt(&moved) - tilt(&without)).abs() - 0.5 * std).abs() < 0.05 * std);
}
