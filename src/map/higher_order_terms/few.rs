//! The observations that are used far from the minimum.

/// Least number of observations used far from the minimum.
pub(super) const FEW_MIN: usize = 36;
/// Least number of observations from which a subset of them is used far from the minimum.
pub(super) const MANY_MIN: usize = 2 * FEW_MIN;
/// Of very many observations, one in this number is used far from the minimum.
const FEW_SHARE: usize = 4;

/// Selects the subset of `count` observations used far from the minimum; empty if all are used.
///
/// Steps of the golden section leave no row of tilts and no row of azimuths empty, whatever the rows' length.
pub(super) fn few_of(count: usize) -> Vec<usize> {
    if count < MANY_MIN {
        return Vec::new();
    }
    let share = FEW_MIN.max(count / FEW_SHARE) as f64 / count as f64;
    let section = 0.5 * (5.0_f64.sqrt() - 1.0);
    (0..count)
        .filter(|j| (section * *j as f64).fract() < share)
        .collect()
}
