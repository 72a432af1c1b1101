//! What a facet does with light: a smooth mirror, a rough one, a lobe with tails, or a body.

pub(super) mod lanes;
pub mod response;
pub mod scattering;
pub mod tails;
