#![doc = include_str!("../ARCHITECTURE.md")]

pub mod accuracy;
pub mod analysis;
pub mod api;
pub mod bench;
pub mod check;
pub mod cli;
pub mod clock;
pub mod config;
pub mod contrast;
#[cfg(test)]
mod extremes;
pub mod fit;
pub mod forecast;
pub mod frame;
pub mod geometry;
pub mod heights;
pub mod jackknife;
pub mod job;
pub mod judge;
pub mod lab;
pub mod limits;
pub mod map;
pub mod material;
pub mod model;
pub mod observation;
pub mod plan;
pub mod reduction;
pub mod robust;
pub mod scan;
pub mod series;
pub mod sim;
pub mod store;
pub mod tables;
pub mod trace;
pub mod units;
pub mod wording;
