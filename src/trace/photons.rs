//! The path of a photon through the interfaces of a stack, and the state of light that it carries.

pub mod interface;
pub mod light;
pub mod paired;
pub mod stokes;
pub mod walk;
