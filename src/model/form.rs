//! The closed forms with their derivatives by hand, written once over a [`Register`].
//!
//! [`radiance`] evaluates one pair of directions per place of the register. The derivatives are in reverse mode: each
//! term adds to the sum L (o·n) and to the slopes of the sum with respect to its inputs (`ray`); at the end these are
//! led back to the directions and the parameters. Tests compare them with the dual numbers of the crate num-dual in the
//! forms of [`super::extended`] and [`super::paper`].
//!
//! Branches are selections between two numbers, so that the places of a register may take different ones. What no place
//! needs is omitted. The forms have no closures: the compiler inlines them into vectorised code only sometimes.

mod diffuse;
mod paper;
mod ray;
mod retro;
mod sawtooth;
mod shape;

use super::Variant;
use super::register::Register;

pub(crate) use shape::{Derivatives, Fixed, Half, NUMBERS, Shape};

/// Returns the radiance with its slopes for unit vectors along u, v, n. Directions on or below the horizon give 0. `body`:
/// diffuse light is evaluated; without it ∂/∂ρd is 0.
#[inline(always)]
pub(crate) fn radiance<R: Register>(
    variant: Variant,
    body: bool,
    fixed: &Fixed,
    shape: &Shape<R>,
    half: &Half<R>,
    i: &[R; 3],
    o: &[R; 3],
) -> Derivatives<R> {
    match variant {
        Variant::Paper => paper::radiance(shape, half, i, o),
        Variant::Sawtooth => sawtooth::radiance(body, fixed, shape, half, i, o),
    }
}
