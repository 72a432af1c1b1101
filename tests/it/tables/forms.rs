//! Tables that state the same readings in other forms: each gives the same observations.

use nalgebra::Vector3;
use ridged::observation::ObservationSet;
use serde_json::json;

use super::bird::bird;
use super::{Angles, MANIFEST, observed};

/// Signals, and directions in the sample frame, to rounding.
fn same(a: &ObservationSet, b: &ObservationSet) {
    assert_eq!(a.observations.len(), b.observations.len());
    let placed = |set: &ObservationSet, i: usize| {
        let (s, c) = set.observations[i].pose.phi_s.sin_cos();
        let turn = |w: Vector3<f64>| Vector3::new(w.x * s - w.y * c, w.x * c + w.y * s, w.z);
        let view = &set.views[i][0];
        (
            turn(view.directions.incident),
            turn(view.directions.outgoing),
        )
    };
    for i in 0..a.observations.len() {
        let (x, y) = (a.observations[i], b.observations[i]);
        assert!(
            (x.signal - y.signal).abs() <= 1e-9 * x.signal.abs(),
            "{i}: {x:?} {y:?}"
        );
        assert!(
            (x.sigma - y.sigma).abs() <= 1e-9 * x.sigma,
            "{i}: {x:?} {y:?}"
        );
        let ((ai, ao), (bi, bo)) = (placed(a, i), placed(b, i));
        assert!((ai - bi).norm() < 1e-9 && (ao - bo).norm() < 1e-9, "{i}");
    }
}

#[test]
fn equivalent_forms_of_a_reading_give_the_same_observation() {
    let angles: [Angles; 3] = [
        [20.0, 30.0, 40.0, 200.0],
        [0.0, 0.0, 10.0, 90.0],
        [50.0, 270.0, 0.0, 15.0],
    ];
    let values = [0.7, 2.5, 0.1];
    let with_sigma = |of: &dyn Fn(&Angles, f64) -> (Angles, f64, f64), header: &str| {
        let mut text = format!("{header}\n");
        for (a, f) in angles.iter().zip(values) {
            let (a, f, s) = of(a, f);
            text += &format!("{},{},{},{},{f},{s}\n", a[0], a[1], a[2], a[3]);
        }
        text
    };
    let header = "theta_i,phi_i,theta_o,phi_o,value,sigma";
    let plain = with_sigma(&|a, f| (*a, f, 0.01 * f), header);
    let expected = observed(MANIFEST, &plain);
    // The convention itself: φ from u towards v.
    let (s, c) = expected.observations[1].pose.phi_s.sin_cos();
    let out = expected.views[1][0].directions.outgoing;
    assert!(
        (out.x * c + out.y * s - 10f64.to_radians().sin()).abs() < 1e-12,
        "towards v"
    );

    let cos = |deg: f64| deg.to_radians().cos();
    let factor = |of: &'static dyn Fn(&Angles) -> f64| {
        with_sigma(
            &move |a: &Angles, f| (*a, f * of(a), 0.01 * f * of(a)),
            header,
        )
    };
    for (value, table) in [
        ("radiance-factor", factor(&|_| std::f64::consts::PI)),
        ("cosine-corrected", factor(&|a| a[2].to_radians().cos())),
        ("radiance", factor(&|a| a[0].to_radians().cos())),
    ] {
        let manifest = MANIFEST.replace("value = \"brdf\"", &format!("value = \"{value}\""));
        same(&observed(&manifest, &table), &expected);
    }
    assert!((expected.observations[0].signal - 0.7 * cos(20.0)).abs() < 1e-12);

    // Azimuths from v, clockwise, with negative polar angles, in radians, from a German
    // spreadsheet.
    let from_v = with_sigma(
        &|a, f| ([a[0], a[1] - 90.0, a[2], a[3] - 90.0], f, 0.01 * f),
        header,
    );
    let key = |key: &str| MANIFEST.replace("[goniometer]", &format!("[goniometer]\n{key}"));
    same(&observed(&key("azimuth_of_v_deg = 0"), &from_v), &expected);
    let other_way = with_sigma(&|a, f| ([a[0], -a[1], a[2], -a[3]], f, 0.01 * f), header);
    let clockwise = key("azimuth_sense = \"clockwise\"\nazimuth_of_v_deg = -90");
    same(&observed(&clockwise, &other_way), &expected);
    let below = with_sigma(
        &|a, f| ([-a[0], a[1] + 180.0, -a[2], a[3] - 180.0], f, 0.01 * f),
        header,
    );
    same(&observed(MANIFEST, &below), &expected);
    let radians = with_sigma(
        &|a, f| (a.map(f64::to_radians), f, 0.01 * f),
        "theta_i [rad],phi_i [rad],theta_r [rad],phi_r [rad],BRDF [1/sr],std",
    );
    same(&observed(MANIFEST, &radians), &expected);
    let german = plain
        .replace(',', ";")
        .replace('.', ",")
        .replace('-', "\u{2212}");
    same(&observed(MANIFEST, &german), &expected);

    let column = |of: &dyn Fn(&Angles) -> f64| angles.iter().map(of).collect::<Vec<_>>();
    let bird = bird(
        [0, 1, 2, 3].map(|k| column(&|a| a[k].to_radians())),
        &values,
        &json!({"unit": "%", "values": [1.0, 1.0, 1.0]}),
    );
    let manifest = MANIFEST.replace("table.csv", "table.json");
    same(&observed(&manifest, &bird.to_string()), &expected);
}
