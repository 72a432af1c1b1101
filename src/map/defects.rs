//! Features of a map: the lean directions that many pixels share, the borders between them, and connected areas that
//! differ from the rest.
//!
//! A pixel differs if ridge angle, roughness or diffuse reflectance deviate from the map's median by more than
//! [`DEVIATION`] robust standard deviations (pixel noise included), if it leans in an uncommon direction, or if no
//! single surface fits it. Border pixels are excluded, since they image two surfaces.

use std::collections::VecDeque;

use serde::Serialize;

use super::layers::{BORDER, DEFECT, Layers, MISFIT};
use super::solve::kernel::FREE;
use crate::robust::{self, STD_PER_DEVIATION};

/// Deviation, in robust standard deviations, from which a pixel differs.
pub const DEVIATION: f64 = 6.0;
/// Smallest defect in pixels.
pub const AREA_MIN_PX: usize = 6;
/// Distance in pixels to another lean direction or to the edge up to which a pixel is a border pixel.
const BORDER_PX: isize = 2;
/// Number of neighbours without a value from which a pixel counts as being at the edge.
const EDGE_NEIGHBOURS: usize = 4;
/// Least share of the pixels that makes a lean direction common.
const LEAN_SHARE_MIN: f64 = 0.02;
/// Half width of a lean direction, degrees.
const LEAN_HALF_WIDTH_DEG: f64 = 30.0;
/// Bins of the histogram of directions.
const BINS: usize = 72;

/// A lean direction that many pixels share.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = MapLean)]
pub struct Lean {
    /// Degrees, counter-clockwise from the sample's x at φs = 0.
    pub azimuth_deg: f64,
    /// Share of the pixels that a single surface explains.
    pub share: f64,
}

/// Difference of an area from the map's median in one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = MapDeviation)]
pub struct Deviation {
    /// Name of the layer.
    pub parameter: &'static str,
    /// Median over the area; null if its pixels have no value.
    pub value: Option<f64>,
    /// Median over the map.
    pub usual: f64,
    /// (value − usual) over the robust standard deviation of the map's pixels.
    pub sigmas: Option<f64>,
}

/// A connected area that differs from the rest.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = MapDefect)]
pub struct Defect {
    /// Centre of gravity in the sample's axes at φs = 0, from the rotation axis.
    pub x_mm: f64,
    /// See `x_mm`.
    pub y_mm: f64,
    /// Extent along x and y.
    pub width_mm: f64,
    /// See `width_mm`.
    pub height_mm: f64,
    /// Area.
    pub area_mm2: f64,
    /// Pixels.
    pub pixels: usize,
    /// The parameter that deviates most, or `fit` if no single surface explains the area.
    pub worst: &'static str,
    /// Deviations of every parameter but the lean direction.
    pub deviations: Vec<Deviation>,
    /// Median lean direction.
    pub lean_azimuth_deg: Option<f64>,
}

/// Returns the common lean directions, the most common first.
#[must_use]
pub fn leans(layers: &Layers) -> Vec<Lean> {
    // A pixel that images two surfaces gets a lean between theirs.
    let directions: Vec<f64> = (0..layers.flags.len())
        .filter(|p| layers.has_value(*p) && layers.flags[*p] & MISFIT == 0)
        .map(|p| f64::from(layers.parameters[1].values[p]))
        .collect();
    let mut histogram = [0.0_f64; BINS];
    let bin_deg = 360.0 / BINS as f64;
    for azimuth in &directions {
        histogram[(azimuth.rem_euclid(360.0) / bin_deg) as usize % BINS] += 1.0;
    }
    let smooth: Vec<f64> = (0..BINS)
        .map(|b| {
            (0..5)
                .map(|k| histogram[(b + BINS + k - 2) % BINS])
                .sum::<f64>()
        })
        .collect();
    let mut order: Vec<usize> = (0..BINS).collect();
    order.sort_by(|a, b| smooth[*b].total_cmp(&smooth[*a]));
    let mut leans: Vec<Lean> = Vec::new();
    for bin in order {
        let peak = (bin as f64 + 0.5) * bin_deg;
        if leans
            .iter()
            .any(|l| apart_deg(l.azimuth_deg, peak).abs() < 1.5 * LEAN_HALF_WIDTH_DEG)
        {
            continue;
        }
        let (mut n, mut sin, mut cos) = (0_usize, 0.0, 0.0);
        for azimuth in &directions {
            if apart_deg(*azimuth, peak).abs() < LEAN_HALF_WIDTH_DEG {
                let (s, c) = azimuth.to_radians().sin_cos();
                n += 1;
                sin += s;
                cos += c;
            }
        }
        let share = n as f64 / directions.len().max(1) as f64;
        if share < LEAN_SHARE_MIN {
            break;
        }
        leans.push(Lean {
            azimuth_deg: apart_deg(f64::atan2(sin, cos).to_degrees(), 0.0),
            share,
        });
    }
    leans
}

/// Returns a − b in (−180, 180], degrees.
fn apart_deg(a: f64, b: f64) -> f64 {
    let d = (a - b).rem_euclid(360.0);
    if d > 180.0 { d - 360.0 } else { d }
}

/// Returns the index of a pixel's common lean direction; `None` if its lean is uncommon.
fn lean_of(layers: &Layers, leans: &[Lean], pixel: usize) -> Option<usize> {
    let azimuth = f64::from(layers.parameters[1].values[pixel]);
    leans
        .iter()
        .position(|l| apart_deg(azimuth, l.azimuth_deg).abs() < LEAN_HALF_WIDTH_DEG)
}

/// Flags pixels within [`BORDER_PX`] pixels of another common lean direction or of the sample's edge.
pub fn mark_borders(layers: &mut Layers, leans: &[Lean]) {
    let (width, height) = (layers.width as isize, layers.height as isize);
    let group: Vec<Option<usize>> = (0..layers.flags.len())
        .map(|p| {
            if layers.has_value(p) && layers.flags[p] & MISFIT == 0 {
                lean_of(layers, leans, p)
            } else {
                None
            }
        })
        .collect();
    let empty: Vec<bool> = (0..layers.flags.len())
        .map(|p| !layers.has_value(p))
        .collect();
    let mut border = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let pixel = (row * width + column) as usize;
            let mut seen: Option<usize> = None;
            let (mut mixed, mut without) = (false, 0);
            for r in row - BORDER_PX..=row + BORDER_PX {
                for c in column - BORDER_PX..=column + BORDER_PX {
                    if r < 0 || c < 0 || r >= height || c >= width {
                        continue;
                    }
                    let other = (r * width + c) as usize;
                    without += usize::from(empty[other]);
                    if let Some(lean) = group[other] {
                        mixed |= seen.is_some_and(|s| s != lean);
                        seen = Some(lean);
                    }
                }
            }
            if !empty[pixel] && (mixed || without >= EDGE_NEIGHBOURS) {
                border.push(pixel);
            }
        }
    }
    for pixel in border {
        layers.flags[pixel] |= BORDER;
    }
}

/// Parameters compared with the rest: all but the lean direction.
const COMPARED: [usize; FREE - 1] = [0, 2, 3, 4];

/// Returns median and robust standard deviation of a parameter over pixels away from borders.
fn usual(layers: &Layers, parameter: usize) -> Option<(f64, f64)> {
    let inner = |p: &usize| layers.has_value(*p) && layers.flags[*p] & (BORDER | MISFIT) == 0;
    let values = &layers.parameters[parameter].values;
    let centre = robust::median_of_finite(
        (0..values.len())
            .filter(inner)
            .map(|p| f64::from(values[p])),
    )?;
    let spread = robust::median_of_finite(
        (0..values.len())
            .filter(inner)
            .map(|p| (f64::from(values[p]) - centre).abs()),
    )?;
    Some((centre, STD_PER_DEVIATION * spread))
}

/// Finds the areas that differ, flags their pixels, and returns them, the largest first.
pub fn defects(
    layers: &mut Layers,
    leans: &[Lean],
    place_mm: &dyn Fn(usize) -> [f64; 2],
    pixel_mm: [f64; 2],
) -> Vec<Defect> {
    let n = layers.flags.len();
    let usual: Vec<Option<(f64, f64)>> = (0..FREE).map(|k| usual(layers, k)).collect();
    let deviates = |layers: &Layers, pixel: usize| -> bool {
        if !layers.has_value(pixel) || layers.flags[pixel] & BORDER != 0 {
            return false;
        }
        if layers.flags[pixel] & MISFIT != 0 || lean_of(layers, leans, pixel).is_none() {
            return true;
        }
        COMPARED.iter().any(|k| {
            let Some((centre, spread)) = usual[*k] else {
                return false;
            };
            let layer = &layers.parameters[*k];
            let std = f64::from(layer.std[pixel]);
            let away = (f64::from(layer.values[pixel]) - centre).abs();
            away > DEVIATION * std.max(spread).max(1e-6 * centre.abs())
        })
    };
    let odd: Vec<bool> = (0..n).map(|p| deviates(layers, p)).collect();
    let mut visited = vec![false; n];
    let mut found = Vec::new();
    for seed in 0..n {
        if !odd[seed] || visited[seed] {
            continue;
        }
        let area = grow(&odd, &mut visited, seed, layers.width);
        if area.len() < AREA_MIN_PX {
            continue;
        }
        for pixel in &area {
            layers.flags[*pixel] |= DEFECT;
        }
        found.push(describe(layers, &usual, &area, place_mm, pixel_mm));
    }
    found.sort_by_key(|d| std::cmp::Reverse(d.pixels));
    found
}

/// Returns the eight-connected area that contains `seed`.
fn grow(odd: &[bool], visited: &mut [bool], seed: usize, width: usize) -> Vec<usize> {
    let height = odd.len() / width;
    let mut area = Vec::new();
    let mut queue = VecDeque::from([seed]);
    visited[seed] = true;
    while let Some(pixel) = queue.pop_front() {
        area.push(pixel);
        let (row, column) = (pixel / width, pixel % width);
        for r in row.saturating_sub(1)..=(row + 1).min(height - 1) {
            for c in column.saturating_sub(1)..=(column + 1).min(width - 1) {
                let other = r * width + c;
                if odd[other] && !visited[other] {
                    visited[other] = true;
                    queue.push_back(other);
                }
            }
        }
    }
    area
}

fn describe(
    layers: &Layers,
    usual: &[Option<(f64, f64)>],
    area: &[usize],
    place_mm: &dyn Fn(usize) -> [f64; 2],
    pixel_mm: [f64; 2],
) -> Defect {
    let places: Vec<[f64; 2]> = area.iter().map(|p| place_mm(*p)).collect();
    let mean = |k: usize| places.iter().map(|p| p[k]).sum::<f64>() / places.len() as f64;
    let extent = |k: usize| {
        let (low, high) = places
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| {
                (l.min(p[k]), h.max(p[k]))
            });
        high - low + pixel_mm[k]
    };
    let of_area = |k: usize| {
        robust::median_of_finite(
            area.iter()
                .map(|p| f64::from(layers.parameters[k].values[*p])),
        )
    };
    let deviations: Vec<Deviation> = COMPARED
        .iter()
        .filter_map(|k| {
            let (centre, spread) = usual[*k]?;
            let value = of_area(*k);
            Some(Deviation {
                parameter: layers.parameters[*k].name,
                value,
                usual: centre,
                sigmas: value
                    .filter(|_| spread > 0.0)
                    .map(|v| (v - centre) / spread),
            })
        })
        .collect();
    let misfits = area
        .iter()
        .filter(|p| layers.flags[**p] & MISFIT != 0)
        .count();
    let worst = deviations
        .iter()
        .max_by(|a, b| {
            let size = |d: &Deviation| d.sigmas.unwrap_or(0.0).abs();
            size(a).total_cmp(&size(b))
        })
        .map_or("fit", |d| d.parameter);
    Defect {
        x_mm: mean(0),
        y_mm: mean(1),
        width_mm: extent(0),
        height_mm: extent(1),
        area_mm2: area.len() as f64 * pixel_mm[0] * pixel_mm[1],
        pixels: area.len(),
        worst: if misfits * 2 > area.len() {
            "fit"
        } else {
            worst
        },
        deviations,
        lean_azimuth_deg: median_direction(
            area.iter()
                .map(|p| f64::from(layers.parameters[1].values[*p])),
        ),
    }
}

/// Returns the median of azimuths in degrees, computed relative to their mean direction.
fn median_direction(azimuths: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let finite = azimuths.filter(|a| a.is_finite());
    let (sin, cos) = finite.clone().fold((0.0, 0.0), |(sin, cos), azimuth| {
        let (s, c) = azimuth.to_radians().sin_cos();
        (sin + s, cos + c)
    });
    let mean = f64::atan2(sin, cos).to_degrees();
    let off = robust::median_of_finite(finite.map(|azimuth| apart_deg(azimuth, mean)))?;
    Some(apart_deg(mean + off, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 60 × 40 pixels: the left half leans to 179.9°, the right half to 90°, with a patch of 4° at (45, 20).
    fn two_halves() -> Layers {
        let mut layers = Layers::new(60, 40, false);
        for pixel in 0..60 * 40 {
            let (row, column) = (pixel / 60, pixel % 60);
            let wobble = ((pixel * 7919) % 101) as f32 / 101.0 - 0.5;
            let patch = (15..25).contains(&row) && (40..50).contains(&column);
            layers.flags[pixel] = 0;
            let theta = if patch { 4.0 } else { 10.0 } + 0.2 * wobble;
            let lean = if column < 30 {
                apart_deg(179.9 + f64::from(wobble), 0.0) as f32
            } else {
                90.0 + wobble
            };
            let values = [
                theta,
                lean,
                0.12 + 0.01 * wobble,
                0.12 - 0.01 * wobble,
                0.34 + 0.02 * wobble,
            ];
            for (k, v) in values.into_iter().enumerate() {
                layers.parameters[k].values[pixel] = v;
                layers.parameters[k].std[pixel] = 0.01;
            }
        }
        layers
    }

    #[test]
    fn two_lean_directions_their_border_and_a_worn_patch_are_found() {
        let mut layers = two_halves();
        let found = leans(&layers);
        assert_eq!(found.len(), 2);
        let mut azimuths: Vec<f64> = found.iter().map(|l| l.azimuth_deg).collect();
        azimuths.sort_by(f64::total_cmp);
        // Means over ± 0.5° of scatter.
        assert!(
            (azimuths[0] - 90.0).abs() < 0.1 && (azimuths[1] - 179.9).abs() < 0.1,
            "{azimuths:?}"
        );

        mark_borders(&mut layers, &found);
        for column in 0..60 {
            let border = layers.flags[10 * 60 + column] & BORDER != 0;
            assert_eq!(border, (28..32).contains(&column), "{column}");
        }

        let place = |p: usize| [(p % 60) as f64 * 0.2, (p / 60) as f64 * 0.2];
        let list = defects(&mut layers, &found, &place, [0.2, 0.2]);
        assert_eq!(list.len(), 1);
        let worn = &list[0];
        assert_eq!((worn.pixels, worn.worst), (100, "theta_r_deg"));
        assert!((worn.x_mm - 44.5 * 0.2).abs() < 1e-9 && (worn.y_mm - 19.5 * 0.2).abs() < 1e-9);
        assert!((worn.width_mm - 2.0).abs() < 1e-9 && (worn.area_mm2 - 4.0).abs() < 1e-9);
        let theta = &worn.deviations[0];
        assert!((theta.value.unwrap() - 4.0).abs() < 0.1 && (theta.usual - 10.0).abs() < 0.1);
    }

    #[test]
    fn directions_around_half_a_turn_have_their_median_there() {
        let around = |middle: f64| [-3.0, -0.2, 0.1, 0.3].map(|off| apart_deg(middle + off, 0.0));
        for (middle, said) in [(180.0, 179.95), (0.0, -0.05), (-90.0, -90.05)] {
            let found = median_direction(around(middle).into_iter().chain([f64::NAN])).unwrap();
            assert!((found - said).abs() < 1e-9, "{middle}: {found}");
        }
        assert_eq!(median_direction([f64::NAN].into_iter()), None);
    }

    #[test]
    fn a_map_without_defects_lists_none() {
        let mut layers = two_halves();
        for pixel in 0..2400 {
            let t = &mut layers.parameters[0].values[pixel];
            if *t < 8.0 {
                *t += 6.0;
            }
        }
        let found = leans(&layers);
        mark_borders(&mut layers, &found);
        assert!(defects(&mut layers, &found, &|_| [0.0, 0.0], [0.2, 0.2]).is_empty());
    }
}
