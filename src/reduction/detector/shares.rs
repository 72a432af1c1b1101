//! What is left open of the camera's curve and its exposure times → a change of each observation.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::{C, Detector};
use crate::frame::FrameKind;
use crate::reduction::merge::{Merged, PoseLevels};
use crate::reduction::scale::Scale;
use crate::series::FrameRow;

/// Light that one exposure time gave an observation: its share in it, and its mean count above dark.
#[derive(Debug, Clone, Copy)]
pub(super) struct Share {
    pub(super) exposure_s: f64,
    pub(super) share: f64,
    pub(super) counts_dn: f64,
}

/// What is uncertain of the camera's curve and its exposure times, as a share of each level.
pub(in crate::reduction) fn shares(
    rows: &[FrameRow],
    scale: &Scale,
    levels: &[(&PoseLevels, Merged)],
) -> Vec<f64> {
    let share = |exposure_s: f64, of: f64, rate_dn_s: f64| Share {
        exposure_s,
        share: exposure_s / of,
        counts_dn: rate_dn_s * exposure_s,
    };
    let samples: Vec<Vec<Share>> = levels
        .iter()
        .map(|(pose, level)| {
            // Frames count nearly as long as they were exposed.
            let times = || pose.frames.iter().map(|index| rows[*index].exposure_s);
            let of: f64 = times().sum();
            times().map(|s| share(s, of, level.rate_dn_s)).collect()
        })
        .collect();
    let white = scale.unit_dn_s.zip(scale.reference);
    let white = white.map(|(unit, reference)| unit * reference.reflectance / PI);
    let flats = rows.iter().filter(|row| row.kind == FrameKind::Flat);
    let times: Vec<f64> = flats.map(|row| row.exposure_s).collect();
    let flats: Vec<Share> = white.map_or_else(Vec::new, |rate_dn_s| {
        let of = times.iter().sum();
        times.iter().map(|s| share(*s, of, rate_dn_s)).collect()
    });
    scale.detector.shares(&samples, &flats)
}

impl Detector {
    /// By how much one standard uncertainty of the curve and of the exposure times changes each signal, as a share of it, all
    /// at once; `flats` is the light that the scale rests on.
    ///
    /// The unknowns are correlated and change signals along one pattern nearly alone: it is given the whole variance.
    pub(super) fn shares(&self, observations: &[Vec<Share>], flats: &[Share]) -> Vec<f64> {
        let size = self.covariance.nrows();
        let none = || vec![0.0; observations.len()];
        if observations.is_empty() || self.covariance.iter().all(|v| *v == 0.0) {
            return none();
        }
        let curve = self.curve();
        let slope = |shares: &[Share]| {
            let mut slope = DVector::zeros(size);
            for one in shares {
                slope[C] += curve.map_or(0.0, |c| one.share * c.per_c(one.counts_dn));
                if let Some(at) = self.times.iter().position(|(s, _)| *s == one.exposure_s) {
                    slope[1 + at] -= one.share;
                }
            }
            slope
        };
        let reference = slope(flats);
        let eigen = SymmetricEigen::new(self.covariance.clone());
        let roots = eigen.eigenvalues.map(|v| v.max(0.0).sqrt());
        let scaled = &eigen.eigenvectors * DMatrix::from_diagonal(&roots);
        let rows: Vec<_> = observations
            .iter()
            .map(|shares| (slope(shares) - &reference).transpose() * &scaled)
            .collect();
        let changes = DMatrix::from_rows(&rows);
        let squares = changes.tr_mul(&changes);
        let total = squares.trace();
        let patterns = SymmetricEigen::new(squares);
        let strongest = patterns.eigenvalues.imax();
        let share = patterns.eigenvalues[strongest];
        if !(share > 0.0 && total.is_finite()) {
            return none();
        }
        let pattern = changes * patterns.eigenvectors.column(strongest) * (total / share).sqrt();
        // A larger c, or a longer exposure: the sign of the greatest change.
        let sign = pattern[pattern.iamax()].signum();
        pattern.iter().map(|v| sign * v).collect()
    }
}
