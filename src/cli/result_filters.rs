//! Options that select results: those of `ridged results` and `ridged chart`.

use anyhow::anyhow;

use super::CliError;
use crate::store::results::OF_THE_PAGE;

/// Filters of results.
#[derive(Debug, clap::Args)]
pub struct FilterArgs {
    /// Only scans of the part of this name.
    #[arg(long, value_name = "NAME")]
    pub part: Option<String>,
    /// Only scans of this lot.
    #[arg(long, value_name = "LOT")]
    pub lot: Option<String>,
    /// Only scans by this recipe.
    #[arg(long, value_name = "NAME")]
    pub recipe: Option<String>,
    /// Only scans whose newest verdict is by this specification.
    #[arg(long, value_name = "NAME")]
    pub specification: Option<String>,
    /// Only scans with this tag.
    #[arg(long, value_name = "TAG")]
    pub tag: Option<String>,
    /// Archived scans, which lists leave out: true for them only, all for both.
    #[arg(long, value_name = "true|false|all")]
    pub archived: Option<String>,
    /// Only with this verdict: pass, fail, cannot-tell; several separated by commas; empty for scans without one.
    #[arg(long, value_name = "WORDS")]
    pub verdict: Option<String>,
    /// Only the newest fitted scan of each part.
    #[arg(long)]
    pub latest: bool,
    /// Only with this text in the name of part, lot, recipe, operator or specification, in the external id, a tag or
    /// the note.
    #[arg(long, value_name = "TEXT")]
    pub search: Option<String>,
    /// Only started or imported at or after this time (UTC), e.g. 2026-03-02 or 2026-03-02T09:00:00Z.
    #[arg(long, value_name = "TIME")]
    pub since: Option<String>,
    /// Only started or imported before this time (UTC).
    #[arg(long, value_name = "TIME")]
    pub until: Option<String>,
    /// Only rows that this filter selects; may be repeated.
    #[arg(long, value_name = "NAME=VALUE")]
    pub filter: Vec<String>,
}

impl FilterArgs {
    /// Returns the options as parameters of a query, by name and text.
    ///
    /// # Errors
    /// Bad input for `--filter` without a value, or with a name that is no filter.
    pub fn parameters(&self) -> Result<Vec<(&str, &str)>, CliError> {
        let mut parameters: Vec<(&str, &str)> = [
            ("part", &self.part),
            ("lot", &self.lot),
            ("recipe", &self.recipe),
            ("specification", &self.specification),
            ("tag", &self.tag),
            ("archived", &self.archived),
            ("verdict", &self.verdict),
            ("search", &self.search),
            ("since", &self.since),
            ("until", &self.until),
        ]
        .into_iter()
        .filter_map(|(name, value)| Some((name, value.as_deref()?)))
        .collect();
        if self.latest {
            parameters.push(("latest", "true"));
        }
        for filter in &self.filter {
            match filter.split_once('=') {
                Some((name, value)) if !is_option(name.trim()) => {
                    parameters.push((name.trim(), value.trim()));
                }
                _ => {
                    return Err(CliError::bad_input(anyhow!(
                        "--filter {filter:?}: expected NAME=VALUE with a column of docs/reference/results.md, e.g. theta_r_deg_min=9.5"
                    )));
                }
            }
        }
        Ok(parameters)
    }
}

/// Whether a parameter has an option of its own.
fn is_option(name: &str) -> bool {
    name == "latest" || OF_THE_PAGE.contains(&name)
}
