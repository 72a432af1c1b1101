//! Direction bins as text and as bytes, for files that other programs read.
//!
//! Call [`csv`] for a table, [`float32`] for a block that the page can draw. This module does not
//! know where they are stored.

use std::fmt::Write as _;

use super::grid::{DirectionGrid, Layout};
use super::tally::Totals;
use crate::trace::ellipsometer::{aop_deg, dolp};
use crate::trace::surfaces::height_field::Side;

/// The table of bins: limits in degrees, Mueller elements and their standard errors in sr⁻¹, hits,
/// and DOLP and AOP for the lamp's `stokes`. Elements that were not computed (all but m00 in a
/// scalar run) are empty; without light all are 0. `also` adds columns: their names, and each row's
/// values, every one preceded by a comma.
#[must_use]
pub fn csv(
    totals: &Totals,
    stokes: &[f64; 4],
    also: &str,
    mut of_row: impl FnMut(Side, usize) -> String,
) -> String {
    let grid = totals.grid();
    debug_assert_eq!(grid.layout, Layout::Polar, "rows have limits in angles");
    let mut text = String::from("side,theta_lo_deg,theta_hi_deg,phi_lo_deg,phi_hi_deg");
    for suffix in ["", "_std"] {
        for i in 0..16 {
            let _ = write!(text, ",m{}{}{suffix}", i / 4, i % 4);
        }
    }
    let _ = writeln!(text, ",hits,dolp,aop_deg{also}");
    // Of a million bins most are dark, so their row is prepared once.
    let dark = {
        let each: String = (0..16)
            .map(|i| if i < totals.elements() { ",0" } else { "," })
            .collect();
        format!("{each}{each},0,,")
    };
    let places = BinPlaces::of(grid);
    for side in sides(totals) {
        for bin in 0..grid.per_side() {
            for (n, part) in places.of_bin(side, bin).enumerate() {
                text.push_str(if n == 0 { "" } else { "," });
                text.push_str(part);
            }
            let empty = totals.is_empty(side, bin);
            if empty {
                text.push_str(&dark);
                text.push_str(&of_row(side, bin));
                text.push('\n');
                continue;
            }
            for of_std in [false, true] {
                for i in 0..16 {
                    if i >= totals.elements() {
                        text.push(',');
                        continue;
                    }
                    let e = totals.element(side, bin, i);
                    let x = if of_std { e.std } else { e.value };
                    let _ = write!(text, ",{x:e}");
                }
            }
            let _ = write!(text, ",{}", totals.hits(side, bin));
            if totals.elements() < 16 {
                text.push_str(",,");
            } else {
                let seen: [f64; 4] = std::array::from_fn(|i| {
                    let row =
                        (0..4).map(|j| totals.element(side, bin, 4 * i + j).value * stokes[j]);
                    row.sum()
                });
                let _ = write!(text, ",{:e},{:e}", dolp(&seen), aop_deg(&seen));
            }
            text.push_str(&of_row(side, bin));
            text.push('\n');
        }
    }
    text
}

/// The first five columns of each bin's row.
pub struct BinPlaces {
    polar: Vec<[String; 2]>,
    azimuths: Vec<[String; 2]>,
}

impl BinPlaces {
    /// Makes the columns of a grid's bins.
    #[must_use]
    pub fn of(grid: DirectionGrid) -> Self {
        let limits = |bin: usize| grid.limits_deg(bin).map(|limit| limit.to_string());
        let rows = (0..grid.n_theta).map(|row| {
            let [t0, t1, _, _] = limits(row * grid.n_phi);
            [t0, t1]
        });
        let columns = (0..grid.n_phi).map(|column| {
            let [_, _, p0, p1] = limits(column);
            [p0, p1]
        });
        BinPlaces {
            polar: rows.collect(),
            azimuths: columns.collect(),
        }
    }

    /// Side and limits of a bin, as written in the table.
    pub fn of_bin(&self, side: Side, bin: usize) -> impl Iterator<Item = &str> {
        let name = match side {
            Side::Above => "R",
            Side::Below => "T",
        };
        let (row, column) = (bin / self.azimuths.len(), bin % self.azimuths.len());
        let limits = self.polar[row].iter().chain(&self.azimuths[column]);
        std::iter::once(name).chain(limits.map(String::as_str))
    }
}

/// The upper side, and the lower one if light reached it.
#[must_use]
pub fn sides(totals: &Totals) -> Vec<Side> {
    let transmits = (0..totals.grid().per_side()).any(|bin| !totals.is_empty(Side::Below, bin));
    let below = transmits.then_some(Side::Below);
    std::iter::once(Side::Above).chain(below).collect()
}

/// Side by side ([`sides`]), bin by bin, number by number: value and standard error, sr⁻¹, as
/// little-endian 32-bit floats. NaN without light.
#[must_use]
pub fn float32(totals: &Totals) -> Vec<u8> {
    let (bins, numbers) = (totals.grid().per_side(), totals.elements());
    let sides = sides(totals);
    let mut bytes = Vec::with_capacity(8 * sides.len() * bins * numbers);
    for side in sides {
        for bin in 0..bins {
            let empty = totals.is_empty(side, bin);
            for i in 0..numbers {
                let (value, std) = if empty {
                    (f64::NAN, f64::NAN)
                } else {
                    let e = totals.element(side, bin, i);
                    (e.value, e.std)
                };
                bytes.extend((value as f32).to_le_bytes());
                bytes.extend((std as f32).to_le_bytes());
            }
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::run::{Shard, trace};
    use crate::trace::scene::Scene;

    #[test]
    fn elements_that_a_scalar_run_does_not_compute_are_empty() {
        let text = "[light]\ntheta_i_deg = 40.0\n[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n\
                    [run]\nphotons = 500\ntheta_bins = 6\nphi_bins = 8\npolarised = false\n";
        let prepared = Scene::parse(text).unwrap().prepare(&|_| Err(String::new()));
        let totals = trace(&prepared.unwrap(), Shard::WHOLE, &|_| true);
        let table = csv(&totals, &[1.0, 0.0, 0.0, 0.0], "", |_, _| String::new());
        let mut lit = 0;
        for line in table.lines().skip(1) {
            let row: Vec<&str> = line.split(',').collect();
            let (m00, std) = (row[5], row[5 + 16]);
            lit += usize::from(m00.parse::<f64>().unwrap() > 0.0);
            assert!(std.parse::<f64>().is_ok());
            assert!(
                row[6..21].iter().chain(&row[22..37]).all(|f| f.is_empty()),
                "{line}"
            );
        }
        assert_eq!(lit, 2);
    }

    #[test]
    fn table_and_block_contain_the_same_numbers_of_both_sides() {
        let text = "[light]\ntheta_i_deg = 40.0\n[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n\
                    [run]\nphotons = 500\ntheta_bins = 6\nphi_bins = 8\n";
        let prepared = Scene::parse(text).unwrap().prepare(&|_| Err(String::new()));
        let totals = trace(&prepared.unwrap(), Shard::WHOLE, &|_| true);
        let table = csv(&totals, &[1.0, 0.0, 0.0, 0.0], ",more", |_, bin| {
            format!(",{bin}")
        });
        let block = float32(&totals);
        assert_eq!(block.len(), 2 * 48 * 16 * 2 * 4);
        let rows: Vec<Vec<&str>> = table.lines().map(|l| l.split(',').collect()).collect();
        assert_eq!(rows.len(), 1 + 2 * 48);
        assert_eq!(rows[0][rows[0].len() - 1], "more");
        let mut lit = 0;
        for (row, bin) in rows[1..].iter().zip(block.chunks(16 * 2 * 4)) {
            let first = f32::from_le_bytes(bin[..4].try_into().unwrap());
            if first.is_nan() {
                assert_eq!(row[5], "0");
            } else {
                assert_eq!(row[5].parse::<f64>().unwrap() as f32, first);
                lit += 1;
            }
        }
        // A mirror and a window: one direction each.
        assert_eq!(lit, 2);
        assert_eq!(rows[96][0], "T");
    }
}
