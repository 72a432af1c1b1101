//! The plane of incidence in polar bins: directions of reflection from the lamp's side to the
//! mirror's.
//!
//! Call [`plane`]; [`crate::trace::ellipsometer`] and [`super::polarisation_difference`] evaluate it.

use super::grid::{DirectionGrid, Layout};
use super::tally::{ElementCovariance, MonteCarloEstimate, Totals};
use crate::trace::surfaces::height_field::Side;

/// One direction of the plane.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneDirection {
    /// Angle of reflection, degrees; positive on the side of the mirror direction.
    pub theta_s_deg: f64,
    /// The contents of its bins, sr⁻¹; means if the plane is the border of two columns.
    pub numbers: Vec<MonteCarloEstimate>,
    /// Their covariance, if recorded.
    pub covariance: Option<ElementCovariance>,
}

/// Angles of reflection, degrees, and bins of the directions of the plane; `None` if bins are
/// pixels.
#[must_use]
pub fn directions(grid: DirectionGrid, phi_i_deg: f64) -> Option<Vec<(f64, Vec<usize>)>> {
    if grid.layout != Layout::Polar {
        return None;
    }
    let mut directions = Vec::new();
    for (sign, plane_deg) in [(-1.0, phi_i_deg), (1.0, phi_i_deg + 180.0)] {
        for row in 0..grid.n_theta {
            let columns = beside(grid.n_phi, plane_deg);
            let bins = columns.map(|column| row * grid.n_phi + column).collect();
            let [lo, hi, _, _] = grid.limits_deg(row * grid.n_phi);
            directions.push((sign * 0.5 * (lo + hi), bins));
        }
    }
    directions.sort_by(|a, b| a.0.total_cmp(&b.0));
    Some(directions)
}

/// The directions by ascending angle, for a lamp at the azimuth `phi_i_deg`; those without light
/// are left out. `None` if bins are pixels, which have no such rows.
#[must_use]
pub fn plane(totals: &Totals, phi_i_deg: f64) -> Option<Vec<PlaneDirection>> {
    let seen = |(theta_s_deg, bins): (f64, Vec<usize>)| {
        // If one of two bins has light, the other is dark, not unknown.
        if bins.iter().all(|&bin| totals.is_empty(Side::Above, bin)) {
            return None;
        }
        let n = bins.len() as f64;
        let mean = |i: usize| {
            let (mut value, mut square) = (0.0, 0.0);
            for &bin in &bins {
                let e = totals.element(Side::Above, bin, i);
                value += e.value / n;
                square += (e.std / n).powi(2);
            }
            MonteCarloEstimate {
                value,
                std: square.sqrt(),
            }
        };
        Some(PlaneDirection {
            theta_s_deg,
            numbers: (0..totals.elements()).map(mean).collect(),
            covariance: totals.covariance(&bins),
        })
    };
    let directions = directions(totals.grid(), phi_i_deg)?;
    Some(directions.into_iter().filter_map(seen).collect())
}

/// The columns of bins at an azimuth: the one that contains it, or both at a border.
fn beside(n_phi: usize, phi_deg: f64) -> impl Iterator<Item = usize> {
    let at = (phi_deg / 360.0).rem_euclid(1.0) * n_phi as f64;
    let nearest = at.round();
    let (first, last) = if (at - nearest).abs() < 1e-6 {
        (nearest as usize + n_phi - 1, nearest as usize)
    } else {
        (at as usize, at as usize)
    };
    let (first, last) = (first % n_phi, last % n_phi);
    std::iter::once(first).chain((first != last).then_some(last))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::counting::grid::DirectionGrid;
    use crate::trace::counting::tally::TallyBatch;
    use crate::trace::photons::light::{PhotonState, ScalarState};
    use crate::trace::run::{Shard, trace};
    use crate::trace::scene::Scene;

    #[test]
    fn a_mirror_reflects_into_the_plane_of_incidence_at_every_azimuth() {
        for (phi_i_deg, phi_bins) in [(0.0, 8), (90.0, 8), (90.0, 7), (200.0, 180), (-17.0, 9)] {
            let text = format!(
                "[light]\nphi_i_deg = {phi_i_deg:?}\n[[interface]]\nshape = \"flat\"\nbelow = \"Au550\"\n\
                 [run]\nphotons = 64\ntheta_bins = 9\nphi_bins = {phi_bins}\n"
            );
            let scene = Scene::parse(&text).unwrap();
            let prepared = scene.prepare(&|_| Err(String::new())).unwrap();
            let totals = trace(&prepared, Shard::WHOLE, &|_| true);
            let lit = plane(&totals, phi_i_deg).unwrap();
            let [only] = &lit[..] else {
                panic!("{phi_i_deg} {phi_bins}: {lit:?}")
            };
            assert!((only.theta_s_deg.abs() - 5.0).abs() < 1e-9 && only.numbers[0].value > 0.0);
        }
    }

    #[test]
    fn on_a_border_a_bin_without_light_counts_as_dark() {
        let grid = DirectionGrid::polar(2, 8);
        let mut totals = Totals::new(grid, 1);
        for _ in 0..2 {
            let mut batch = TallyBatch::new::<ScalarState>(grid);
            // Light only on one side of the plane.
            let k = [0.5, 0.1, 0.8];
            batch.exit(&ScalarState::launch(&k), 1.0, Side::Above, &k, 1);
            totals.take(&mut batch, 10);
        }
        let own = totals.element(Side::Above, grid.bin(Side::Above, &[0.5, 0.1, 0.8]), 0);
        let all = plane(&totals, 180.0).unwrap();
        assert_eq!(all.len(), 1);
        let seen = &all[0].numbers[0];
        assert!(
            own.value > 0.0 && (seen.value / own.value - 0.5).abs() < 1e-12,
            "{seen:?} {own:?}"
        );
    }
}
