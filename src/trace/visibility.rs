//! Where the light falls on a height field, and whether it leaves freely.

pub mod horizon_slopes;
pub mod primary_hits;
pub mod swept_visibility;
