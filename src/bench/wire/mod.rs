//! Stage protocols, one file each: pure encoding and decoding.
//!
//! A protocol file serves both ends of the line: the host decodes messages, the simulated device
//! decodes commands. It knows no port, clock or axis.
//!
//! [`super::line`] and [`super::stage`] speak Zaber ASCII and use its types and words. For another protocol, put a
//! [`super::port::Port`] below them that translates: `ARCHITECTURE.md` says how.

pub mod zaber;
pub mod zaber_flags;
pub mod zaber_stream;
