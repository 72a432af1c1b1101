//! Pieces that approximate curves: the tangents at their ends, and the frame that turns from one to
//! the other.

use super::Piece;
use crate::trace::vec3::V3;

/// Cosine of the largest angle between neighbours, at least one of them bowed, that share a
/// tangent; a larger angle is an edge.
const TANGENT: f64 = 0.966;

/// Tangents at both ends of the pieces that approximate curves, with the indices of the pieces.
pub(super) fn bows(pieces: &[Piece], bowed: &[bool]) -> Vec<(usize, [(f64, f64); 2])> {
    let n = pieces.len();
    let direction = |i: usize| (pieces[i].along[1], pieces[i].along[2]);
    let length =
        |i: usize| (pieces[i].to - pieces[i].from).hypot(pieces[i].z_to - pieces[i].z_from);
    let dot = |a: (f64, f64), b: (f64, f64)| a.0 * b.0 + a.1 * b.1;
    // At the corner before piece i; `None` at an edge.
    let tangent = |i: usize| -> Option<(f64, f64)> {
        let (before, i) = ((i + n - 1) % n, i % n);
        let (a, b) = (direction(before), direction(i));
        if dot(a, b) < TANGENT {
            return None;
        }
        Some(match (bowed[before], bowed[i]) {
            (false, _) => a,
            (_, false) => b,
            // The tangent of the circle through both pieces.
            _ => {
                let (wa, wb) = (length(i), length(before));
                let sum = (wa * a.0 + wb * b.0, wa * a.1 + wb * b.1);
                let norm = sum.0.hypot(sum.1);
                (sum.0 / norm, sum.1 / norm)
            }
        })
    };
    let mirrored = |i: usize, t: (f64, f64)| {
        let d = direction(i);
        let twice = 2.0 * dot(t, d);
        (twice * d.0 - t.0, twice * d.1 - t.1)
    };
    (0..n)
        .filter(|&i| bowed[i])
        .filter_map(|i| {
            let ends = match (tangent(i), tangent(i + 1)) {
                (Some(a), Some(b)) => [a, b],
                (Some(a), None) => [a, mirrored(i, a)],
                (None, Some(b)) => [mirrored(i, b), b],
                (None, None) => return None,
            };
            Some((i, ends))
        })
        .collect()
}

impl Piece {
    /// Unit vector along the surface towards +v, and the unit normal, upwards, at a v within the
    /// piece.
    #[inline]
    #[must_use]
    pub fn frame(&self, v: f64) -> (V3, V3) {
        let Some([a, b]) = &self.tangents else {
            return (self.along, self.normal);
        };
        let at = (v - self.from) / (self.to - self.from);
        let (c, s) = (a.0 + at * (b.0 - a.0), a.1 + at * (b.1 - a.1));
        let norm = (c * c + s * s).sqrt();
        let (c, s) = (c / norm, s / norm);
        ([0.0, c, s], [0.0, -s, c])
    }
}
