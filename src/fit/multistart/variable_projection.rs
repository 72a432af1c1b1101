//! Variable projection: the amplitudes of the signals are solved for instead of searched.
//!
//! ```text
//! signal = g · [single reflections + ρd · diffuse light] + B
//! ```
//!
//! This is linear in (g, g·ρd, B), except for light that travels from wall to wall more than once. For every shape
//! (ridge angle, roughnesses, zeros of the stages) the best amplitudes are therefore a small linear least-squares
//! problem with 0 ≤ g·ρd ≤ g (Golub and Pereyra 1973), and a start needs no estimate of the brightness. [`settle`]
//! computes the amplitudes of one shape.
//!
//! *Conditioning.* The columns of the amplitudes (single reflections, diffuse light, background) are nearly parallel if
//! a lobe is broad: a background and a Lambertian differ by a cosine over the tilts. They are solved for by QR. A
//! column that the others nearly produce may get an inaccurate amplitude, but the cost, by which starts are compared,
//! keeps its digits.

use crate::fit::least_squares::levenberg_marquardt::Bounds;
use crate::fit::least_squares::{LeastSquares, householder, solve_upper, sum_of_squares};
use crate::fit::problem::{Problem, Quantity, Values};

/// Diffuse reflectance for the linearisation of the diffuse light if none is stated.
const MIDDLE: f64 = 0.3;

/// Positions of the amplitudes among the free quantities.
#[derive(Debug, Clone, Copy)]
struct Amplitudes {
    scale: Option<usize>,
    rho_d: Option<usize>,
    background: Option<usize>,
    scale_max: f64,
    rho_d_range: (f64, f64),
}

impl Amplitudes {
    fn of(problem: &Problem<'_>, bounds: &Bounds) -> Self {
        let scale = problem.column(Quantity::Scale);
        let rho_d = problem.column(Quantity::RhoD);
        Amplitudes {
            scale,
            rho_d,
            background: problem.column(Quantity::Background),
            scale_max: scale.map_or(f64::INFINITY, |k| bounds.upper[k]),
            rho_d_range: rho_d.map_or((0.0, 0.0), |k| (bounds.lower[k], bounds.upper[k])),
        }
    }

    /// Writes the best amplitudes to `x`, given residuals `r` and derivatives `j` there. Returns the cost that the
    /// linear problem predicts; infinite if no positive gain within its bounds fits.
    fn solve(&self, x: &mut [f64], r: &[f64], j: &[f64]) -> f64 {
        let m = r.len();
        let column = |k: usize| &j[k * m..(k + 1) * m];
        let background = self.background.map(|k| column(k).to_vec());
        // Parts of the signal at gain 1: independent of ρd, and proportional to it.
        let (gain, rho_d) = (
            self.scale.map_or(1.0, |k| x[k]),
            self.rho_d.map_or(0.0, |k| x[k]),
        );
        let diffuse = self.rho_d.map(|k| -> Vec<f64> {
            let share = if self.scale.is_some() { gain } else { 1.0 };
            column(k).iter().map(|c| c / share).collect()
        });
        let single = self.scale.map(|k| -> Vec<f64> {
            match &diffuse {
                Some(d) => column(k)
                    .iter()
                    .zip(d)
                    .map(|(c, d)| c - rho_d * d)
                    .collect(),
                None => column(k).to_vec(),
            }
        });
        // Residuals with all amplitudes at 0; the single reflections of a fixed gain remain.
        let mut dark = r.to_vec();
        let mut take = |c: Option<&Vec<f64>>, by: f64| {
            if let Some(c) = c {
                dark.iter_mut().zip(c).for_each(|(v, c)| *v -= by * c);
            }
        };
        take(single.as_ref(), gain);
        take(
            diffuse.as_ref(),
            if self.scale.is_some() {
                gain * rho_d
            } else {
                rho_d
            },
        );
        take(background.as_ref(), self.background.map_or(0.0, |k| x[k]));
        let (low, high) = self.rho_d_range;
        let mix = |share: f64| -> Option<Vec<f64>> {
            let (s, d) = (single.as_ref()?, diffuse.as_ref()?);
            Some(s.iter().zip(d).map(|(s, d)| s + share * d).collect())
        };
        let mut held: Option<f64> = None;
        let columns = [single.as_ref(), diffuse.as_ref(), background.as_ref()];
        let (mut cost, mut found) = least(&dark, &columns);
        if single.is_some() && diffuse.is_some() {
            let [g, gd, _] = found;
            let inside = g > 0.0 && gd >= low * g && gd <= high * g;
            if !inside {
                // The better one of the two edges; a gain below 0 is not allowed.
                let mut edges: Vec<(f64, [f64; 3], f64)> = [low, high]
                    .into_iter()
                    .filter_map(|share| {
                        let (cost, [g, _, b]) =
                            least(&dark, &[mix(share).as_ref(), None, background.as_ref()]);
                        (g > 0.0).then_some((cost, [g, share * g, b], share))
                    })
                    .collect();
                edges.sort_by(|a, b| a.0.total_cmp(&b.0));
                match edges.first() {
                    Some((c, f, share)) => (cost, found, held) = (*c, *f, Some(*share)),
                    None => return f64::INFINITY,
                }
            }
        } else if diffuse.is_some() && !(low..=high).contains(&found[1]) {
            let share = found[1].clamp(low, high);
            let rest: Vec<f64> = diffuse
                .iter()
                .flat_map(|d| d.iter().zip(&dark).map(|(d, r)| r + share * d))
                .collect();
            let (c, [_, _, b]) = least(&rest, &[None, None, background.as_ref()]);
            (cost, found, held) = (c, [0.0, share, b], Some(share));
        } else if single.is_some() && found[0] <= 0.0 {
            return f64::INFINITY;
        }
        // A lobe that all poses miss by far, scaled up until its skirt equals the signal.
        if found[0] > self.scale_max {
            return f64::INFINITY;
        }
        if let Some(k) = self.scale {
            x[k] = found[0];
        }
        if let Some(k) = self.rho_d {
            x[k] = match held {
                Some(share) => share,
                None if self.scale.is_some() => found[1] / found[0],
                None => found[1],
            };
        }
        if let Some(k) = self.background {
            x[k] = found[2];
        }
        cost
    }
}

/// Solves the least squares of `dark` + Σ factor·column. Returns the cost and the factors, which are 0 without a column
/// or if a column adds no information.
fn least(dark: &[f64], columns: &[Option<&Vec<f64>>; 3]) -> (f64, [f64; 3]) {
    let m = dark.len();
    let present: Vec<(usize, &Vec<f64>)> = columns
        .iter()
        .enumerate()
        .filter_map(|(k, c)| c.map(|c| (k, c)))
        .filter(|(_, c)| sum_of_squares(c) > 0.0)
        .take(m)
        .collect();
    let mut a: Vec<f64> = Vec::with_capacity(m * present.len());
    present.iter().for_each(|(_, c)| a.extend_from_slice(c));
    let mut b: Vec<f64> = dark.iter().map(|v| -v).collect();
    let n = present.len();
    householder(&mut a, m, n, &mut b);
    let mut factors = [0.0; 3];
    let rest = sum_of_squares(&b[n..]);
    if solve_upper(&a, m, n, &mut b) {
        for ((k, _), f) in present.iter().zip(&b) {
            factors[*k] = *f;
        }
        (rest, factors)
    } else {
        (f64::INFINITY, factors)
    }
}

/// Returns the values with the best amplitudes for their shape, and the cost that the linear problem predicts; infinite
/// if no positive gain within its bounds improves the fit.
pub(in crate::fit) fn settle(problem: &Problem<'_>, values: &Values) -> (f64, Values) {
    let bounds = problem.bounds();
    let amplitudes = Amplitudes::of(problem, &bounds);
    let mut x = problem.pack(&inner(problem, values));
    let (n, m) = (problem.n_parameters(), problem.n_residuals());
    let (mut r, mut j) = (vec![0.0; m], vec![0.0; m * n]);
    problem.evaluate(&x, &mut r, &mut j);
    let cost = amplitudes.solve(&mut x, &r, &j);
    (cost, problem.unpack(&x))
}

/// Returns the values with a diffuse part inside its bounds, so that it has a derivative.
fn inner(problem: &Problem<'_>, values: &Values) -> Values {
    let mut values = *values;
    if problem.free().contains(&Quantity::RhoD) && !(0.01..=0.99).contains(&values.rho_d) {
        values.rho_d = MIDDLE;
    }
    values
}

#[cfg(test)]
#[path = "variable_projection_tests.rs"]
mod tests;
