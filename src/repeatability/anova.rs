//! Analysis of variance with random factors, for balanced and unbalanced data.
//!
//! Each factor takes from the sum of squares what the factors before it leave (sequential sums of squares). The expected
//! mean squares follow from the projections themselves: E[yᵀQy] = Σ σᵢ² tr(Zᵢᵀ Q Zᵢ) + σ² tr(Q), where Zᵢ are the
//! indicators of the levels of factor i. Solving them gives unbiased components of variance for every design
//! (Searle, Casella and McCulloch, *Variance Components*, 1992, chapter 5); for balanced data these are the textbook
//! ones.
//!
//! *Conditioning.* The columns are indicators. They are orthogonalised twice, so that the basis is orthogonal to
//! rounding; a column of which less than 1e-6 remains is a combination of those before it.

/// What remains of a column that is not a combination of the others, at least.
const REMAINS_MIN: f64 = 1e-6;

/// The share of one factor, or of the rest, in the sum of squares.
#[derive(Debug, Clone, PartialEq)]
pub struct Share {
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Sum of squares.
    pub sum_of_squares: f64,
    /// Expected mean square: factors of the variance of each factor, and last of the rest.
    pub expected: Vec<f64>,
}

impl Share {
    /// Returns the mean square; 0 without degrees of freedom.
    #[must_use]
    pub fn mean_square(&self) -> f64 {
        match self.degrees_of_freedom {
            0 => 0.0,
            n => self.sum_of_squares / n as f64,
        }
    }
}

/// Returns the shares of the factors in their order, and last of the rest. Each factor has the level of every value.
#[must_use]
pub fn shares(values: &[f64], factors: &[Vec<usize>]) -> Vec<Share> {
    let n = values.len();
    let mut basis = vec![vec![1.0 / (n as f64).sqrt(); n]];
    let mut all = Vec::new();
    for levels in factors {
        let first = basis.len();
        for level in 0..levels.iter().max().map_or(0, |last| last + 1) {
            let column = levels.iter().map(|l| f64::from(u8::from(*l == level)));
            let column: Vec<f64> = column.collect();
            let length = dot(&column, &column).sqrt();
            let rest = without(&basis, &without(&basis, &column));
            let remains = dot(&rest, &rest).sqrt();
            if remains > REMAINS_MIN * length {
                basis.push(rest.iter().map(|x| x / remains).collect());
            }
        }
        let own = &basis[first..];
        let df = own.len();
        let mut expected: Vec<f64> = factors
            .iter()
            .map(|other| trace(own, other) / df.max(1) as f64)
            .collect();
        expected.push(1.0);
        all.push(Share {
            degrees_of_freedom: df,
            sum_of_squares: own.iter().map(|q| dot(q, values).powi(2)).sum(),
            expected,
        });
    }
    let rest = without(&basis, &without(&basis, values));
    let mut expected = vec![0.0; factors.len()];
    expected.push(1.0);
    all.push(Share {
        degrees_of_freedom: n - basis.len(),
        sum_of_squares: dot(&rest, &rest),
        expected,
    });
    all
}

/// Returns for each component of variance the weights of the mean squares whose sum it is; the last one is that of the
/// rest.
///
/// # Panics
/// If a factor has no degrees of freedom of its own.
#[must_use]
pub fn components(shares: &[Share]) -> Vec<Vec<f64>> {
    let n = shares.len();
    let mut weights = vec![vec![0.0; n]; n];
    for i in (0..n).rev() {
        assert!(
            shares[i].degrees_of_freedom > 0,
            "the factor has no effect of its own"
        );
        let mut own = vec![0.0; n];
        own[i] = 1.0;
        for (later, of_later) in weights.iter().enumerate().skip(i + 1) {
            for (sum, weight) in own.iter_mut().zip(of_later) {
                *sum -= shares[i].expected[later] * weight;
            }
        }
        let factor = shares[i].expected[i];
        weights[i] = own.into_iter().map(|weight| weight / factor).collect();
    }
    weights
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// What the basis leaves of a column.
fn without(basis: &[Vec<f64>], column: &[f64]) -> Vec<f64> {
    let mut rest = column.to_vec();
    for q in basis {
        let along = dot(q, &rest);
        for (x, y) in rest.iter_mut().zip(q) {
            *x -= along * y;
        }
    }
    rest
}

/// tr(Zᵀ Q Z) for the projection on these columns and the indicators of these levels.
fn trace(columns: &[Vec<f64>], levels: &[usize]) -> f64 {
    let mut sum = 0.0;
    for column in columns {
        let mut of_level = vec![0.0; levels.iter().max().map_or(0, |last| last + 1)];
        for (x, level) in column.iter().zip(levels) {
            of_level[*level] += x;
        }
        sum += of_level.iter().map(|x| x * x).sum::<f64>();
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} is not {b}");
    }

    #[test]
    fn one_way_with_unequal_groups_has_the_known_expected_mean_square() {
        // n0 = (N − Σ nᵢ² / N) / (a − 1), Searle, Casella and McCulloch (1992), 3.6.
        let levels = vec![0, 0, 0, 0, 1, 1, 2];
        let values = [1.0, 2.0, 3.0, 2.0, 5.0, 6.0, 4.0];
        let found = shares(&values, &[levels]);
        assert_eq!(
            (found[0].degrees_of_freedom, found[1].degrees_of_freedom),
            (2, 4)
        );
        close(found[0].expected[0], (7.0 - 21.0 / 7.0) / 2.0);
        close(found[1].sum_of_squares, 2.0 + 0.5);
        let total: f64 = found.iter().map(|share| share.sum_of_squares).sum();
        let mean = values.iter().sum::<f64>() / 7.0;
        close(total, values.iter().map(|v| (v - mean).powi(2)).sum());
        let weights = components(&found);
        close(weights[0][0], 0.5);
        close(weights[0][1], -0.5);
    }

    #[test]
    fn a_combination_of_earlier_columns_takes_nothing() {
        let same = vec![0, 0, 1, 1];
        let found = shares(&[1.0, 2.0, 3.0, 5.0], &[same.clone(), same]);
        let freedom: Vec<usize> = found.iter().map(|s| s.degrees_of_freedom).collect();
        assert_eq!(freedom, [1, 0, 2]);
        assert_eq!(found[1].mean_square(), 0.0);
    }
}
