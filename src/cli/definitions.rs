//! `ridged recipe` and `ridged specification`: the definitions of a running daemon as TOML files, in both directions.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::CliError;
use super::client::{Client, ConnectionArgs};
use super::output;
use crate::judge::Specification;
use crate::lab::Recipe;
use crate::lab::definitions::Content;
use crate::wording::{toml_text, utc_words};

/// Lists, shows, saves and archives recipes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged recipe save docs/examples/recipe.toml
  ridged recipe show \"PX-1204 rev C\" > px.toml        then edit px.toml and save it: a new version
  ridged recipe archive \"PX-1204 rev C\"
  ridged scan --recipe \"PX-1204 rev D\" --sample \"Panel B-17\"")]
pub struct RecipeArgs {
    /// The action.
    #[command(subcommand)]
    pub action: Action,
    /// Where the daemon is, and what it is shown.
    #[command(flatten)]
    pub daemon: DaemonArgs,
}

/// Lists, shows, saves and archives specifications.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged specification save docs/examples/specification.toml
  ridged specification show \"drawing 4711\" > limits.toml   then edit limits.toml and save it: a new version
  ridged scan --recipe PX-1204 --specification \"drawing 4711\" --sample \"Panel B-17\"")]
pub struct SpecificationArgs {
    /// The action.
    #[command(subcommand)]
    pub action: Action,
    /// Where the daemon is, and what it is shown.
    #[command(flatten)]
    pub daemon: DaemonArgs,
}

/// Where the daemon is, and what it is shown.
#[derive(Debug, clap::Args)]
pub struct DaemonArgs {
    /// Data folder of the daemon.
    #[arg(long, value_name = "DIR", default_value = "ridged-data", global = true)]
    pub data: PathBuf,
    /// Address, token and lease.
    #[command(flatten)]
    pub connection: ConnectionArgs,
    /// One JSON object on stdout.
    #[arg(long, global = true)]
    pub json: bool,
}

impl DaemonArgs {
    pub(super) fn client(&self) -> Result<Client, CliError> {
        Client::require(&self.data, &self.connection)
    }
}

/// An action on definitions.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// List them in their newest versions.
    #[command(after_help = "Example:\n  ridged recipe list --archived")]
    List {
        /// The archived ones instead of the others.
        #[arg(long)]
        archived: bool,
    },
    /// Print one as a TOML file for `save`.
    #[command(after_help = "Example:\n  ridged recipe show \"PX-1204 rev C\" --version 2")]
    Show {
        /// Name or number.
        #[arg(value_name = "NAME")]
        name: String,
        /// The version; the newest one by default.
        #[arg(long, value_name = "N")]
        version: Option<i64>,
    },
    /// Save a TOML file: a new one, or a new version of the one with its name.
    #[command(
        after_help = "Example:\n  ridged recipe save px.toml --replaces 2\nThe first line of a file of `show` states the version \
                      that it replaces; --replaces does the same. A newer version of another caller is never overwritten."
    )]
    Save {
        /// The file.
        #[arg(value_name = "FILE.toml")]
        file: PathBuf,
        /// The version that the file replaces, which has to be the newest one.
        #[arg(long, value_name = "N")]
        replaces: Option<i64>,
    },
    /// Archive one: it is kept, and not offered any more.
    #[command(after_help = "Example:\n  ridged recipe archive \"PX-1204 rev C\"")]
    Archive {
        /// Name or number.
        #[arg(value_name = "NAME")]
        name: String,
    },
    /// Restore an archived one.
    #[command(after_help = "Example:\n  ridged recipe restore \"PX-1204 rev C\"")]
    Restore {
        /// Name or number.
        #[arg(value_name = "NAME")]
        name: String,
    },
}

/// Runs `ridged recipe`.
///
/// # Errors
/// No result if no daemon runs, or if there is a newer version; bad input for an unknown name or a wrong file.
pub fn recipes(args: RecipeArgs) -> Result<(), CliError> {
    run::<Recipe>(args.action, &args.daemon)
}

/// Runs `ridged specification`.
///
/// # Errors
/// As [`recipes`].
pub fn specifications(args: SpecificationArgs) -> Result<(), CliError> {
    run::<Specification>(args.action, &args.daemon)
}

fn run<C: Content>(action: Action, daemon: &DaemonArgs) -> Result<(), CliError> {
    let noun = C::KIND.as_str();
    let path = format!("/{noun}s");
    let client = daemon.client()?;
    let order = |name: &str, order: &str| {
        let id = id_of(&client, noun, name)?;
        client.post(&format!("{path}/{id}/{order}"), None)
    };
    let (answer, text) = match action {
        Action::List { archived } => {
            let answer = client.get(&format!("{path}?archived={archived}&limit=1000"))?;
            let rows = answer["items"].as_array().into_iter().flatten();
            let text = rows.map(line).collect();
            (answer, text)
        }
        Action::Show { name, version } => {
            let id = id_of(&client, noun, &name)?;
            let version = version.map_or_else(String::new, |n| format!("?version={n}"));
            let answer = client.get(&format!("{path}/{id}{version}"))?;
            let text = file_of::<C>(noun, &answer)?;
            (answer, text)
        }
        Action::Save { file, replaces } => {
            let answer = save::<C>(&client, &file, replaces)?;
            let text = line(&answer);
            (answer, text)
        }
        Action::Archive { name } => {
            let answer = order(&name, "archive")?;
            let text = line(&answer);
            (answer, text)
        }
        Action::Restore { name } => {
            let answer = order(&name, "restore")?;
            let text = line(&answer);
            (answer, text)
        }
    };
    output::write(daemon.json, &answer, || text)
}

/// Returns the number of the definition with a name, or with this number where no name fits.
fn id_of(client: &Client, noun: &str, name: &str) -> Result<i64, CliError> {
    match named(client, noun, name)? {
        Some(found) => Ok(found["id"].as_i64().unwrap_or_default()),
        None => name.parse().map_err(|_| {
            CliError::bad_input(anyhow!(
                "there is no {noun} `{name}`; `ridged {noun} list` lists them"
            ))
        }),
    }
}

/// Finds a definition by its name, archived or not.
fn named(client: &Client, noun: &str, name: &str) -> Result<Option<Value>, CliError> {
    for archived in ["false", "true"] {
        let query = [("name", name), ("archived", archived)];
        let found = client.search(&format!("/{noun}s"), &query)?["items"][0].clone();
        if !found.is_null() {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

/// Start of the first line of a file of `show`.
const REPLACES: &str = "# replaces version ";

fn file_of<C: Serialize + DeserializeOwned>(
    noun: &str,
    answer: &Value,
) -> Result<String, CliError> {
    let content: C = serde_json::from_value(answer[noun].clone()).map_err(CliError::no_result)?;
    let text = toml::to_string(&content).map_err(CliError::no_result)?;
    Ok(format!("{REPLACES}{}\n{text}", answer["version"]))
}

/// Reads the version that a file of `show` replaces.
fn stated_version(text: &str) -> Option<i64> {
    text.lines()
        .next()?
        .strip_prefix(REPLACES)?
        .trim()
        .parse()
        .ok()
}

fn save<C: Content>(
    client: &Client,
    file: &Path,
    replaces: Option<i64>,
) -> Result<Value, CliError> {
    let noun = C::KIND.as_str();
    let text = std::fs::read_to_string(file)
        .with_context(|| format!("the {noun} {} cannot be read", file.display()))
        .map_err(CliError::BadInput)?;
    let content: C = toml_text::read(&text)
        .map_err(|refused| CliError::bad_input(anyhow!("{}, {refused}", file.display())))?;
    let json = serde_json::to_value(&content).map_err(CliError::no_result)?;
    let Some(before) = named(client, noun, content.name())? else {
        return client.post(&format!("/{noun}s"), Some(&json));
    };
    // Without a stated version, only an unchanged file is sure to overwrite nothing.
    let replaces = replaces.or_else(|| stated_version(&text));
    let (id, newest) = (&before["id"], &before["version"]);
    let body = json!({ "replaces": replaces.unwrap_or(0), noun: json });
    let saved = client.post_in_time(&format!("/{noun}s/{id}/versions"), Some(&body))?;
    saved.ok_or_else(|| {
        let name = content.name();
        CliError::no_result(match replaces {
            Some(replaces) => anyhow!(
                "{noun} `{name}` has version {newest} by {}, and the file replaces version {replaces}; `ridged {noun} show` \
                 prints the newest version",
                before["who"].as_str().unwrap_or_default()
            ),
            None => anyhow!(
                "{noun} `{name}` exists in version {newest}; to replace it, add --replaces {newest}"
            ),
        })
    })
}

/// A definition in one line.
fn line(row: &Value) -> String {
    let id = row["id"].to_string();
    let archived = match row["archived"] == true {
        true => ", archived",
        false => "",
    };
    format!(
        "{id:>6}  {}, version {}{archived} (saved {} by {})\n",
        row["name"].as_str().unwrap_or_default(),
        row["version"],
        utc_words(row["saved_at"].as_str().unwrap_or_default()),
        row["who"].as_str().unwrap_or_default(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shown_file_is_read_back_with_the_version_that_it_replaces() {
        let recipe: Recipe =
            toml_text::read(include_str!("../../docs/examples/recipe.toml")).unwrap();
        let answer = json!({ "version": 3, "recipe": recipe });
        let text = file_of::<Recipe>("recipe", &answer).unwrap();
        assert_eq!(stated_version(&text), Some(3));
        assert_eq!(toml_text::read::<Recipe>(&text).unwrap(), recipe);
        let text = include_str!("../../docs/examples/specification.toml");
        assert_eq!(stated_version(text), None);
        let specification: Specification = toml_text::read(text).unwrap();
        let answer = json!({ "version": 1, "specification": specification });
        let shown = file_of::<Specification>("specification", &answer).unwrap();
        let again: Specification = toml_text::read(&shown).unwrap();
        assert_eq!(again, specification);
    }
}
