//! Monte Carlo light transport: polarised light on explicit micro-geometry, single or layered.
//!
//! Call [`run::trace`] on a scene from [`scene::Scene`]. Photons carry Mueller
//! matrices (or one number in the scalar mode), are reflected and refracted by the full Fresnel
//! matrices, and are counted in direction bins with standard errors (Wang et al. 2017, Opt. Express
//! 25, 22971). Results depend only on the seed. This module knows no files, clock or terminal: the
//! caller passes heights in and decides when to stop.
//!
//! Directions are in the sample frame x = u, y = v, z = n; the sources of the conventions are
//! listed in [`crate::model::polarisation`].
//!
//! A [`scene`] has interfaces of [`surfaces`]. A [`run`] sends [`photons`] through them. They are scattered at [`facets`] and
//! shadowed by other facets ([`visibility`]). [`counting`] adds up the light that leaves, and [`report`] states it. [`pilot`]
//! finds what may be left out; [`pose_radiance`] and [`ellipsometer`] simulate the rig and an ellipsometer, and
//! [`surface_spread`] compares surfaces of the same statistics.

pub mod counting;
pub mod ellipsometer;
#[cfg(test)]
mod extreme_tests;
pub mod facets;
#[cfg(test)]
mod laws;
pub mod photons;
pub mod pilot;
pub mod pose_radiance;
pub mod report;
pub mod rng;
pub mod run;
pub mod scene;
pub mod surface_spread;
pub mod surfaces;
pub mod vec3;
pub mod visibility;
