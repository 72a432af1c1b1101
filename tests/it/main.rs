//! Tests of the whole: one binary, one module per claim's home.

// Helpers outside #[test] functions are tests too.
#![allow(clippy::unwrap_used)]

mod access;
mod again;
mod bench_in_a_box;
mod check;
mod commands;
mod corrections;
mod costs;
mod cut_short;
mod doctor;
mod exports;
mod faults;
mod fuzz;
mod height_files;
mod http;
mod identity;
mod imports;
mod interlocks;
mod lab;
mod line;
mod near;
mod night;
mod nist;
mod off_axis;
mod parameter_covariance;
mod radiances;
mod readme;
mod real_samples;
mod recorded;
mod runner;
mod shards;
mod shell;
mod simulate_rig;
mod soak;
mod source_files;
mod stage;
mod stage_care;
mod stop;
mod stop_in_time;
mod store_trouble;
mod stored_fits;
mod style;
mod synthetic;
mod tables;
mod terminal;
mod test_tables;
mod unattended;
mod ways;
