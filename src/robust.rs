//! Medians and robust spreads, with their values for normal scatter, and the χ² that normal scatter rarely exceeds.

/// Median of |x| for normal x of standard deviation 1; its quartiles are at this distance from 0.
pub const MEDIAN_OF_ABS: f64 = 0.674_489_750_196_081_7;
/// Median of x², that is, of χ² with one degree of freedom.
pub const MEDIAN_OF_SQUARE: f64 = MEDIAN_OF_ABS * MEDIAN_OF_ABS;
/// Ratio of standard deviation to median absolute deviation for normal scatter.
pub const STD_PER_DEVIATION: f64 = 1.0 / MEDIAN_OF_ABS;

/// Median of the values (the mean of the two middle ones for an even number); `None` if there are
/// none. A NaN counts as the largest. Reorders `values`.
#[must_use]
pub fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let n = values.len();
    let (below, at, _) = values.select_nth_unstable_by(n / 2, f64::total_cmp);
    let upper = *at;
    if n % 2 == 1 {
        return Some(upper);
    }
    let lower = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Some(0.5 * (lower + upper))
}

/// Returns the median of the finite values; `None` if there are none.
#[must_use]
pub fn median_of_finite(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|x| x.is_finite()).collect();
    median(&mut values)
}

/// Median, and standard deviation from the median absolute deviation; `None` if there are no
/// values. Reorders `values`.
#[must_use]
pub fn spread(values: &mut [f64]) -> Option<(f64, f64)> {
    let centre = median(values)?;
    let mut away: Vec<f64> = values.iter().map(|x| (x - centre).abs()).collect();
    Some((centre, STD_PER_DEVIATION * median(&mut away)?))
}

/// Returns the χ² per degree of freedom that normal scatter exceeds as rarely as a normal variable exceeds `quantile`
/// (Wilson and Hilferty 1931).
#[must_use]
pub fn reduced_chi2_at(freedom: f64, quantile: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    (1.0 - spread + quantile * spread.sqrt()).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outlier_does_not_move_the_median() {
        assert_eq!(median(&mut [3.0, 1.0, 1e9]), Some(3.0));
        assert_eq!(median(&mut [2.0, 1.0, 1.5, 9.0]), Some(1.75));
        assert_eq!(median(&mut [4.0, 1.0, 2.0, 1e9]), Some(3.0));
        assert_eq!(median(&mut [f64::INFINITY, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut []), None);
    }

    #[test]
    fn the_spread_of_normal_scatter_is_its_standard_deviation() {
        let (centre, std) = spread(&mut [1.0, 2.0, 3.0, 4.0, 1e9]).unwrap();
        assert!((centre - 3.0).abs() < 1e-12 && (std - STD_PER_DEVIATION).abs() < 1e-12);
        assert!((STD_PER_DEVIATION - 1.4826).abs() < 1e-5);
        assert!((MEDIAN_OF_SQUARE - 0.454_936).abs() < 1e-6);
    }
}
