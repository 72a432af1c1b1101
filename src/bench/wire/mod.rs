//! Stage protocols, one file each: pure encoding and decoding.
//!
//! A protocol file serves both ends of the line: the host decodes messages, the simulated device
//! decodes commands. It knows no port, clock or axis.

pub mod zaber;
pub mod zaber_flags;
pub mod zaber_stream;
