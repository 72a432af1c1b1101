//! The columns of a result: name, kind and meaning. Filters, the OpenAPI document and the table of the command line follow
//! from this list.
//!
//! A new column is a line here and a migration, since old ones never change. The migration adds the column to `results` and
//! makes the view `result_now` again, from the newest migration that has it. The rows are inserted by place (`SELECT *`), so
//! the column has the same place in both; that of this list is free. Then it fills the table again: `DELETE FROM
//! results`, `INSERT INTO results SELECT * FROM result_now`. The triggers stay. A value of the report is `report ->> '$.path'`.
//!
//! A column of kind [`Kind::Real`] is declared REAL, also for a count, which has no kind of its own: of an INTEGER column
//! SQLite returns an integer, which is not read as an `f64`.

/// What the values of a column are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Number of a row of another list.
    Id,
    /// Text of a person.
    Text,
    /// One of these words.
    Word(&'static [&'static str]),
    /// A measured or stated value.
    Real {
        /// Column with its standard uncertainty, which decides the digits that are shown.
        std: Option<&'static str>,
    },
    /// RFC 3339 UTC.
    Time,
    /// True or false.
    Flag,
    /// Tags of a person.
    Tags,
}

impl Kind {
    /// Whether its values have an order that ranges select by.
    #[must_use]
    pub const fn has_range(self) -> bool {
        matches!(self, Kind::Id | Kind::Real { .. } | Kind::Time)
    }
}

/// A column.
#[derive(Debug, PartialEq, Eq)]
pub struct Column {
    /// Name in queries and answers; the unit is its end.
    pub name: &'static str,
    /// What its values are.
    pub kind: Kind,
    /// Whether a row has it without being asked.
    pub is_usual: bool,
    /// Whether it describes the scan itself, and not its fit or verdict.
    pub is_of_scan: bool,
    /// Meaning.
    pub about: &'static str,
}

/// Words of the state of a scan.
const STATES: &[&str] = &[
    "planned",
    "waiting-for-operator",
    "running",
    "pausing",
    "paused",
    "interrupted",
    "completed",
    "aborted",
    "failed",
];
/// Words of the status of a fit.
const STATUSES: &[&str] = &[
    "converged",
    "at-bound",
    "rank-deficient",
    "stalled",
    "not-finite",
    "too-few-observations",
    "cancelled",
];
const VARIANTS: &[&str] = &["paper", "sawtooth", "traced"];
const VERDICTS: &[&str] = &["pass", "fail", "cannot-tell"];
const FINDINGS: &[&str] = &[
    "tails",
    "rounded-crests",
    "flat-lands",
    "translucent",
    "wedge-across",
    "lamp-azimuth",
    "white-reference",
    "non-linear",
    "lamp-drift",
    "index",
    "bad-block",
    "bad-pose",
];
const MATERIALS: &[&str] = &["dielectric", "conductor"];
const ORIGINS: &[&str] = &["rig", "import"];

const fn of_scan(name: &'static str, kind: Kind, is_usual: bool, about: &'static str) -> Column {
    Column {
        name,
        kind,
        is_usual,
        is_of_scan: true,
        about,
    }
}

const fn of_result(name: &'static str, kind: Kind, is_usual: bool, about: &'static str) -> Column {
    Column {
        name,
        kind,
        is_usual,
        is_of_scan: false,
        about,
    }
}

/// A value of the fit with its column of the standard uncertainty.
const fn value(
    name: &'static str,
    std: &'static str,
    is_usual: bool,
    about: &'static str,
) -> Column {
    of_result(name, Kind::Real { std: Some(std) }, is_usual, about)
}

/// A standard uncertainty.
const fn std(name: &'static str, is_usual: bool, about: &'static str) -> Column {
    of_result(name, Kind::Real { std: Some(name) }, is_usual, about)
}

/// All columns, in the order of a row.
#[rustfmt::skip]
pub static COLUMNS: &[Column] = &[
    of_scan("scan_id", Kind::Id, true, "Number of the scan"),
    of_result("region", Kind::Text, true, "Region of a part that has several; omitted from an object if there is none"),
    of_result("fit_id", Kind::Id, true, "Number of the newest completed fit"),
    of_scan("sample_id", Kind::Id, false, "Number of the part"),
    of_scan("part", Kind::Text, true, "Name of the part"),
    of_scan("lot", Kind::Text, true, "Lot of the part"),
    of_scan("recipe", Kind::Text, true, "Name of the recipe that the scan was started with"),
    of_scan("recipe_version", Kind::Id, false, "Version of that recipe"),
    of_scan("external_id", Kind::Text, true, "Number of the part or order in another system"),
    of_scan("operator_name", Kind::Text, true, "The person at the rig"),
    of_scan("material", Kind::Word(MATERIALS), true, "Kind of the part's material"),
    of_scan("eta", Kind::Real { std: None }, false, "Index of refraction n of the material"),
    of_scan("k", Kind::Real { std: None }, false, "Extinction coefficient k of the material; 0 for a dielectric"),
    of_scan("origin", Kind::Word(ORIGINS), false, "Scan of the rig, or imported series"),
    of_scan("who", Kind::Text, false, "Who started the scan: the name of a token, or `local`"),
    of_scan("state", Kind::Word(STATES), true, "State of the scan"),
    of_result("status", Kind::Word(STATUSES), true, "How the fit ended"),
    of_result("variant", Kind::Word(VARIANTS), false, "Variant of the model that the fit reports"),
    value("theta_r_deg", "theta_r_deg_std", true, "Ridge angle θr, degrees; null where the data do not determine it"),
    std("theta_r_deg_std", true, "Standard uncertainty u of θr (k = 1), degrees"),
    value("theta_r_deg_expanded", "theta_r_deg_std", true, "Expanded uncertainty U of θr, degrees"),
    of_result("coverage_factor", Kind::Real { std: None }, true, "k of the expanded uncertainty: U = k·u"),
    value("alpha_u", "alpha_u_std", true, "Roughness along the ridges, tangent of a slope"),
    std("alpha_u_std", true, "Its standard uncertainty (k = 1)"),
    value("alpha_v", "alpha_v_std", true, "Roughness across the ridges, tangent of a slope"),
    std("alpha_v_std", true, "Its standard uncertainty (k = 1)"),
    value("rho_d", "rho_d_std", true, "Diffuse reflectance"),
    std("rho_d_std", true, "Its standard uncertainty (k = 1)"),
    value("scale", "scale_std", false, "Gain g of the signals; 1 with a white reference"),
    std("scale_std", false, "Its standard uncertainty (k = 1)"),
    value("background", "background_std", false, "Stray light B"),
    std("background_std", false, "Its standard uncertainty (k = 1)"),
    value("azimuth_offset_deg", "azimuth_offset_deg_std", false, "Δφs, degrees"),
    std("azimuth_offset_deg_std", false, "Its standard uncertainty (k = 1), degrees"),
    value("tilt_offset_deg", "tilt_offset_deg_std", false, "Δθc, degrees"),
    std("tilt_offset_deg_std", false, "Its standard uncertainty (k = 1), degrees"),
    value("translucency", "translucency_std", false, "Share of the body's light that leaves evenly over the ridges"),
    std("translucency_std", false, "Its standard uncertainty (k = 1)"),
    value("crest_radius", "crest_radius_std", false, "Radius of the crests divided by the length of the facets"),
    std("crest_radius_std", false, "Its standard uncertainty (k = 1)"),
    value("land_share", "land_share_std", false, "Share of the surface that is flat between the ridges"),
    std("land_share_std", false, "Its standard uncertainty (k = 1)"),
    of_result("rms_residual", Kind::Real { std: None }, false, "Residual (rms) as a share of the largest observation"),
    of_result("finding", Kind::Word(FINDINGS), false, "Known cause that explains most of the residual; null if none was found"),
    of_result("verdict", Kind::Word(VERDICTS), true, "Newest verdict; null where the scan was not judged"),
    of_result("verdict_id", Kind::Id, false, "Number of that verdict"),
    of_result("verdict_matches", Kind::Flag, false, "Whether that verdict judged the values of this fit; false where a later fit gave others, null without a verdict"),
    of_result("specification", Kind::Text, true, "Name of the specification of that verdict"),
    of_scan("created_at", Kind::Time, true, "When the scan was started or imported"),
    of_scan("ended_at", Kind::Time, true, "When it ended; null while it can go on"),
    of_result("fitted_at", Kind::Time, false, "When the fit ended"),
    of_scan(ARCHIVED, Kind::Flag, false, "Whether the scan is archived; without this filter, rows of archived scans are left out"),
    of_scan("tags", Kind::Tags, false, "Tags of the scan"),
    of_scan("note", Kind::Text, false, "Note on the scan"),
];

/// The column whose filter is always on.
pub const ARCHIVED: &str = "archived";

/// Returns the column of a name.
#[must_use]
pub fn column(name: &str) -> Option<&'static Column> {
    COLUMNS.iter().find(|column| column.name == name)
}

/// Returns the columns that a row has without being asked.
pub fn usual() -> Vec<&'static Column> {
    COLUMNS.iter().filter(|column| column.is_usual).collect()
}

/// Place of a column in [`COLUMNS`].
pub(super) fn place(wanted: &Column) -> usize {
    let found = COLUMNS.iter().position(|column| column.name == wanted.name);
    found.expect("every column is in the list")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::causes::findings::Code;
    use crate::fit::report::{Status, VariantName};
    use crate::judge::Verdict;
    use crate::scan::state::TRANSITIONS;

    #[test]
    fn the_words_are_those_of_scans_fits_and_verdicts() {
        let words = |word: &serde_json::Value| word.as_str().unwrap().to_owned();
        let status = Status::ALL.map(|s| words(&serde_json::to_value(s).unwrap()));
        assert_eq!(status.to_vec(), STATUSES);
        assert_eq!(VariantName::ALL.map(|v| v.to_string()).to_vec(), VARIANTS);
        assert_eq!(Code::ALL.map(Code::word).to_vec(), FINDINGS);
        let verdicts = [Verdict::Pass, Verdict::Fail, Verdict::CannotTell];
        let verdicts = verdicts.map(|v| words(&serde_json::to_value(v).unwrap()));
        assert_eq!(verdicts.to_vec(), VERDICTS);
        let mut states: Vec<&str> = TRANSITIONS
            .iter()
            .flat_map(|(from, to)| std::iter::once(from).chain(*to))
            .map(|state| state.as_str())
            .collect();
        states.sort_unstable();
        states.dedup();
        let mut listed = STATES.to_vec();
        listed.sort_unstable();
        assert_eq!(listed, states);
    }

    #[test]
    fn the_document_lists_every_column() {
        let document = include_str!("../../../docs/reference/results.md");
        for of in COLUMNS {
            assert!(document.contains(&format!("`{}`", of.name)), "{}", of.name);
        }
    }

    #[test]
    fn every_uncertainty_that_rounds_a_value_is_a_column() {
        for of in COLUMNS {
            if let Kind::Real { std: Some(std) } = of.kind {
                assert!(column(std).is_some(), "{} has no {std}", of.name);
            }
        }
    }
}
