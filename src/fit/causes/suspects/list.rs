//! The deviations from an ideal sawtooth that are tried.

use crate::fit::causes::findings::Code;
use crate::fit::problem::Quantity;

/// One suspected deviation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Suspect {
    pub(super) code: Code,
    pub(super) quantity: Quantity,
    /// Starting values; none where the descent begins at the minimum.
    pub(super) starts: &'static [f64],
    /// Below this magnitude the quantity counts as absent.
    pub(super) least: f64,
}

/// All of them.
pub(super) const SUSPECTS: [Suspect; 8] = [
    Suspect {
        code: Code::Translucent,
        quantity: Quantity::Translucency,
        starts: &[0.4],
        least: 0.04,
    },
    Suspect {
        code: Code::Tails,
        quantity: Quantity::Tail,
        starts: &[0.3],
        least: 0.02,
    },
    Suspect {
        code: Code::RoundedCrests,
        quantity: Quantity::CrestRadius,
        starts: &[0.04, 0.1],
        least: 0.01,
    },
    Suspect {
        code: Code::FlatLands,
        quantity: Quantity::Land,
        starts: &[0.1],
        least: 0.01,
    },
    Suspect {
        code: Code::WedgeAcross,
        quantity: Quantity::Wedge,
        starts: &[0.0],
        least: 5e-4,
    },
    Suspect {
        code: Code::LampAzimuth,
        quantity: Quantity::LampTurn,
        starts: &[0.0],
        least: 3e-3,
    },
    // The flats determine the stray light. Without their full weight the observations determine it.
    Suspect {
        code: Code::WhiteReference,
        quantity: Quantity::Background,
        starts: &[],
        least: 0.0,
    },
    Suspect {
        code: Code::Index,
        quantity: Quantity::Eta,
        starts: &[],
        least: 0.0,
    },
];
