//! Tests of axes, layout and drawing.

use super::*;

fn labels(axis: &PlotAxis) -> Vec<&str> {
    axis.ticks.iter().map(|t| t.1.as_str()).collect()
}

#[test]
fn an_axis_from_zero_ends_at_a_round_number_that_holds_the_largest_value() {
    let axis = PlotAxis::from_zero("", 0.206);
    assert_eq!(
        labels(&axis),
        ["0.00", "0.05", "0.10", "0.15", "0.20", "0.25"]
    );
    let axis = PlotAxis::from_zero("", 20.0);
    assert_eq!(labels(&axis), ["0", "5", "10", "15", "20"]);
    let axis = PlotAxis::from_zero("", 0.3);
    assert_eq!(labels(&axis), ["0.0", "0.1", "0.2", "0.3"]);
    for exponent in -9..9 {
        for mantissa in [1.0, 1.01, 1.99, 2.0, 3.3, 5.0, 7.7, 9.99] {
            let max = mantissa * 10f64.powi(exponent);
            let axis = PlotAxis::from_zero("", max);
            let before = axis.ticks[axis.ticks.len() - 2].0;
            assert!((4..=7).contains(&axis.ticks.len()), "{max}: {axis:?}");
            assert!(axis.high >= max * (1.0 - 1e-6) && before < max, "{max}");
        }
    }
}

#[test]
fn a_logarithmic_axis_holds_its_values_between_round_ends_and_labels_few_of_them() {
    for (low, high) in [(0.03, 0.04), (1e-5, 0.9), (1e-16, 1.0), (3.0, 3.0)] {
        let axis = PlotAxis::logarithmic("", [low, high, 0.0, f64::NAN].into_iter());
        assert!(
            (2..=14).contains(&axis.ticks.len()),
            "{low} {high}: {axis:?}"
        );
        assert!(axis.fraction(low) > 0.0 && axis.fraction(high) < 1.0);
        for (value, _) in &axis.ticks {
            assert!((-1e-6..=1.0 + 1e-6).contains(&axis.fraction(*value)));
        }
    }
    let axis = PlotAxis::logarithmic("", [0.015, 0.4].into_iter());
    assert!(labels(&axis).contains(&"0.02"), "{axis:?}");
    let axis = PlotAxis::logarithmic("", [6e-7, 2e-6].into_iter());
    assert!(labels(&axis).contains(&"10⁻⁶"), "{axis:?}");
    assert!(labels(&axis).contains(&"5·10⁻⁷"), "{axis:?}");
    assert_eq!(power_of_ten(-12.0), "10⁻¹²");
}

fn panel(y: &PlotAxis, points: Vec<(f64, f64)>) -> Panel {
    let marks = vec![Mark::Points(points, Symbol::Dot)];
    Panel {
        title: "a < b".to_owned(),
        x: PlotAxis::from_zero("x / mm", 10.0),
        y: y.clone(),
        series: vec![DataSeries::numbered(0, "R & D", marks)],
        ..Panel::default()
    }
}

#[test]
fn neighbours_with_equal_axes_share_their_labels() {
    let y = PlotAxis::from_zero("y / mm", 1.0);
    let other = PlotAxis::from_zero("z / mm", 1.0);
    let figure = |second: &PlotAxis| Figure {
        columns: 2,
        panel_px: (200, 100),
        panels: [&y, second, &y, second]
            .map(|y| panel(y, vec![(5.0, 0.5)]))
            .to_vec(),
        ..Figure::default()
    };
    let count = |svg: &str, label: &str| svg.matches(&format!(">\n{label}\n<")).count();
    let shared = figure(&y).svg();
    assert_eq!(count(&shared, "y / mm"), 2, "one per row");
    assert_eq!(count(&shared, "x / mm"), 2, "one per column");
    let own = figure(&other).svg();
    assert_eq!((count(&own, "y / mm"), count(&own, "z / mm")), (2, 2));
}

#[test]
fn a_value_that_is_infinite_or_far_outside_leaves_the_figure_whole() {
    let y = PlotAxis::from_zero("y", 1.0);
    let points = vec![
        (5.0, 0.5),
        (f64::NAN, 0.5),
        (5.0, f64::INFINITY),
        (1e300, -1e300),
    ];
    let figure = Figure {
        title: "words ".repeat(60),
        panel_px: (200, 100),
        legend: Legend::Above,
        panels: vec![panel(&y, points)],
        ..Figure::default()
    };
    let svg = figure.svg();
    let document = roxmltree::Document::parse(&svg).expect("well-formed XML");
    let number = |node: &roxmltree::Node, name| -> f64 {
        let text = node.attribute(name).expect("the attribute");
        text.parse().expect("a number")
    };
    let circles = document.descendants().filter(|n| n.has_tag_name("circle"));
    let places: Vec<(f64, f64)> = circles
        .map(|n| (number(&n, "cx"), number(&n, "cy")))
        .collect();
    // Two points, each on its white ground.
    assert_eq!(places.len(), 4, "{places:?}");
    let (width, height) = (
        number(&document.root_element(), "width"),
        number(&document.root_element(), "height"),
    );
    for (x, y) in places {
        assert!((0.0..10.0 * width).contains(&x) && (0.0..10.0 * height).contains(&y));
    }
}

#[test]
fn an_empty_figure_is_drawn_without_panels() {
    let svg = Figure::default().svg();
    assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"));
}
