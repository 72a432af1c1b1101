//! Extremes over square windows of cells of a periodic tile.

use super::WINDOW;

/// For every cell and the [`WINDOW`] − 1 cells after it along both axes, the value that `pick`
/// selects.
pub(super) fn over_windows(
    nx: usize,
    ny: usize,
    cells: &[f32],
    pick: impl Fn(f32, f32) -> f32,
) -> Vec<f32> {
    let mut picked = cells.to_vec();
    let mut reach = 1;
    while reach < WINDOW as usize {
        let (down, right) = (reach % nx, reach % ny);
        let before = picked.clone();
        let shifted = before.chunks(ny).cycle().skip(down);
        for ((out, own), other) in picked.chunks_mut(ny).zip(before.chunks(ny)).zip(shifted) {
            let across = own[right..].iter().chain(&own[..right]);
            let diagonal = other[right..].iter().chain(&other[..right]);
            for ((((o, a), b), c), d) in
                out.iter_mut().zip(own).zip(other).zip(across).zip(diagonal)
            {
                *o = pick(pick(*a, *b), pick(*c, *d));
            }
        }
        reach *= 2;
    }
    picked
}
