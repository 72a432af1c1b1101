//! Who holds the rig, as it is shown to others.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Who holds the rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HolderBody {
    /// Name of the caller: of its token, or `local`.
    pub who: String,
    /// Name of the lease, or the scan or motion that holds the rig without one.
    pub name: String,
    /// When the lease expires if it is not used, RFC 3339 in UTC; null for a scan or motion, which holds the rig until its end.
    pub until: Option<String>,
}
