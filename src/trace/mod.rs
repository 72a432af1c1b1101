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

pub mod beckmann;
pub mod bins;
pub mod crystals;
pub mod ellipsometer;
#[cfg(test)]
mod extreme_tests;
mod facet_lanes;
pub mod facet_response;
pub mod facet_scattering;
mod fixed_point;
pub mod grid;
pub mod height_field;
pub mod horizon_slopes;
#[cfg(test)]
mod laws;
pub mod light;
pub mod paired;
pub mod pilot;
pub mod plane;
pub mod polarisation_difference;
pub mod pose_radiance;
pub mod primary_hits;
pub mod report;
pub mod ridge_map;
pub mod rng;
pub mod run;
pub mod scene;
pub mod stokes;
pub mod surface;
pub mod surface_profile;
pub mod surface_spread;
pub mod swept_visibility;
pub mod tails;
pub mod tally;
pub mod vec3;
pub mod walk;
pub mod worn_ridges;
