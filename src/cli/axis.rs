//! Ticks of a figure's axis: round numbers from zero up.

/// Returns the values 0, s, 2s … and their labels, where s is 1, 2 or 5 times a power of ten. The last value is the first
/// that reaches `max` (above 0), after about five steps.
pub(super) fn ticks(max: f64) -> Vec<(f64, String)> {
    let step = step(max);
    let decimals = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
    let last = (max / step * (1.0 - 1e-9)).ceil().max(1.0) as u32;
    (0..=last)
        .map(|n| {
            let value = step * f64::from(n);
            (value, format!("{value:.decimals$}"))
        })
        .collect()
}

/// Returns 1, 2 or 5 times a power of ten, so that three to five steps reach `max`.
fn step(max: f64) -> f64 {
    let raw = max / 5.0;
    let power = 10f64.powf(raw.log10().floor());
    let candidates = [1.0, 2.0, 5.0, 10.0].map(|m| m * power);
    let fits = candidates.into_iter().find(|step| *step >= raw * 0.999);
    fits.unwrap_or(max)
}

/// Formats a number for a figure, with a true minus sign.
pub(super) fn signed(text: &str) -> String {
    text.replace('-', "\u{2212}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_ends_at_a_round_number_that_holds_the_largest_value() {
        let labels = |max: f64| -> Vec<String> { ticks(max).into_iter().map(|t| t.1).collect() };
        assert_eq!(
            labels(0.206),
            ["0.00", "0.05", "0.10", "0.15", "0.20", "0.25"]
        );
        assert_eq!(labels(20.0), ["0", "5", "10", "15", "20"]);
        assert_eq!(labels(0.3), ["0.0", "0.1", "0.2", "0.3"]);
        for exponent in -9..9 {
            for mantissa in [1.0, 1.01, 1.99, 2.0, 3.3, 5.0, 7.7, 9.99] {
                let max = mantissa * 10f64.powi(exponent);
                let all = ticks(max);
                let (last, before) = (all[all.len() - 1].0, all[all.len() - 2].0);
                assert!((4..=7).contains(&all.len()), "{max}: {all:?}");
                assert!(last >= max * (1.0 - 1e-6) && before < max, "{max}: {all:?}");
            }
        }
    }
}
