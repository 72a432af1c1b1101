//! Why a sample, a rig or a pose departs from the model: each known cause is tried, named and, where the data allow it,
//! corrected.

pub mod bad_poses;
pub(super) mod camera_response;
pub(super) mod contradicted_values;
pub(super) mod downweighting;
pub mod findings;
pub mod lamp_drift;
pub mod measured_shape;
pub(super) mod missing_lobe;
pub(super) mod suspects;
pub mod wedge;
