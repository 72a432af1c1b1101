//! Stage protocols, one file each: pure encoding and decoding.
//!
//! A protocol file serves both ends of the line: the host decodes messages, the simulated device
//! decodes commands. It knows no port, clock or axis.
//!
//! Zaber ASCII is the only protocol. [`super::line`] and [`super::stage`] use its types and words directly, so a further
//! codec is not reached until a type between `line` and this module chooses one.

pub mod zaber;
pub mod zaber_flags;
pub mod zaber_stream;
