//! Tests of the whole: one binary, one module per claim's home.

mod imports;
mod line;
mod nist;
mod radiances;
mod stage;
