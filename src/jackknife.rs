//! The change of an estimate when whole tilts, azimuths or scans are left out.
//!
//! The model error is smooth over the poses, so it is correlated within a tilt or an azimuth. Residuals taken as
//! independent would understate its effect. A jackknife over groups includes the correlation. Call [`by_groups`]. It
//! takes the estimate as linear in the data and does not depend on their source.
//!
//! *Conditioning.* The estimate without a group is solved from triangles combined by QR. Sums of squares are never
//! subtracted, which would cancel if one group has nearly all the weight. Directions are scaled to the information of
//! all rows, so the singular values of the remaining rows are their shares of it, from 0 to 1.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::geometry::{Pose, group_angles, group_directions};
use crate::units::Angle;

/// Share of the strongest direction, with all columns of derivatives scaled to 1, below which a direction is null.
const NULL: f64 = 1e-10;

/// Groups of rows along one axis of a scan; `None` for rows that are never left out.
pub type Labels = Vec<Option<i64>>;

/// Poses within this distance along an axis belong to one tilt or azimuth.
const SAME: Angle = Angle::from_deg(0.1);

/// Returns the tilts and azimuths of poses as labels of their rows.
#[must_use]
pub fn axes(poses: impl Iterator<Item = Pose>) -> [Labels; 2] {
    let (tilts, turns): (Vec<Angle>, Vec<Angle>) = poses.map(|p| (p.theta_c, p.phi_s)).unzip();
    [group_angles(&tilts, SAME), group_directions(&turns, SAME)]
        .map(|groups| groups.into_iter().map(|group| Some(group as i64)).collect())
}

/// Changes of an estimate when the groups of each axis are left out in turn; all axes with three groups or more are
/// combined in quadrature.
#[derive(Debug, Clone, PartialEq)]
pub struct ByGroups {
    /// Standard uncertainty of each parameter that the changes show.
    pub std: Vec<f64>,
    /// The same as errors that are independent from row to row, with a standard deviation of 1, are expected to show it.
    pub by_chance: Vec<f64>,
    /// Least degrees of freedom; infinite if no axis has three groups.
    pub freedom: f64,
}

impl ByGroups {
    /// Returns the part of the standard uncertainty of parameter `j` that independent errors do not account for.
    #[must_use]
    pub fn beyond_chance(&self, j: usize) -> f64 {
        let variance = self.std[j].powi(2) - self.by_chance[j].powi(2);
        variance.max(0.0).sqrt()
    }
}

/// Leaves the groups out. `jacobian` is column-major, `residuals` are model less observation at the minimum, both
/// weighted.
#[must_use]
pub fn by_groups(labels: &[Labels], jacobian: &[f64], residuals: &[f64]) -> ByGroups {
    let n = jacobian.len() / residuals.len().max(1);
    let (mut variance, mut by_chance) = (vec![0.0_f64; n], vec![0.0_f64; n]);
    let mut freedom = f64::INFINITY;
    for (axis, labels_of) in labels.iter().enumerate() {
        let mut groups: BTreeMap<Option<i64>, Vec<usize>> = BTreeMap::new();
        for (row, label) in labels_of.iter().enumerate() {
            groups.entry(*label).or_default().push(row);
        }
        let always = groups.remove(&None).unwrap_or_default();
        let count = groups.len() as f64;
        if count < 3.0 {
            continue;
        }
        let mut groups: Vec<Vec<usize>> = groups.into_values().collect();
        let across = &labels[usize::from(axis == 0)];
        for group in &mut groups {
            group.sort_by_key(|row| across[*row]);
        }
        let share = (count - 1.0) / count;
        for step in steps_without(jacobian, residuals, &groups, &always) {
            for j in 0..n {
                variance[j] += share * step.change[j].powi(2);
                by_chance[j] += share * step.by_chance[j];
            }
        }
        freedom = freedom.min(count - 1.0);
    }
    ByGroups {
        std: variance.into_iter().map(f64::sqrt).collect(),
        by_chance: by_chance.into_iter().map(f64::sqrt).collect(),
        freedom,
    }
}

/// The step of the parameters when some rows are left out.
#[derive(Debug)]
struct Step {
    change: Vec<f64>,
    /// Variance of the change by independent errors with a standard deviation of 1.
    by_chance: Vec<f64>,
}

/// Least share of a direction's information that must remain for a step along it to be meaningful; with less, noise
/// would be magnified.
const STAYS: f64 = 0.25;

/// Returns the Gauss–Newton steps from the minimum of all rows, each without one of the groups. Along directions that
/// the other groups hardly determine, the halves of the group are left out in turn (rows are in the order of the
/// other axis of the scan), and so on recursively: information that only one azimuth has is tested by parts of that
/// azimuth. Each group is reduced to a triangle once, and so are the rows before it and those behind it, so the rows
/// are read once for any number of groups.
fn steps_without(
    jacobian: &[f64],
    residuals: &[f64],
    groups: &[Vec<usize>],
    always: &[usize],
) -> Vec<Step> {
    let m = residuals.len();
    let n = jacobian.len() / m.max(1);
    let rows = Rows {
        jacobian,
        residuals,
        n,
    };
    let own: Vec<Vec<f64>> = groups.iter().map(|group| rows.triangle(group)).collect();
    let mut behind = vec![vec![0.0; (n + 1) * (n + 1)]; groups.len() + 1];
    for k in (0..groups.len()).rev() {
        behind[k] = stacked(&own[k], &behind[k + 1], n);
    }
    let mut before = rows.triangle(always);
    let scale = whitening(&stacked(&before, &behind[0], n), n);
    let mut steps = Vec::with_capacity(groups.len());
    for (k, group) in groups.iter().enumerate() {
        let others = stacked(&before, &behind[k + 1], n);
        let everywhere = DMatrix::identity(scale.ncols(), scale.ncols());
        rows.leave(group, &others, &scale, &everywhere, &mut steps);
        before = stacked(&before, &own[k], n);
    }
    steps
}

/// Returns the triangle R of a column-major matrix of n columns and at least n rows; all NaN if an entry is NaN, or
/// if the squares overflow.
fn triangle(a: Vec<f64>, rows: usize, n: usize) -> Vec<f64> {
    let a = DMatrix::from_vec(rows, n, a);
    if !a.norm_squared().is_finite() {
        return vec![f64::NAN; n * n];
    }
    a.qr().unpack_r().as_slice().to_vec()
}

/// Combines two triangles into one.
fn stacked(upper: &[f64], lower: &[f64], n: usize) -> Vec<f64> {
    let columns = upper.chunks(n + 1).zip(lower.chunks(n + 1));
    let a = columns.flat_map(|(u, l)| u.iter().chain(l).copied());
    triangle(a.collect(), 2 * (n + 1), n + 1)
}

/// Returns the columns of derivatives in a triangle.
fn derivatives(triangle: &[f64], n: usize) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |i, j| triangle[i + j * (n + 1)])
}

/// Returns directions of the parameters that are scaled so that all rows together determine one unit along each; null
/// directions are excluded.
fn whitening(all: &[f64], n: usize) -> DMatrix<f64> {
    let mut r = derivatives(all, n);
    let lengths: Vec<f64> = r.column_iter().map(|c| c.norm()).collect();
    for (mut column, length) in r.column_iter_mut().zip(&lengths) {
        if *length > 0.0 {
            column /= *length;
        }
    }
    if r.iter().any(|x| !x.is_finite()) {
        return DMatrix::zeros(n, 0);
    }
    let svd = r.svd(false, true);
    let Some(v_t) = svd.v_t else {
        return DMatrix::zeros(n, 0);
    };
    let strongest = svd.singular_values.max();
    let known: Vec<usize> = (0..svd.singular_values.len())
        .filter(|k| svd.singular_values[*k] > NULL * strongest)
        .collect();
    DMatrix::from_fn(n, known.len(), |i, k| {
        let value = v_t[(known[k], i)] / svd.singular_values[known[k]];
        if lengths[i] > 0.0 {
            value / lengths[i]
        } else {
            0.0
        }
    })
}

/// Rows of a fit.
struct Rows<'r> {
    jacobian: &'r [f64],
    residuals: &'r [f64],
    n: usize,
}

impl Rows<'_> {
    /// Reduces some rows to a triangle, with the right-hand side as its last column.
    fn triangle(&self, rows: &[usize]) -> Vec<f64> {
        let (m, n) = (self.residuals.len(), self.n);
        let height = rows.len().max(n + 1);
        let mut a = vec![0.0; height * (n + 1)];
        for (i, row) in rows.iter().enumerate() {
            for j in 0..n {
                a[i + j * height] = self.jacobian[row + j * m];
            }
            a[i + n * height] = -self.residuals[*row];
        }
        triangle(a, height, n + 1)
    }

    /// Adds the step without `group`, where `others` are all other rows, within the directions `within`. Along those
    /// that the others do not determine, adds the steps without its halves.
    fn leave(
        &self,
        group: &[usize],
        others: &[f64],
        scale: &DMatrix<f64>,
        within: &DMatrix<f64>,
        steps: &mut Vec<Step>,
    ) {
        let n = self.n;
        let directions = scale * within;
        let reduced = derivatives(others, n) * &directions;
        let target = DVector::from_fn(n, |i, _| others[i + n * (n + 1)]);
        if reduced.iter().chain(&target).any(|x| !x.is_finite()) {
            return;
        }
        let svd = reduced.svd(true, true);
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
            return;
        };
        // Of a step in the scaled directions, row by row: what the residuals give, and the errors that they are made of.
        let whole = derivatives(others, n) * scale;
        let (mut step, mut from) = (Vec::new(), Vec::new());
        let (mut taken, mut open) = (Vec::new(), Vec::new());
        for (k, s) in svd.singular_values.iter().enumerate() {
            let along = within * v_t.row(k).transpose();
            if s * s >= STAYS {
                step.push(u.column(k).dot(&target) / s);
                from.push(u.column(k) / *s);
                taken.push(scale * along);
            } else {
                open.push(along);
            }
        }
        if !taken.is_empty() {
            let (taken, from) = (DMatrix::from_columns(&taken), DMatrix::from_columns(&from));
            // The estimate of all rows has errors of its own, of which the part by these rows is the same.
            let both = whole.tr_mul(&from);
            let covariance = from.tr_mul(&from) - both.tr_mul(&both);
            steps.push(Step {
                change: (&taken * DVector::from_vec(step)).as_slice().to_vec(),
                by_chance: (0..n)
                    .map(|j| (taken.row(j) * &covariance * taken.row(j).transpose())[0].max(0.0))
                    .collect(),
            });
        }
        if open.is_empty() || group.len() < 2 {
            return;
        }
        let open = DMatrix::from_columns(&open);
        let (first, second) = group.split_at(group.len() / 2);
        for (left, stays) in [(first, second), (second, first)] {
            let others = stacked(others, &self.triangle(stays), n);
            self.leave(left, &others, scale, &open, steps);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns derivatives (column by column) and residuals at the minimum of a straight line with noise, in groups of
    /// `each` rows: the slope's derivative is `of_group`, plus a hundredth of it times the index in the group.
    fn line(of_group: &[f64], each: usize) -> (Vec<f64>, Vec<f64>, Vec<Vec<usize>>) {
        let m = of_group.len() * each;
        let slope = |i: usize| of_group[i / each] * (1.0 + 0.01 * (i % each) as f64);
        let mut jacobian = vec![1.0; m];
        jacobian.extend((0..m).map(slope));
        let noise = |i: usize| ((7 * i + 3) % 11) as f64 / 11.0 - 0.5;
        let j = DMatrix::from_column_slice(m, 2, &jacobian);
        let raw = DVector::from_fn(m, |i, _| noise(i));
        let minimum = j.clone().svd(true, true).solve(&raw, 1e-14).unwrap();
        let residuals = (raw - j * minimum).as_slice().to_vec();
        let groups = (0..of_group.len()).map(|g| (g * each..(g + 1) * each).collect());
        (jacobian, residuals, groups.collect())
    }

    #[test]
    fn if_the_others_determine_the_estimate_a_step_is_their_own_solution() {
        let (jacobian, residuals, groups) = line(&[-1.0, -0.6, -0.2, 0.2, 0.6, 1.0], 5);
        let steps = steps_without(&jacobian, &residuals, &groups, &[]);
        assert_eq!(steps.len(), 6);
        for (group, step) in groups.iter().zip(&steps) {
            let others: Vec<usize> = (0..30).filter(|i| !group.contains(i)).collect();
            let j = DMatrix::from_fn(25, 2, |i, k| jacobian[others[i] + 30 * k]);
            let r = DVector::from_fn(25, |i, _| -residuals[others[i]]);
            let expected = j.svd(true, true).solve(&r, 1e-14).unwrap();
            for (a, b) in step.change.iter().zip(&expected) {
                assert!((a - b).abs() < 1e-12, "{a} {b}");
            }
        }
    }

    #[test]
    fn information_of_a_single_group_is_tested_by_its_halves() {
        // Only the last group determines the slope.
        let (jacobian, residuals, groups) = line(&[0.0, 1e-6, 1.0], 8);
        let steps = steps_without(&jacobian, &residuals, &groups, &[]);
        assert!(steps.len() > 3);
        let j = DMatrix::from_column_slice(24, 2, &jacobian);
        let std = (j.tr_mul(&j).try_inverse().unwrap()[(1, 1)] / 12.0).sqrt();
        let spread = steps
            .iter()
            .map(|s| s.change[1].powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(spread > 0.1 * std && spread < 4.0 * std, "{spread} {std}");
    }

    #[test]
    fn an_undetermined_direction_takes_no_step() {
        let (mut jacobian, residuals, groups) = line(&[-1.0, 1.0, 2.0], 4);
        jacobian.extend([0.0; 12]);
        let twice: Vec<f64> = jacobian[12..24].to_vec();
        jacobian.extend(twice);
        for step in steps_without(&jacobian, &residuals, &groups, &[]) {
            let step = step.change;
            assert!(
                step.iter().all(|p| p.is_finite()) && step[2] == 0.0,
                "{step:?}"
            );
            // Two parameters of which only the sum is determined share it.
            assert!((step[1] - step[3]).abs() < 1e-12, "{step:?}");
        }
    }

    #[test]
    fn independent_errors_change_the_estimate_as_much_as_expected() {
        // Where the others determine the estimate, and where information of one group is tested by its halves.
        for slopes in [[-1.0, -0.4, 0.3, 1.0], [0.0, 1e-6, 1.0, 1e-3]] {
            let (jacobian, residuals, groups) = line(&slopes, 6);
            let m = residuals.len();
            let j = DMatrix::from_column_slice(m, 2, &jacobian);
            let pull = j.clone().pseudo_inverse(1e-14).unwrap();
            let squares = |residuals: &[f64]| -> [f64; 2] {
                let steps = steps_without(&jacobian, residuals, &groups, &[]);
                [0, 1].map(|k| steps.iter().map(|s| s.change[k].powi(2)).sum())
            };
            // The changes are linear in the errors, so the squares for unit errors of single rows add up.
            let mut found = [0.0; 2];
            for row in 0..m {
                let mut error = DVector::zeros(m);
                error[row] = 1.0;
                let left = &error - &j * (&pull * &error);
                for (sum, of_row) in found.iter_mut().zip(squares(left.as_slice())) {
                    *sum += of_row;
                }
            }
            let expected = steps_without(&jacobian, &residuals, &groups, &[]);
            for (k, found) in found.into_iter().enumerate() {
                let by_chance: f64 = expected.iter().map(|s| s.by_chance[k]).sum();
                let ratio = found / by_chance;
                assert!((ratio - 1.0).abs() < 1e-9, "{ratio}");
            }
        }
    }

    #[test]
    fn errors_that_a_group_shares_exceed_chance_and_alternating_ones_do_not() {
        let (jacobian, _, groups) = line(&[-1.0, -0.6, -0.2, 0.2, 0.6, 1.0], 8);
        let m = 48;
        let j = DMatrix::from_column_slice(m, 2, &jacobian);
        let pull = j.clone().pseudo_inverse(1e-14).unwrap();
        let beyond = |error: &dyn Fn(usize) -> f64| {
            let error = DVector::from_fn(m, |row, _| error(row));
            let left = &error - &j * (&pull * &error);
            let label = |row: usize| groups.iter().position(|g: &Vec<usize>| g.contains(&row));
            let labels = (0..m).map(|row| label(row).map(|g| g as i64)).collect();
            let changes = by_groups(&[labels, vec![Some(0); m]], &jacobian, left.as_slice());
            [0, 1].map(|k| changes.beyond_chance(k))
        };
        let alternating = beyond(&|row| if row % 2 == 0 { 1.0 } else { -1.0 });
        assert_eq!(alternating, [0.0, 0.0]);
        // The mean of 48 rows with errors of 1 is known to 1/√48; of 6 groups with one error each, to 1/√6.
        let common = [1.0, -1.0, -1.0, 1.0, 1.0, -1.0];
        let shared = beyond(&|row| common[row / 8]);
        let expected = (1.0 / 6.0 - 1.0 / 48.0_f64).sqrt();
        assert!(
            (expected..2.0 * expected).contains(&shared[0]),
            "{shared:?} {expected}"
        );
    }
}
