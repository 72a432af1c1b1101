//! The sawtooth with the terms of real samples, and its derivatives.

use std::array;

use super::{Parameters, Terms, Walls, of_land, of_ridges};
use crate::geometry::Directions;
use crate::model::dual::Dual;
use crate::model::number::Number;
use crate::model::prepared::Partials;
use crate::model::real::{DEVIATIONS, Real};
use crate::model::{Optics, Surface};

/// First variable of the deviations from an ideal sawtooth, of amplitude and index, and of the two directions' components.
const REAL: usize = 4;
/// The radiance is linear in the share of the lands, the last deviation, which therefore needs no variable.
const CURVED: usize = DEVIATIONS - 1;
const OPTICAL: usize = REAL + CURVED;
const INCIDENT: usize = OPTICAL + 3;
const OUTGOING: usize = INCIDENT + 3;
/// Number of variables of the derivatives.
const VARIABLES: usize = OUTGOING + 3;

/// Returns the radiance with its derivatives for θr ≥ 0.
#[must_use]
pub fn partials(
    directions: &Directions,
    surface: &Surface,
    real: &Real,
    terms: Terms,
    optics: &Optics,
    walls: &Walls,
) -> Partials {
    let (i, o) = (directions.incident.into(), directions.outgoing.into());
    let lit = |w: [f64; 3]| w[2] > 0.0;
    if !(lit(i) && lit(o)) {
        return Partials::default();
    }
    type D = Dual<VARIABLES>;
    let deviations = real.into_array();
    let theta_r = D::variable(surface.theta_r, 0);
    let q = Parameters {
        theta_r,
        alpha_u: D::variable(surface.alpha_u, 1),
        alpha_v: D::variable(surface.alpha_v, 2),
        rho_d: D::variable(surface.rho_d, 3),
        real: Real::from_array(array::from_fn(|j| match j < CURVED {
            true => D::variable(deviations[j], REAL + j),
            false => theta_r.like(deviations[j]),
        })),
        amplitude: D::variable(surface.amplitude, OPTICAL),
        eta: D::variable(optics.eta, OPTICAL + 1),
        k: D::variable(optics.k, OPTICAL + 2),
    };
    let direction = |w: [f64; 3], first: usize| [0, 1, 2].map(|j| D::variable(w[j], first + j));
    let widening = optics.cones.widening();
    let (i, o) = (direction(i, INCIDENT), direction(o, OUTGOING));
    let mut found = of_ridges(i, o, &q, terms, walls, widening);
    let mut by_land = 0.0;
    if terms.lands {
        let more = of_land(i, o, &q, terms, walls, widening) - found;
        by_land = more.value;
        found = found + more.times(real.land);
    }
    let d = found.partials;
    Partials {
        value: found.value,
        theta_r: d[0],
        alpha_u: d[1],
        alpha_v: d[2],
        rho_d: d[3],
        real: Real::from_array(array::from_fn(|j| match j < CURVED {
            true => d[REAL + j],
            false => by_land,
        })),
        amplitude: d[OPTICAL],
        eta: d[OPTICAL + 1],
        k: d[OPTICAL + 2],
        incident: array::from_fn(|j| d[INCIDENT + j]),
        outgoing: array::from_fn(|j| d[OUTGOING + j]),
    }
}
