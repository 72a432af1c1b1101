//! The simulated rig: one world, seen by a controller that speaks the real protocol and by a camera.
//!
//! [`server::serve_pty`] puts the controller on a pseudo-terminal, where the real driver finds it:
//! nothing reaches the stages but bytes. The simulated camera shares the same [`world::World`], so
//! moving a stage changes the picture, as on a bench. Knows nothing of scans, store or fit.

pub mod camera;
pub mod controller;
pub mod device;
pub mod faults;
mod light;
pub mod motion;
pub mod sample;
pub mod server;
mod unit;
pub mod world;
