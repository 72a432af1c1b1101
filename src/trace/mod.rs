//! Monte Carlo light transport: polarised light on explicit micro-geometry, single or layered.
//!
//! The function to call is [`run::trace`] on a scene from [`scene::Scene`]. Photons carry Mueller
//! matrices (or one number in the scalar mode), are reflected and refracted by the full Fresnel
//! matrices, and are counted in direction bins with standard errors (Wang et al. 2017, Opt. Express
//! 25, 22971). Results depend only on the seed. This module knows no files, clock or terminal: the
//! caller passes heights in and decides when to stop.
//!
//! Directions are in the sample frame x = u, y = v, z = n; the sources of the conventions are
//! listed in [`crate::model::polarisation`].

pub mod beam;
pub mod beckmann;
pub mod bins;
pub mod compare;
pub mod crystals;
pub mod ellipsometer;
pub mod escape;
mod exact;
#[cfg(test)]
mod extreme_tests;
pub mod facet;
mod facets;
pub mod first_hit;
pub mod grid;
pub mod height_field;
pub mod launch;
#[cfg(test)]
mod laws;
pub mod light;
pub mod paired;
pub mod pilot;
pub mod plane;
pub mod profile;
pub mod report;
pub mod ridge_map;
pub mod ridged;
pub mod ridges;
pub mod rng;
pub mod run;
pub mod scene;
pub mod spread;
pub mod stokes;
pub mod surface;
pub mod tails;
pub mod tally;
pub mod vec3;
pub mod walk;
