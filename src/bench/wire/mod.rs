//! Stage protocols, one file each: pure encode and decode.
//!
//! A protocol's file knows bytes and their meaning, for both ends of the line: the host reads
//! messages, the simulated device reads commands. It knows no port, no clock and no axis.

pub mod zaber;
pub mod zaber_flags;
pub mod zaber_stream;
