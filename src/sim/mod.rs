//! The simulated rig: a controller that speaks the real protocol and a camera, both in one world.
//!
//! [`server::serve_pty`] puts the controller on a pseudo-terminal, which the real driver opens: the
//! stages are reached only by bytes. The simulated camera shares the same [`world::World`], so
//! moving a stage changes the frame, as on a bench. [`rig`] assembles these devices into a rig for the
//! lab, and [`operator`] acts as the operator; the devices know no scan, store or fit.

pub mod camera;
pub mod controller;
pub mod device;
pub mod faults;
mod light;
pub mod memory_port;
pub mod motion;
pub mod operator;
pub mod rig;
pub mod sample;
pub mod server;
mod unit;
pub mod world;
