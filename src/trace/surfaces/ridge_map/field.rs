//! The direction and length of the ridges in a map, from their strongest wave.

use nalgebra::{Matrix3, Vector3};

use super::lines::{RidgeLine, RidgeLines};
use crate::trace::rng::{Purpose, RandomStream};

/// Largest side of a window in which waves are searched, in pixels.
const WINDOW: usize = 96;
/// Smallest side of a window, in pixels.
const SIDE_MIN: usize = 8;
/// Waves with fewer periods than this within their window are its tilt and bow.
const PERIODS_MIN: f64 = 2.0;
/// Number of positions at which a direction is tested.
const POINTS: usize = 6_000;
/// Largest number of heights used to refine a direction.
const LOOKED_AT: usize = 1 << 20;
/// Width of a fine line, in samples.
const FINE: f64 = 0.25;
/// Least shear of the ridges against rows or columns over the map for such lines, in samples.
const CROSSED: f64 = 4.0;
/// Number of rotations tried to either side, and their spacing in samples over the ridges' length.
const TURNS: i32 = 12;
const TURN_STEP: f64 = 0.25;
/// Number of overtones used to refine a wave.
const OVERTONES: usize = 6;
/// A line across the ridges counts if its length is at least this fraction of the longest lines.
const LINE_MIN: f64 = 0.3;

/// Heights with their positions.
pub(super) struct SampledHeights<'a> {
    pub columns: usize,
    pub rows: usize,
    pub pitch: [f64; 2],
    /// Heights in µm, the plane subtracted, row by row, without gaps.
    pub heights: &'a [f64],
    /// The points that were not measured; empty if all were.
    pub unseen: &'a [bool],
}

/// Subtracts the least-squares plane.
pub(super) fn take_off_plane(heights: &mut [f64], columns: usize, pitch: [f64; 2]) {
    let rows = heights.len() / columns;
    let centre = [0.5 * (columns - 1) as f64, 0.5 * (rows - 1) as f64];
    let place = |n: usize| {
        Vector3::new(
            1.0,
            ((n % columns) as f64 - centre[0]) * pitch[0],
            ((n / columns) as f64 - centre[1]) * pitch[1],
        )
    };
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (n, h) in heights.iter().enumerate() {
        let p = place(n);
        normal += p * p.transpose();
        right += p * *h;
    }
    let Some(inverse) = normal.try_inverse() else {
        return;
    };
    let plane = inverse * right;
    for (n, h) in heights.iter_mut().enumerate() {
        *h -= plane.dot(&place(n));
    }
}

/// Spatial frequency, 1/µm along u and v.
pub(super) type Wave = [f64; 2];

impl SampledHeights<'_> {
    /// The strongest wave of each of several windows about the centre, from windows of single
    /// heights to windows of block means that span the map.
    pub fn strongest_waves(&self) -> Vec<Wave> {
        let longest = self.columns.max(self.rows);
        let mut block = 1;
        let mut waves = Vec::new();
        loop {
            waves.extend(self.strongest_wave(block));
            if block * WINDOW >= longest {
                return waves;
            }
            block *= 2;
        }
    }

    /// The wave with the largest variance in a window of means over `block` × `block` heights.
    fn strongest_wave(&self, block: usize) -> Option<Wave> {
        // Along the short side of a strip smaller blocks are used, so that the window has enough of
        // them.
        let [bx, by] = [self.columns, self.rows].map(|n| block.min((n / SIDE_MIN).max(1)));
        let (nx, ny) = (
            (self.columns / bx).min(WINDOW),
            (self.rows / by).min(WINDOW),
        );
        if nx < SIDE_MIN || ny < SIDE_MIN {
            return None;
        }
        let (x0, y0) = ((self.columns - nx * bx) / 2, (self.rows - ny * by) / 2);
        let hann =
            |n: usize, of: usize| (std::f64::consts::PI * (n as f64 + 0.5) / of as f64).sin();
        let mut means = vec![0.0; nx * ny];
        for (n, mean) in means.iter_mut().enumerate() {
            let (column, row) = (x0 + n % nx * bx, y0 + n / nx * by);
            let cells = (row..row + by).flat_map(|r| (column..column + bx).map(move |c| (r, c)));
            *mean = cells
                .map(|(r, c)| self.heights[r * self.columns + c])
                .sum::<f64>();
        }
        let middle = means.iter().sum::<f64>() / means.len() as f64;
        for (n, mean) in means.iter_mut().enumerate() {
            *mean = (*mean - middle) * (hann(n % nx, nx) * hann(n / nx, ny)).powi(2);
        }
        // First by rows: (wave along u, row) → (re, im).
        let turn = |k: f64, n: usize, of: usize| {
            (-std::f64::consts::TAU * k * n as f64 / of as f64).sin_cos()
        };
        let half = nx / 2;
        let mut by_row = vec![(0.0, 0.0); (half + 1) * ny];
        for (n, sum) in by_row.iter_mut().enumerate() {
            let (k, row) = ((n / ny) as f64, n % ny);
            for column in 0..nx {
                let (s, c) = turn(k, column, nx);
                let h = means[row * nx + column];
                *sum = (sum.0 + h * c, sum.1 + h * s);
            }
        }
        let mut best: Option<(f64, Wave)> = None;
        for kx in 0..=half {
            for ky in -(ny as i64 / 2)..=(ny as i64 / 2) {
                let (x, y) = (kx as f64, ky as f64);
                if x.hypot(y) < PERIODS_MIN || (kx == 0 && ky < 0) {
                    continue;
                }
                let (mut re, mut im) = (0.0, 0.0);
                for row in 0..ny {
                    let (s, c) = turn(y, row, ny);
                    let (a, b) = by_row[kx * ny + row];
                    re += a * c - b * s;
                    im += a * s + b * c;
                }
                let power = re * re + im * im;
                if best.is_none_or(|(most, _)| power > most) {
                    let wave = [
                        x / ((nx * bx) as f64 * self.pitch[0]),
                        y / ((ny * by) as f64 * self.pitch[1]),
                    ];
                    best = Some((power, wave));
                }
            }
        }
        best.map(|(_, wave)| wave)
    }

    /// Refines a wave to a small fraction of a period over the whole map, in growing windows and
    /// then by its overtones; also returns its power.
    pub fn sharpened(&self, wave: Wave) -> (Wave, f64) {
        let size = [
            self.columns as f64 * self.pitch[0],
            self.rows as f64 * self.pitch[1],
        ];
        let period = 1.0 / wave[0].hypot(wave[1]);
        let whole = size[0].max(size[1]);
        let mut wave = wave;
        let mut window = (6.0 * period).min(whole);
        loop {
            let points = self.places(window);
            let steps = size.map(|s| 0.6 / window.min(s));
            let (nearer, power) = climb(&points, wave, steps, 1);
            wave = nearer;
            if window >= whole {
                let steps = size.map(|s| 0.1 / s);
                return (climb(&points, wave, steps, OVERTONES).0, power);
            }
            window = (2.0 * window).min(whole);
        }
    }

    /// Whether two waves are the same: nowhere in the map a tenth of a period apart.
    pub fn is_one(&self, a: Wave, b: Wave) -> bool {
        let across =
            |side: usize, count: usize| (a[side] - b[side]).abs() * count as f64 * self.pitch[side];
        across(0, self.columns) + across(1, self.rows) < 0.1
    }

    /// Random positions in a window about the centre: x, y and weighted height.
    fn places(&self, window: f64) -> Vec<[f64; 3]> {
        let mut random = RandomStream::new(1, Purpose::Surface, 0);
        let counts = [
            ((window / self.pitch[0]) as usize).clamp(1, self.columns),
            ((window / self.pitch[1]) as usize).clamp(1, self.rows),
        ];
        let starts = [(self.columns - counts[0]) / 2, (self.rows - counts[1]) / 2];
        (0..POINTS)
            .map(|_| {
                let column = (random.uniform() * counts[0] as f64) as usize;
                let row = (random.uniform() * counts[1] as f64) as usize;
                let weight = |n: usize, of: usize| {
                    (std::f64::consts::PI * (n as f64 + 0.5) / of as f64)
                        .sin()
                        .powi(2)
                };
                let height = self.heights[(starts[1] + row) * self.columns + starts[0] + column];
                [
                    (starts[0] + column) as f64 * self.pitch[0],
                    (starts[1] + row) as f64 * self.pitch[1],
                    height * weight(column, counts[0]) * weight(row, counts[1]),
                ]
            })
            .collect()
    }

    /// Rotates a wave so that the means along its ridges explain the most variance: random
    /// positions leave an error of about a sample over the ridges' length in the map. The samples
    /// cause local maxima, so all rotations within a few samples are tried before the best one is
    /// refined.
    pub fn aligned(&self, wave: Wave) -> Wave {
        let turned = |by: f64| {
            let (s, c) = by.sin_cos();
            [wave[0] * c - wave[1] * s, wave[0] * s + wave[1] * c]
        };
        let explained = |by: f64, stride: usize| self.lines(turned(by), stride).explained;
        let (scan, refine) = (self.stride(LOOKED_AT / 4), self.stride(LOOKED_AT));
        // A rotation by this shears the ends of a ridge by one sample.
        let sample = self.sample(wave) / self.along(wave);
        let tried = (-TURNS..=TURNS).map(|n| TURN_STEP * f64::from(n) * sample);
        let scanned = tried.map(|by| (by, explained(by, scan)));
        let at = scanned
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map_or(0.0, |t| t.0);
        let (mut at, mut best, mut step) = (at, explained(at, refine), 0.5 * TURN_STEP * sample);
        while step > 0.005 * sample {
            let (left, right) = (explained(at - step, refine), explained(at + step, refine));
            if left.max(right) > best {
                at += if left > right { -step } else { step };
                best = left.max(right);
            } else {
                step *= 0.5;
            }
        }
        turned(at)
    }

    /// A stride by which about `most` heights are visited, without visiting only whole columns.
    fn stride(&self, most: usize) -> usize {
        let mut stride = self.heights.len().div_ceil(most);
        while stride > 1 && gcd(stride, self.columns) > 1 {
            stride += 1;
        }
        stride
    }

    /// Width of a sample across the ridges of a wave: the pitch in that direction, µm.
    fn sample(&self, wave: Wave) -> f64 {
        let f = wave[0].hypot(wave[1]);
        (wave[0].abs() * self.pitch[0] + wave[1].abs() * self.pitch[1]) / f
    }

    /// Length of a ridge of a wave within the map, µm.
    fn along(&self, wave: Wave) -> f64 {
        let f = wave[0].hypot(wave[1]);
        let [width, height] = [
            self.columns as f64 * self.pitch[0],
            self.rows as f64 * self.pitch[1],
        ];
        (width * f / wave[1].abs()).min(height * f / wave[0].abs())
    }

    /// Shear of the ridges of a wave against rows or columns over their length in the map, in
    /// samples.
    fn sheared(&self, wave: Wave) -> f64 {
        let f = wave[0].hypot(wave[1]);
        let lean = (wave[0].abs()).min(wave[1].abs()) / f;
        lean * self.along(wave) / self.sample(wave)
    }

    /// Means along the ridges of a wave, from one in `stride` heights.
    pub fn lines(&self, wave: Wave, stride: usize) -> RidgeLines {
        self.lines_as_wide(wave, stride, 1.0)
    }

    /// As `lines`, with the finest width that the shear of the ridges allows: corners are then
    /// blurred by only a fraction of a sample. With too little shear, adjacent lines would come
    /// from different rows, and errors of their direction would become steps between them; lines
    /// are then one sample wide.
    pub fn fine_lines(&self, wave: Wave) -> RidgeLines {
        let share = match self.sheared(wave) < CROSSED {
            true => 1.0,
            false => FINE,
        };
        self.lines_as_wide(wave, 1, share)
    }

    /// Lines whose width is this fraction of a sample's.
    fn lines_as_wide(&self, wave: Wave, stride: usize, share: f64) -> RidgeLines {
        let bins = Bins::of(self, wave, share * self.sample(wave));
        let is_seen = |n: usize| self.unseen.get(n).is_none_or(|unseen| !unseen);
        let points = || self.heights.iter().enumerate().step_by(stride);
        let mut sums = vec![LineSum::default(); bins.count];
        for (n, h) in points() {
            let across = bins.place(self, n).0;
            sums[bins.line(across)].add(across, is_seen(n).then_some(*h));
        }
        let longest = sums.iter().map(|sum| sum.points).fold(0.0, f64::max);
        // Close to the rim lines are short; of the others, enough points must be measured.
        let belongs = |sum: &LineSum| sum.points >= LINE_MIN * longest;
        let is_kept: Vec<bool> = sums
            .iter()
            .map(|sum| belongs(sum) && sum.seen > 0.0 && sum.seen >= LINE_MIN * sum.points)
            .collect();
        let holes: Vec<f64> = (0..bins.count)
            .filter(|n| belongs(&sums[*n]) && !is_kept[*n] && sums[*n].points > 0.0)
            .map(|n| bins.first + (n as f64 + 0.5) * bins.width)
            .collect();
        let steepness = steepness(&sums, &is_kept);
        // A tilt of the map along its ridges is not unevenness.
        let (mut squares, mut slope) = ([0.0; 2], [0.0; 3]);
        let mut used = 0.0;
        let mut uneven = vec![0.0; bins.count];
        for (n, h) in points().filter(|(n, _)| is_seen(*n)) {
            let (across, along) = bins.place(self, n);
            let number = bins.line(across);
            let sum = &sums[number];
            if is_kept[number] {
                let rest = h - sum.height() - steepness[number] * (across - sum.centre());
                squares = [squares[0] + h * h, squares[1] + rest * rest];
                uneven[number] += rest * rest;
                slope = [
                    slope[0] + along * rest,
                    slope[1] + along * along,
                    slope[2] + along,
                ];
                used += 1.0;
            }
        }
        let spread = slope[1] - slope[2] * slope[2] / used;
        let askew = if spread > 0.0 {
            slope[0] * slope[0] / spread
        } else {
            0.0
        };
        let lines: Vec<RidgeLine> = sums
            .iter()
            .zip(&is_kept)
            .filter(|(_, is_kept)| **is_kept)
            .map(|(sum, _)| RidgeLine {
                v: sum.centre(),
                z: sum.height(),
                count: sum.seen,
            })
            .collect();
        // A mean removes its own share of the noise.
        let freedom = (used - lines.len() as f64).max(1.0);
        let rest = (squares[1] - askew).max(0.0) / freedom;
        // If a riser crosses a line, its height is not unevenness, so the median line is used.
        let of_lines = sums.iter().zip(&uneven).zip(&is_kept);
        let mut of_lines: Vec<f64> = of_lines
            .filter(|((sum, _), is_kept)| **is_kept && sum.seen > 1.0)
            .map(|((sum, square), _)| square / (sum.seen - 1.0))
            .collect();
        of_lines.sort_by(f64::total_cmp);
        let typical = of_lines.get(of_lines.len() / 2).copied().unwrap_or(rest);
        let unevenness = (typical - askew / used).max(0.0).sqrt();
        RidgeLines {
            width: bins.width,
            explained: 1.0 - rest * used / squares[0],
            unevenness,
            sample: self.sample(wave),
            holes,
            lines,
        }
    }
}

/// Lines along the ridges into which the points of a map are sorted.
struct Bins {
    /// Direction across the ridges.
    across: [f64; 2],
    /// Where the first line begins, m.
    first: f64,
    /// Width of a line, m.
    width: f64,
    count: usize,
}

impl Bins {
    fn of(field: &SampledHeights<'_>, wave: Wave, width: f64) -> Bins {
        let f = wave[0].hypot(wave[1]);
        let mut bins = Bins {
            across: [wave[0] / f, wave[1] / f],
            first: 0.0,
            width,
            count: 0,
        };
        let corners = [
            0,
            field.columns - 1,
            field.heights.len() - field.columns,
            field.heights.len() - 1,
        ]
        .map(|n| bins.place(field, n).0);
        bins.first = corners.into_iter().fold(f64::INFINITY, f64::min) - 0.5 * width;
        let last = corners.into_iter().fold(f64::NEG_INFINITY, f64::max);
        bins.count = ((last - bins.first) / width) as usize + 1;
        bins
    }

    /// Returns the place of a point across and along the ridges, m.
    fn place(&self, field: &SampledHeights<'_>, n: usize) -> (f64, f64) {
        let (x, y) = (
            (n % field.columns) as f64 * field.pitch[0],
            (n / field.columns) as f64 * field.pitch[1],
        );
        let [c, s] = self.across;
        (x * c + y * s, y * c - x * s)
    }

    fn line(&self, across: f64) -> usize {
        (((across - self.first) / self.width) as usize).min(self.count - 1)
    }
}

/// Sums over the points of a line.
#[derive(Clone, Default)]
struct LineSum {
    /// Points of the map, measured or not.
    points: f64,
    /// Points that were measured.
    seen: f64,
    /// Sum of their places across the ridges, m.
    across: f64,
    /// Sum of their heights, m.
    heights: f64,
}

impl LineSum {
    fn add(&mut self, across: f64, height: Option<f64>) {
        self.points += 1.0;
        if let Some(height) = height {
            self.seen += 1.0;
            self.across += across;
            self.heights += height;
        }
    }

    /// Mean place across the ridges, m.
    fn centre(&self) -> f64 {
        self.across / self.seen
    }

    /// Mean height, m.
    fn height(&self) -> f64 {
        self.heights / self.seen
    }
}

/// Returns the slope of each line across the ridges, which is that between its neighbours; 0 where one of them is not kept.
fn steepness(sums: &[LineSum], is_kept: &[bool]) -> Vec<f64> {
    (0..sums.len())
        .map(|n| {
            let (before, after) = (n.saturating_sub(1), (n + 1).min(sums.len() - 1));
            let (a, b) = (&sums[before], &sums[after]);
            let apart = b.centre() - a.centre();
            if is_kept[before] && is_kept[after] && apart > 0.0 {
                (b.height() - a.height()) / apart
            } else {
                0.0
            }
        })
        .collect()
}

/// The greatest common divisor.
fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Climbs to the wave whose first overtones together are strongest; also returns their power.
fn climb(points: &[[f64; 3]], start: Wave, steps: [f64; 2], overtones: usize) -> (Wave, f64) {
    let power = |wave: Wave| -> f64 {
        let mut sums = [(0.0, 0.0); OVERTONES];
        for [x, y, h] in points {
            let (s, c) = (std::f64::consts::TAU * (wave[0] * x + wave[1] * y)).sin_cos();
            let (mut re, mut im) = (c, s);
            for sum in &mut sums[..overtones] {
                *sum = (sum.0 + h * re, sum.1 + h * im);
                (re, im) = (re * c - im * s, re * s + im * c);
            }
        }
        sums[..overtones].iter().map(|(a, b)| a * a + b * b).sum()
    };
    let (mut at, mut best) = (start, power(start));
    let mut scale = 1.0;
    while scale > 2e-3 {
        let mut moved = false;
        for [dx, dy] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] {
            let to = [at[0] + dx * scale * steps[0], at[1] + dy * scale * steps[1]];
            let there = power(to);
            if there > best {
                (at, best, moved) = (to, there, true);
            }
        }
        if !moved {
            scale *= 0.5;
        }
    }
    (at, best)
}
