//! PHYSICS by Monte Carlo: polarised light on explicit micro-geometry, single or layered.
//!
//! The one function to call: [`run::trace`] on a scene from [`scene::Scene`]. Photons carry Mueller
//! matrices (or one number in the scalar mode), meet facets by the full Fresnel matrices, and are
//! counted in direction bins with standard errors (Wang et al. 2017, Opt. Express 25, 22971).
//! Results depend on the seed alone. This room knows no files, no clock and no terminal: heights are
//! handed in, and a caller says when to stop.
//!
//! Directions are in the sample frame x = u, y = v, z = n; sources of the conventions are in
//! [`crate::model::polarisation`].

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
