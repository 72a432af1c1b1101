#![doc = include_str!("../ARCHITECTURE.md")]

pub mod analysis;
pub mod bench;
pub mod cli;
pub mod clock;
pub mod fit;
pub mod frame;
pub mod geometry;
pub mod material;
pub mod model;
pub mod observation;
pub mod reduction;
pub mod scan;
pub mod series;
pub mod sim;
pub mod store;
pub mod units;
