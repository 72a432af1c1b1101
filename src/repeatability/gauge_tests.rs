//! Published examples, and studies with known components.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::*;
use crate::repeatability::anova::components;
use crate::repeatability::design::cells;

fn near(value: f64, published: f64, half_digit: f64) {
    assert!(
        (value - published).abs() <= half_digit,
        "{value} is not {published}"
    );
}

/// AIAG, *Measurement Systems Analysis Reference Manual*, 4th edition (2010), chapter III.B, gauge repeatability and
/// reproducibility data sheet: ten parts by three appraisers, three trials each.
const AIAG: [[[f64; 10]; 3]; 3] = [
    [
        [
            0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36,
        ],
        [
            0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25,
        ],
        [
            0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31,
        ],
    ],
    [
        [
            0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68,
        ],
        [
            0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62,
        ],
        [
            0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50,
        ],
    ],
    [
        [
            0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49,
        ],
        [
            -0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77,
        ],
        [
            -0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16,
        ],
    ],
];

fn aiag() -> (Vec<f64>, Vec<usize>, Vec<usize>) {
    let (mut values, mut parts, mut appraisers) = (Vec::new(), Vec::new(), Vec::new());
    for (appraiser, trials) in AIAG.iter().enumerate() {
        for trial in trials {
            for (part, value) in trial.iter().enumerate() {
                values.push(*value);
                parts.push(part);
                appraisers.push(appraiser);
            }
        }
    }
    (values, parts, appraisers)
}

#[test]
fn the_manual_of_the_aiag_has_the_same_result() {
    let (values, parts, appraisers) = aiag();
    let study = gauge(&values, &parts, Some((GroupedBy::Operator, &appraisers))).unwrap();
    assert_eq!(study.design, GaugeDesign::Crossed);
    assert!(study.balanced && study.interaction_pooled);
    // Table III-B 7: part, appraiser, and after pooling appraiser by part with equipment.
    for (row, (freedom, squares, mean)) in study.rows.iter().zip([
        (9, 88.3619, 9.81799),
        (2, 3.1673, 1.58363),
        (78, 0.3590 + 2.7589, 0.03997),
    ]) {
        assert_eq!(row.degrees_of_freedom, freedom);
        near(row.sum_of_squares, squares, 1e-4);
        near(row.mean_square, mean, 5e-6);
    }
    near(study.interaction_probability.unwrap(), 0.974, 5e-4);
    // Table III-B 8.
    let reproducibility = study.reproducibility.unwrap();
    let (parts, total) = (study.part_to_part.unwrap(), study.total.unwrap());
    for (spread, std, percent) in [
        (&study.repeatability, 0.199_933, 18.4),
        (&reproducibility, 0.226_838, 20.9),
        (&study.gauge, 0.302_373, 27.9),
        (&parts, 1.042_327, 96.0),
    ] {
        near(spread.std, std, 5e-6);
        near(spread.percent_of_total.unwrap(), percent, 0.05);
        let [low, high] = spread.interval.expect("three appraisers are enough");
        assert!(low < std && std < high, "{spread:?}");
    }
    near(total.std, 1.085, 5e-4);
    near(study.gauge_percent.unwrap().value, 27.9, 0.05);
    assert_eq!(study.distinct_categories.unwrap().value, 4.0);
    assert_eq!(study.repeatability.degrees_of_freedom, Some(78.0));
}

/// NIST/SEMATECH e-Handbook of Statistical Methods, 3.2.3.3: two-level nested analysis of variance of pin diameters, five
/// machines with a day and a night operator each, five pins.
#[test]
fn the_nested_example_of_nist_has_the_same_sums_of_squares() {
    let day = [
        [0.125, 0.127, 0.125, 0.126, 0.128],
        [0.118, 0.122, 0.120, 0.124, 0.119],
        [0.123, 0.125, 0.125, 0.124, 0.126],
        [0.126, 0.128, 0.126, 0.127, 0.129],
        [0.118, 0.129, 0.127, 0.120, 0.121],
    ];
    let night = [
        [0.124, 0.128, 0.127, 0.126, 0.129],
        [0.116, 0.125, 0.119, 0.125, 0.120],
        [0.122, 0.121, 0.124, 0.126, 0.125],
        [0.126, 0.129, 0.125, 0.130, 0.124],
        [0.125, 0.123, 0.114, 0.124, 0.117],
    ];
    let (mut values, mut machines, mut operators) = (Vec::new(), Vec::new(), Vec::new());
    for (shift, all) in [day, night].iter().enumerate() {
        for (machine, pins) in all.iter().enumerate() {
            for pin in pins {
                values.push(*pin);
                machines.push(machine);
                operators.push(2 * machine + shift);
            }
        }
    }
    let study = gauge(&values, &machines, Some((GroupedBy::Operator, &operators))).unwrap();
    assert_eq!(study.design, GaugeDesign::GroupsWithinParts);
    for (row, (freedom, squares)) in
        study
            .rows
            .iter()
            .zip([(4, 3.03e-4), (5, 1.86e-5), (40, 3.46e-4)])
    {
        assert_eq!(row.degrees_of_freedom, freedom);
        near(row.sum_of_squares, squares, 0.5e-6);
    }
    // The operators differ by less than the pins: no component of their own.
    assert_eq!(study.reproducibility.unwrap().std, 0.0);
}

#[test]
fn the_interval_of_one_mean_square_is_that_of_chi_square() {
    let (values, parts, appraisers) = aiag();
    let study = gauge(&values, &parts, Some((GroupedBy::Operator, &appraisers))).unwrap();
    let chi = ChiSquared::new(78.0).unwrap();
    let exact = |p: f64| study.repeatability.std * (78.0 / chi.inverse_cdf(p)).sqrt();
    let [low, high] = study.repeatability.interval.unwrap();
    near(low, exact(0.975), 0.01 * low);
    near(high, exact(0.025), 0.01 * high);
}

/// Components of the simulated studies.
const PART: f64 = 1.0;
const GROUP: f64 = 0.3;
const INTERACTION: f64 = 0.2;
const REPEAT: f64 = 0.25;

/// A study of `parts` by `groups`, of which every scan is kept for which `keep` is true.
fn simulated(
    seed: u64,
    (parts, groups, repeats): (usize, usize, usize),
    keep: impl Fn(usize, usize, usize) -> bool,
) -> (Vec<f64>, Vec<usize>, Vec<usize>) {
    let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
    let mut normal = |std: f64| std * random.sample::<f64, _>(StandardNormal);
    let of_parts: Vec<f64> = (0..parts).map(|_| normal(PART)).collect();
    let of_groups: Vec<f64> = (0..groups).map(|_| normal(GROUP)).collect();
    let mut data = (Vec::new(), Vec::new(), Vec::new());
    for (p, of_part) in of_parts.iter().enumerate() {
        for (g, of_group) in of_groups.iter().enumerate() {
            let interaction = normal(INTERACTION);
            for r in 0..repeats {
                let value = 10.0 + of_part + of_group + interaction + normal(REPEAT);
                if keep(p, g, r) {
                    data.0.push(value);
                    data.1.push(p);
                    data.2.push(g);
                }
            }
        }
    }
    data
}

/// Means of the components of variance without the limit at zero: part, group, interaction, repeat.
fn mean_components(size: (usize, usize, usize), keep: fn(usize, usize, usize) -> bool) -> [f64; 4] {
    const STUDIES: u64 = 400;
    let mut sums = [0.0; 4];
    for seed in 0..STUDIES {
        let (values, parts, groups) = simulated(seed, size, keep);
        let cells = cells(&parts, &groups);
        let found = shares(&values, &[parts, groups, cells]);
        for (sum, weights) in sums.iter_mut().zip(components(&found)) {
            let products = weights.iter().zip(&found).map(|(w, s)| w * s.mean_square());
            *sum += products.sum::<f64>() / STUDIES as f64;
        }
    }
    sums
}

#[test]
fn components_of_simulated_studies_are_unbiased_also_with_gaps() {
    let all: fn(usize, usize, usize) -> bool = |_, _, _| true;
    let gaps: fn(usize, usize, usize) -> bool = |p, g, r| (p + 2 * g + 3 * r) % 4 != 0;
    for keep in [all, gaps] {
        let [part, group, interaction, repeat] = mean_components((6, 4, 3), keep);
        // Three standard errors of the mean over the studies.
        near(part, PART * PART, 0.11);
        near(group, GROUP * GROUP, 0.017);
        near(interaction, INTERACTION * INTERACTION, 0.006);
        near(repeat, REPEAT * REPEAT, 0.0025);
    }
}

#[test]
fn intervals_of_simulated_studies_contain_the_truth_as_often_as_they_claim() {
    const STUDIES: u64 = 100;
    let truth = (GROUP * GROUP + INTERACTION * INTERACTION + REPEAT * REPEAT).sqrt();
    let percent = 100.0 * truth / truth.hypot(PART);
    let (mut of_gauge, mut of_percent) = (0, 0);
    for seed in 0..STUDIES {
        let (values, parts, groups) = simulated(seed, (8, 4, 2), |_, _, _| true);
        let study = gauge(&values, &parts, Some((GroupedBy::Day, &groups))).unwrap();
        let within = |[low, high]: [f64; 2], truth: f64| i32::from((low..=high).contains(&truth));
        of_gauge += within(study.gauge.interval.unwrap(), truth);
        of_percent += within(study.gauge_percent.unwrap().interval.unwrap(), percent);
    }
    // 95 of 100 are claimed; fewer than 88 has a probability of 0.2 %.
    assert!(
        of_gauge >= 88 && of_percent >= 88,
        "{of_gauge} {of_percent}"
    );
}

#[test]
fn too_few_groups_or_repeats_are_stated_in_words() {
    let (values, parts, groups) = simulated(1, (5, 2, 2), |_, _, _| true);
    let study = gauge(&values, &parts, Some((GroupedBy::Operator, &groups))).unwrap();
    let reproducibility = study.reproducibility.unwrap();
    assert_eq!(reproducibility.interval, None);
    let note = reproducibility.note.unwrap();
    assert!(note.starts_with("2 operators are too few"), "{note}");
    assert!(study.repeatability.interval.is_some());

    let once = gauge(&[1.0, 2.0, 3.0], &[0, 1, 2], None).unwrap_err();
    assert!(once.contains("at least two scans of a part"), "{once}");
    let alone = gauge(&[1.0, 2.0], &[0, 0], None).unwrap_err();
    assert!(alone.contains("several parts"), "{alone}");
}

#[test]
fn each_arrangement_of_parts_and_groups_has_its_design() {
    let design = |parts: &[usize], groups: &[usize]| {
        let values: Vec<f64> = (0..parts.len()).map(|i| (i * i % 7) as f64).collect();
        let study = gauge(&values, parts, Some((GroupedBy::Day, groups))).unwrap();
        (study.design, study.by, study.notes.len())
    };
    let day = Some(GroupedBy::Day);
    let within = [0, 0, 1, 1, 2, 2, 3, 3];
    assert_eq!(
        design(&within, &[0, 0, 0, 0, 1, 1, 1, 1]),
        (GaugeDesign::PartsWithinGroups, day, 0)
    );
    assert_eq!(
        design(&[0, 0, 0, 0, 1, 1, 1, 1], &within),
        (GaugeDesign::GroupsWithinParts, day, 0)
    );
    assert_eq!(design(&within, &within), (GaugeDesign::PartsOnly, None, 1));
    assert_eq!(design(&within, &[0; 8]), (GaugeDesign::PartsOnly, None, 1));
    assert_eq!(design(&[0; 8], &within), (GaugeDesign::GroupsOnly, day, 0));
    // Once per day: the interaction is part of the repeatability, and the study says so.
    assert_eq!(
        design(&[0, 0, 1, 1, 2, 2], &[0, 1, 0, 1, 0, 1]),
        (GaugeDesign::Crossed, day, 1)
    );
}

#[test]
fn one_scan_by_each_operator_is_not_called_one_scan_of_the_part() {
    let error = gauge(&[10.0, 10.1], &[0, 0], Some((GroupedBy::Operator, &[0, 1]))).unwrap_err();
    assert_eq!(
        error,
        "no part was measured twice by one operator: repeatability needs at least two scans of a part by one operator"
    );
}
