//! The micro-geometry: height fields and profiles, made or measured, and rays on them.

pub mod beckmann;
pub mod crystals;
pub mod height_field;
pub mod ridge_map;
pub mod surface_profile;
pub mod worn_ridges;
