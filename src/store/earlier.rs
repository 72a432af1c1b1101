//! Names that parts had and parts that scans were assigned to, and the SQL that reads them.

use serde::{Deserialize, Serialize};

/// A name that a part had.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EarlierName {
    /// The name.
    pub name: String,
    /// When it was replaced, RFC 3339 in UTC.
    pub until: String,
}

/// A part that a scan was assigned to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EarlierSample {
    /// Number of the part.
    pub sample_id: i64,
    /// The part's present name.
    pub sample_name: String,
    /// When the scan was assigned to another part, RFC 3339 in UTC.
    pub until: String,
}

/// SQL for [`EarlierName`]s of a sample `p`, oldest first, as JSON: each correction ends the name before it.
pub(super) const EARLIER_NAMES: &str =
    "(SELECT json_group_array(json_object('name', before, 'until', at)) FROM
       (SELECT COALESCE((SELECT m.name FROM sample_names m WHERE m.sample_id = n.sample_id AND m.id < n.id
          ORDER BY m.id DESC LIMIT 1), p.name) AS before, n.at FROM sample_names n WHERE n.sample_id = p.id ORDER BY n.id))";

/// SQL for [`EarlierSample`]s of a scan `s`, oldest first, as JSON.
pub(super) const EARLIER_SAMPLES: &str =
    "(SELECT json_group_array(json_object('sample_id', e.before, 'sample_name', q.name, 'until', e.at)) FROM
       (SELECT COALESCE((SELECT b.sample_id FROM scan_samples b WHERE b.scan_id = a.scan_id AND b.id < a.id
          ORDER BY b.id DESC LIMIT 1), s.sample_id) AS before, a.at FROM scan_samples a WHERE a.scan_id = s.id ORDER BY a.id) e
       JOIN sample_now q ON q.sample_id = e.before)";
