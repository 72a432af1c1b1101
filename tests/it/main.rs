//! Tests of the whole: one binary, one module per claim's home.

mod imports;
mod nist;
mod radiances;
