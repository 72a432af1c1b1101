//! When it is worth following both branches of a photon.

use crate::trace::photons::interface::Stack;

/// Least fraction of the light in the weaker branch for following both branches after the first
/// hit. In a stack this applies to as many hits as there are interfaces, that is, on the way down.
/// After that each part has a long path, and a random choice adds less variance than following both
/// would cost.
const WORTH_SPLITTING: f64 = 1e-3;
/// The same in a stack of at least [`LAYERED`] rough interfaces: it is larger for the same reason.
const WORTH_SPLITTING_LAYERED: f64 = 3e-2;
/// Least number of rough interfaces of a layered stack.
const LAYERED: usize = 3;
/// Number of rough interfaces beyond which both branches are followed only at the first hit: a
/// photon in twenty layers would have hundreds of parts, and more noise than photons with random
/// branches in the same time.
const SPLIT_ROUGH_MAX: usize = 5;
/// Number of smooth interfaces beyond which both branches are followed only at the first hit.
const SPLIT_FLAT_MAX: usize = 16;

/// Least fraction in the weaker branch for following both after the first hit. The optimum was
/// measured in stacks of 2 to 60 interfaces of smooth and rough glass.
#[must_use]
pub fn worth_splitting(stack: &Stack) -> f64 {
    const NEVER: f64 = 2.0;
    match (stack.is_flat(), stack.interfaces.len()) {
        (true, ..=SPLIT_FLAT_MAX) | (false, ..LAYERED) => WORTH_SPLITTING,
        (false, LAYERED..=SPLIT_ROUGH_MAX) => WORTH_SPLITTING_LAYERED,
        _ => NEVER,
    }
}
