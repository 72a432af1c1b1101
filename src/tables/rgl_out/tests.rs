//! The file is read back as a renderer reads it, by a reader of its own.

use std::collections::BTreeMap;

use super::*;
use crate::geometry::Cones;
use crate::model::extended::Real;
use crate::model::{Optics, Surface, Variant};

/// An array of the file with the lengths of its dimensions.
struct Read {
    shape: Vec<usize>,
    numbers: Vec<f32>,
}

/// Reads the arrays of single-precision numbers.
fn arrays(file: &[u8]) -> BTreeMap<String, Read> {
    let mut at = 14;
    let mut take = |n: usize| {
        at += n;
        &file[at - n..at]
    };
    let number = |bytes: &[u8]| {
        bytes
            .iter()
            .rev()
            .fold(0, |sum, byte| sum << 8 | usize::from(*byte))
    };
    let n_arrays = number(take(4));
    let mut found = BTreeMap::new();
    for _ in 0..n_arrays {
        let length = number(take(2));
        let name = String::from_utf8(take(length).to_vec()).unwrap();
        let dimensions = number(take(2));
        let kind = take(1)[0];
        let start = number(take(8));
        let shape: Vec<usize> = (0..dimensions).map(|_| number(take(8))).collect();
        if kind != 10 {
            continue;
        }
        let bytes = &file[start..start + 4 * shape.iter().product::<usize>()];
        let numbers = bytes
            .chunks(4)
            .map(|x| f32::from_le_bytes(x.try_into().unwrap()));
        let numbers = numbers.collect();
        found.insert(name, Read { shape, numbers });
    }
    found
}

/// A reader of the file, by the description of the format.
struct Reader {
    arrays: BTreeMap<String, Read>,
    vndf: Grid,
    ndf: Grid,
    sigma: Grid,
}

impl Reader {
    fn open(file: &[u8]) -> Self {
        let arrays = arrays(file);
        let [vndf, ndf, sigma] =
            ["vndf", "ndf", "sigma"].map(|name| Reader::grid(&arrays[name], 0));
        Reader {
            arrays,
            vndf,
            ndf,
            sigma,
        }
    }

    /// Returns one of the planes of an array.
    fn grid(read: &Read, plane: usize) -> Grid {
        let [rows, columns] = read.shape[read.shape.len() - 2..] else {
            panic!("an array has no planes");
        };
        let numbers = &read.numbers[plane * rows * columns..(plane + 1) * rows * columns];
        Grid {
            size: [columns, rows],
            values: numbers.iter().map(|x| f64::from(*x)).collect(),
        }
    }

    /// Returns the uniform numbers that the density maps to a place.
    fn uniform(&self, place: [f64; 2]) -> [f64; 2] {
        let [columns, rows] = self.vndf.size;
        let value = |column: usize, row: usize| self.vndf.values[row * columns + column];
        let row_sum = |row: usize| -> f64 {
            (1..columns)
                .map(|c| 0.5 * (value(c - 1, row) + value(c, row)))
                .sum()
        };
        let split = |x: f64, n: usize| {
            let cell = ((x * (n - 1) as f64) as usize).min(n - 2);
            (cell, x * (n - 1) as f64 - cell as f64)
        };
        let ((column, x), (row, y)) = (split(place[0], columns), split(place[1], rows));
        let part = |t: f64, a: f64, b: f64| t * (a + 0.5 * t * (b - a));
        let of_row = |c: usize| value(c, row) * (1.0 - y) + value(c, row + 1) * y;
        let before: f64 = (0..column).map(|c| 0.5 * (of_row(c) + of_row(c + 1))).sum();
        let (low, high) = (row_sum(row), row_sum(row + 1));
        let sums: Vec<f64> = (0..rows).map(row_sum).collect();
        let cells: Vec<f64> = sums.windows(2).map(|p| 0.5 * (p[0] + p[1])).collect();
        let below: f64 = cells[..row].iter().sum();
        [
            (before + part(x, of_row(column), of_row(column + 1))) / (low * (1.0 - y) + high * y),
            (below + part(y, low, high)) / cells.iter().sum::<f64>(),
        ]
    }

    /// Returns f cos θo.
    fn value(&self, directions: &Directions) -> f64 {
        let (i, o) = (directions.incident, directions.outgoing);
        let half = (i + o).normalize();
        let place = |w: Vector3<f64>| {
            [
                of_zenith(w.z.min(1.0).acos()),
                (w.y.atan2(w.x) + PI) / (2.0 * PI),
            ]
        };
        let uniform = self.uniform(place(half));
        let split = |name: &str, x: f64| {
            let nodes = &self.arrays[name].numbers;
            let after = nodes
                .iter()
                .position(|node| f64::from(*node) >= x)
                .unwrap_or(nodes.len() - 1);
            let k = after.clamp(1, nodes.len() - 1) - 1;
            let (a, b) = (f64::from(nodes[k]), f64::from(nodes[k + 1]));
            (k, ((x - a) / (b - a)).clamp(0.0, 1.0))
        };
        let (phi, at_phi) = split("phi_i", i.y.atan2(i.x));
        let (theta, at_theta) = split("theta_i", i.z.min(1.0).acos());
        let zeniths = self.arrays["theta_i"].numbers.len();
        let mut spectra = 0.0;
        for (step, share) in [(0, 1.0 - at_phi), (1, at_phi)] {
            for (up, part) in [(0, 1.0 - at_theta), (1, at_theta)] {
                let plane = (phi + step) * zeniths + theta + up;
                let grid = Reader::grid(&self.arrays["spectra"], plane);
                spectra += share * part * grid.at(uniform);
            }
        }
        spectra * self.ndf.at(place(half)) / (4.0 * self.sigma.at(place(i)))
    }
}

fn surface(theta_r_deg: f64, alpha: f64, rho_d: f64) -> Surface {
    Surface {
        theta_r: theta_r_deg.to_radians(),
        alpha_u: alpha,
        alpha_v: 1.2 * alpha,
        rho_d,
        amplitude: 1.0,
    }
}

fn optics(eta: f64, k: f64) -> Optics {
    Optics {
        eta,
        k,
        theta_l: 0.17,
        cones: Cones::NONE,
    }
}

/// Returns the k-th of evenly spread points in the four-dimensional unit cube.
fn spread(k: usize) -> [f64; 4] {
    // Powers of the root of x⁵ = x + 1 spread evenly.
    [0.856_675_9, 0.733_891_9, 0.628_708_7, 0.538_597_7].map(|step| (0.5 + k as f64 * step).fract())
}

fn direction(cos: f64, turn: f64) -> Vector3<f64> {
    let (sin, cos_phi) = ((1.0 - cos * cos).sqrt(), (2.0 * PI * turn).cos());
    Vector3::new(sin * cos_phi, sin * (2.0 * PI * turn).sin(), cos)
}

/// Returns the root mean square error of f cos θo in directions that have no node, over the peak at this incidence: half of
/// the pairs are about the facets' mirror direction.
fn error(brdf: &SurfaceBrdf, reader: &Reader) -> f64 {
    let common = Common::new(brdf);
    let (mut sum, mut n) = (0.0, 0);
    for k in 0..500 {
        let u = spread(k);
        // Up to 60° of incidence.
        let incident = direction(1.0 - 0.5 * u[0], u[1]);
        let half = vector(common.vndf.place([u[2], u[3]]));
        let outgoing = match k % 2 {
            0 => half * (2.0 * half.dot(&incident)) - incident,
            _ => direction(1.0 - u[2] * 0.9, u[3]),
        };
        if outgoing.z < 0.05 {
            continue;
        }
        let directions = Directions { incident, outgoing };
        let truth = brdf.value(&directions) * outgoing.z;
        let nodes = common.nodes.iter().step_by(7);
        let values = nodes.map(|node| common.value(brdf, incident, node).0);
        let peak = values.fold(truth, f64::max);
        let error = (reader.value(&directions) - truth) / peak;
        sum += error * error;
        n += 1;
    }
    assert!(n > 300, "{n}");
    (sum / f64::from(n)).sqrt()
}

#[test]
fn a_reader_gets_the_values_of_the_surface_back_and_every_density_is_positive() {
    let lands = Real {
        land: 0.2,
        ..Real::NONE
    };
    for (name, surface, real, optics) in [
        ("polymer", surface(15.0, 0.1, 0.3), None, optics(1.54, 0.0)),
        ("metal", surface(12.0, 0.1, 0.0), None, optics(1.4, 7.6)),
        (
            "polymer with lands",
            surface(15.0, 0.1, 0.3),
            Some(lands),
            optics(1.54, 0.0),
        ),
    ] {
        let brdf = SurfaceBrdf::new(Variant::Sawtooth, surface, real, &optics);
        let reader = Reader::open(&file(&brdf, 550.0, "a test"));
        let rms = error(&brdf, &reader);
        println!("{name}: {rms:.5}");
        assert!(rms < 0.01, "{name}: {rms}");
        for density in ["vndf", "luminance", "ndf", "sigma"] {
            let numbers = &reader.arrays[density].numbers;
            let valid = numbers.iter().all(|x| *x > 0.0 && x.is_finite());
            assert!(valid, "{name} {density}");
        }
        let spectra = &reader.arrays["spectra"];
        assert!(spectra.numbers.iter().all(|x| *x >= 0.0 && x.is_finite()));
        assert_eq!(spectra.shape, [AZIMUTHS, ZENITHS, 1, NODES, NODES]);
        let phi = &reader.arrays["phi_i"].numbers;
        let turn = f64::from(phi[phi.len() - 1] - phi[0]);
        assert!((turn - 2.0 * PI).abs() < 1e-6, "{name} {turn}");
    }
}

#[test]
fn at_the_nodes_of_the_file_nothing_is_lost() {
    let surface = surface(12.0, 0.08, 0.3);
    let brdf = SurfaceBrdf::new(Variant::Paper, surface, None, &optics(1.54, 0.0));
    let bytes = file(&brdf, 550.0, "a test");
    let (reader, common) = (Reader::open(&bytes), Common::new(&brdf));
    let (zeniths, azimuths) = (&reader.arrays["theta_i"], &reader.arrays["phi_i"]);
    let mut compared = 0;
    for (theta, phi) in [(3, 5), (7, 20), (10, 30)] {
        let (theta, phi) = (
            f64::from(zeniths.numbers[theta]),
            f64::from(azimuths.numbers[phi]),
        );
        let incident = direction(theta.cos(), phi / (2.0 * PI));
        for node in common.nodes.iter().step_by(37) {
            let outgoing = node.half * (2.0 * node.half.dot(&incident)) - incident;
            if outgoing.z < 0.05 {
                continue;
            }
            let directions = Directions { incident, outgoing };
            let (truth, found) = (
                brdf.value(&directions) * outgoing.z,
                reader.value(&directions),
            );
            assert!(
                (found - truth).abs() <= 2e-4 * truth + 1e-6,
                "{found} {truth}"
            );
            compared += 1;
        }
    }
    assert!(compared > 30, "{compared}");
}
