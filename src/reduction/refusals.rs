//! What a reduction refuses: each refusal names its cause and the remedy.

/// Why a series has no observations.
#[derive(Debug, thiserror::Error)]
pub enum ReductionError {
    /// The sample has patches and no region was chosen.
    #[error("this part has regions, each with its own lean direction; choose one with --region (`region` of a request): {}", available.join(", "))]
    RegionNeeded {
        /// Names of the regions.
        available: Vec<String>,
    },
    /// There is no such region.
    #[error("there is no region `{name}`; {}", if available.is_empty() { "this part has none".to_owned() } else { format!("this part has {}", available.join(", ")) })]
    UnknownRegion {
        /// Name that was given.
        name: String,
        /// Names of the regions there are.
        available: Vec<String>,
    },
    /// Lamp or camera is near and the size of the field is not stated.
    #[error(
        "{what}: every pixel has its own directions; state camera.field_width_mm and the distances in the manifest"
    )]
    FieldUnknown {
        /// What the manifest says.
        what: String,
    },
    /// No sample frame could be used.
    #[error("no observation is left: {why}")]
    NoObservations {
        /// Why the frames were left out.
        why: String,
    },
    /// Most frames of a kind contain counts that the stated converter cannot give.
    #[error(
        "{frames} of {of} {kind} frames contain counts that the camera cannot give; of {first} {detail}"
    )]
    ImpossibleCounts {
        /// Kind of the frames.
        kind: &'static str,
        /// How many of them.
        frames: usize,
        /// How many there are.
        of: usize,
        /// File of the first.
        first: String,
        /// Its counts, and the remedy.
        detail: String,
    },
    /// Frames that could be read before cannot be read now.
    #[error("{what} disappeared while they were read; check whether the folder is being changed")]
    Vanished {
        /// Which frames.
        what: &'static str,
    },
    /// The cancel flag was raised.
    #[error("the reduction was cancelled")]
    Cancelled,
}
