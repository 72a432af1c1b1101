//! Control chart of individual values and moving ranges (I-MR) of one parameter over several scans.
//!
//! The scatter from one value to the next is s = mean moving range / d₂, with d₂ = 1.128 for ranges of two values. The
//! control limits are mean ± 3 s, and the limit of a moving range is D₄ = 3.267 times the mean range (NIST/SEMATECH
//! e-Handbook of Statistical Methods, 6.3.2.2; ISO 7870-2:2013). A signal is a value beyond the control limits (Western
//! Electric rule 1), or a run of at least eight values in a row on one side of the mean (6.3.2).

use serde::Serialize;

/// Mean range of two values divided by their standard deviation.
const D2: f64 = 1.128;
/// Upper limit of a range of two values divided by the mean range.
const D4: f64 = 3.267;
/// Values in a row on one side of the mean that are a signal.
pub const RUN_LENGTH: usize = 8;
/// Largest magnitude of a value: the sums of a chart stay finite.
const VALUE_MAX: f64 = 1e300;

/// The result that a point shows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct ChartedResult {
    /// Number of the scan.
    #[schema(minimum = 1)]
    pub scan_id: i64,
    /// Region of a part that has several.
    pub region: Option<String>,
    /// Number of the fit: the newest completed one.
    #[schema(minimum = 1)]
    pub fit_id: i64,
    /// Name of the part.
    pub part: String,
    /// Newest verdict: pass, fail or cannot-tell; null where the scan was not judged, or where the verdict judged other values
    /// than those of this fit.
    pub verdict: Option<String>,
    /// Number of that verdict.
    #[schema(minimum = 1)]
    pub verdict_id: Option<i64>,
    /// Name of the specification of that verdict.
    pub specification: Option<String>,
    /// When the scan was started or imported, RFC 3339 in UTC.
    pub created_at: String,
}

/// A value of the parameter with its uncertainty. All its numbers are finite.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartValue {
    of: ChartedResult,
    value: f64,
    std: f64,
    coverage_factor: f64,
}

impl ChartValue {
    /// Takes a value, its standard uncertainty in the same unit (k = 1) and the factor of its expanded uncertainty. `None` for a
    /// number that is not finite, an uncertainty below 0, or a factor that is not above 0.
    #[must_use]
    pub fn new(of: ChartedResult, value: f64, std: f64, coverage_factor: f64) -> Option<Self> {
        let is_finite = [value, std, coverage_factor, coverage_factor * std]
            .iter()
            .all(|x| x.abs() <= VALUE_MAX);
        (is_finite && std >= 0.0 && coverage_factor > 0.0).then_some(ChartValue {
            of,
            value,
            std,
            coverage_factor,
        })
    }
}

/// A point of the chart.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ChartPoint {
    /// Scan, fit and verdict.
    #[serde(flatten)]
    pub of: ChartedResult,
    /// Value, in the unit of the parameter's name.
    pub value: f64,
    /// Standard uncertainty u (k = 1), same unit.
    #[schema(minimum = 0)]
    pub std: f64,
    /// Expanded uncertainty U = k·u, same unit.
    #[schema(minimum = 0)]
    pub expanded: f64,
    /// k of the expanded uncertainty.
    #[schema(exclusive_minimum = 0)]
    pub coverage_factor: f64,
    /// Difference from the value before, without its sign; null for the first value.
    #[schema(minimum = 0)]
    pub moving_range: Option<f64>,
    /// Whether the value is beyond the control limits (Western Electric rule 1).
    pub beyond: bool,
    /// Whether the value is in a run on one side of the mean.
    pub in_run: bool,
    /// Whether the moving range is above its limit.
    pub range_beyond: bool,
}

/// Mean and control limits, in the unit of the parameter's name.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ControlLimits {
    /// Number of values.
    #[schema(minimum = 2, maximum = 1000)]
    pub n: usize,
    /// Mean of the values.
    pub mean: f64,
    /// Scatter from one value to the next: mean moving range / 1.128.
    #[schema(minimum = 0)]
    pub s: f64,
    /// Lower control limit: mean − 3 s.
    pub lower: f64,
    /// Upper control limit: mean + 3 s.
    pub upper: f64,
    /// Mean moving range.
    #[schema(minimum = 0)]
    pub mean_range: f64,
    /// Upper limit of a moving range: 3.267 times the mean moving range.
    #[schema(minimum = 0)]
    pub range_limit: f64,
}

/// Values in a row on one side of the mean, at least `run_length` of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct ChartRun {
    /// Place of the first value among the points, from 0.
    #[schema(maximum = 999)]
    pub first: usize,
    /// Place of the last value.
    #[schema(maximum = 999)]
    pub last: usize,
    /// Whether the values are above the mean.
    pub is_above: bool,
}

/// A control chart of individual values and moving ranges.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ControlChart {
    /// Mean and control limits; null with fewer than two values.
    pub limits: Option<ControlLimits>,
    /// Values in their order, oldest first.
    #[schema(max_items = 1000)]
    pub points: Vec<ChartPoint>,
    /// Runs on one side of the mean, oldest first.
    pub runs: Vec<ChartRun>,
    /// Least number of values of a run.
    #[schema(minimum = 8, maximum = 8)]
    pub run_length: usize,
}

/// Computes the chart of values in their order, oldest first.
#[must_use]
pub fn chart(values: Vec<ChartValue>) -> ControlChart {
    let numbers: Vec<f64> = values.iter().map(|v| v.value).collect();
    let limits = control_limits(&numbers);
    let runs = limits.map_or_else(Vec::new, |limits| runs(&numbers, limits.mean));
    let points = values.into_iter().enumerate().map(|(at, known)| {
        let ChartValue {
            of,
            value,
            std,
            coverage_factor,
        } = known;
        let moving_range = at
            .checked_sub(1)
            .map(|before| (value - numbers[before]).abs());
        ChartPoint {
            of,
            value,
            std,
            expanded: coverage_factor * std,
            coverage_factor,
            moving_range,
            beyond: limits.is_some_and(|l| value < l.lower || value > l.upper),
            in_run: runs.iter().any(|run| (run.first..=run.last).contains(&at)),
            range_beyond: limits
                .zip(moving_range)
                .is_some_and(|(limits, range)| range > limits.range_limit),
        }
    });
    ControlChart {
        points: points.collect(),
        limits,
        runs,
        run_length: RUN_LENGTH,
    }
}

/// Returns the limits of values; `None` with fewer than two.
fn control_limits(values: &[f64]) -> Option<ControlLimits> {
    let (first, n) = (*values.first()?, values.len());
    if n < 2 {
        return None;
    }
    // From the first value on: the mean of equal values is exactly that value, so that none is beyond limits of no width.
    let mean = first + values.iter().map(|x| x - first).sum::<f64>() / n as f64;
    let ranges = values.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let mean_range = ranges.sum::<f64>() / (n - 1) as f64;
    let s = mean_range / D2;
    Some(ControlLimits {
        n,
        mean,
        s,
        lower: mean - 3.0 * s,
        upper: mean + 3.0 * s,
        mean_range,
        range_limit: D4 * mean_range,
    })
}

/// Returns the runs on one side of a mean. A value on the mean is on neither side and ends a run.
fn runs(values: &[f64], mean: f64) -> Vec<ChartRun> {
    let side = |value: &f64| value.partial_cmp(&mean);
    let mut runs = Vec::new();
    let mut first = 0;
    for row in values.chunk_by(|a, b| side(a) == side(b)) {
        let is_on_mean = row.first().is_none_or(|value| *value == mean);
        if !is_on_mean && row.len() >= RUN_LENGTH {
            runs.push(ChartRun {
                first,
                last: first + row.len() - 1,
                is_above: row[0] > mean,
            });
        }
        first += row.len();
    }
    runs
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Flow rates of ten batches: NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2.
    const FLOW: [f64; 10] = [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1];

    pub(crate) fn result(scan_id: i64) -> ChartedResult {
        ChartedResult {
            scan_id,
            region: None,
            fit_id: scan_id,
            part: "B-17".to_owned(),
            verdict: None,
            verdict_id: None,
            specification: None,
            created_at: "2026-03-01T09:00:00.000Z".to_owned(),
        }
    }

    /// The chart of values with u = 0.1.
    pub(crate) fn chart_of(values: &[f64]) -> ControlChart {
        let values = values.iter().zip(1..);
        let values = values.map(|(value, id)| ChartValue::new(result(id), *value, 0.1, 2.5));
        chart(values.collect::<Option<_>>().unwrap())
    }

    fn close(value: f64, expected: f64, within: f64) {
        assert!(
            (value - expected).abs() <= within,
            "{value}, not {expected}"
        );
    }

    fn rows(runs: &[ChartRun]) -> Vec<(usize, usize, bool)> {
        runs.iter().map(|r| (r.first, r.last, r.is_above)).collect()
    }

    #[test]
    fn the_limits_are_those_of_the_published_example() {
        let found = chart_of(&FLOW);
        let limits = found.limits.unwrap();
        assert_eq!(limits.n, 10);
        close(limits.mean, 50.81, 1e-9);
        close(limits.mean_range, 1.8778, 5e-5);
        close(limits.s, 1.8778 / 1.128, 5e-5);
        close(limits.upper, 55.8041, 1e-4);
        close(limits.lower, 45.8159, 1e-4);
        close(limits.range_limit, 3.267 * 1.8778, 2e-4);
        let ranges: Vec<f64> = found.points.iter().filter_map(|p| p.moving_range).collect();
        for (range, expected) in ranges
            .iter()
            .zip([2.0, 2.3, 1.4, 3.5, 3.4, 1.4, 0.2, 1.2, 1.5])
        {
            close(*range, expected, 1e-9);
        }
        assert_eq!((ranges.len(), found.points[0].moving_range), (9, None));
        let has_signal = |p: &ChartPoint| p.beyond || p.in_run || p.range_beyond;
        assert!(!found.points.iter().any(has_signal), "{found:?}");
        let first = &found.points[0];
        assert_eq!(
            (first.std, first.coverage_factor, first.expanded),
            (0.1, 2.5, 0.25)
        );
    }

    #[test]
    fn a_value_beyond_the_limits_is_marked_with_its_ranges() {
        let mut values = [10.0, 10.02].repeat(10);
        values[9] = 10.5;
        let found = chart_of(&values);
        let marked = |is: fn(&ChartPoint) -> bool| {
            let marked = found.points.iter().filter(|p| is(p));
            marked.map(|p| p.of.scan_id).collect::<Vec<_>>()
        };
        assert_eq!(marked(|p| p.beyond), [10]);
        assert_eq!(marked(|p| p.range_beyond), [10, 11]);
        values[9] = 9.5;
        assert!(chart_of(&values).points[9].beyond);
    }

    #[test]
    fn eight_in_a_row_on_one_side_are_a_run_and_a_value_on_the_mean_ends_it() {
        let of = |parts: &[(usize, f64)]| -> Vec<f64> {
            let parts = parts.iter().map(|(n, value)| vec![*value; *n]);
            parts.collect::<Vec<_>>().concat()
        };
        let found = |parts: &[(usize, f64)]| rows(&runs(&of(parts), 0.0));
        assert!(found(&[(7, 1.0)]).is_empty());
        assert_eq!(found(&[(1, -1.0), (8, 1.0), (1, -1.0)]), [(1, 8, true)]);
        assert!(found(&[(5, 1.0), (1, 0.0), (5, 1.0)]).is_empty());
        let both = found(&[(9, 1.0), (8, -1.0)]);
        assert_eq!(both, [(0, 8, true), (9, 16, false)]);
        assert!(found(&[(9, 0.0)]).is_empty() && found(&[]).is_empty());
        // The mean is between the two groups.
        let chart = chart_of(&of(&[(8, 10.0), (3, 11.0)]));
        assert_eq!(rows(&chart.runs), [(0, 7, false)]);
        let in_run: Vec<bool> = chart.points.iter().map(|p| p.in_run).collect();
        assert_eq!(in_run, [[true; 8].as_slice(), &[false; 3]].concat());
    }

    #[test]
    fn equal_values_have_limits_of_no_width_and_no_signal() {
        // 0.1 + 0.1 + 0.1 is not 3 · 0.1.
        for value in [10.0, 0.1, 1e300, -7.3] {
            let found = chart_of(&[value; 19]);
            let limits = found.limits.unwrap();
            assert_eq!((limits.mean, limits.s), (value, 0.0));
            assert_eq!((limits.lower, limits.upper), (value, value));
            assert!(found.runs.is_empty());
            assert!(!found.points.iter().any(|p| p.beyond || p.range_beyond));
        }
    }

    #[test]
    fn fewer_than_two_values_have_no_limits() {
        assert_eq!(chart_of(&[]).limits, None);
        let one = chart_of(&[10.0]);
        assert_eq!((one.limits, one.points.len()), (None, 1));
        assert!(!one.points[0].beyond && one.points[0].moving_range.is_none());
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let taken = |value, std, k| ChartValue::new(result(1), value, std, k).is_some();
        assert!(taken(10.0, 0.0, 2.0));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX] {
            assert!(!taken(bad, 0.1, 2.0) && !taken(10.0, bad, 2.0) && !taken(10.0, 0.1, bad));
        }
        assert!(!taken(10.0, -0.1, 2.0) && !taken(10.0, 0.1, 0.0) && !taken(10.0, 0.1, -2.0));
        // The sums of the largest values are finite.
        let largest = chart_of(&[1e300, -1e300].repeat(500)).limits.unwrap();
        for x in [
            largest.mean,
            largest.upper,
            largest.lower,
            largest.range_limit,
        ] {
            assert!(x.is_finite(), "{largest:?}");
        }
    }
}
