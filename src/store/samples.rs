//! Samples: what is measured and its material.

use serde::{Deserialize, Serialize};
use sqlx::FromRow;

use super::earlier::{EARLIER_NAMES, EarlierName};
use super::{Page, PageRequest, Store, StoreError};
use crate::limits;
use crate::material::Material;
use crate::wording::{is_blank, stated};

/// The surface that a simulated rig renders for a sample; a real rig ignores it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "surface", rename_all = "lowercase", deny_unknown_fields)]
pub enum SimulatedSurface {
    /// The path-traced polymer with ridges of 10°.
    Traced,
    /// The closed form at these parameters.
    Model {
        /// Ridge angle.
        #[schema(minimum = 0, maximum = 40)]
        theta_r_deg: f64,
        /// Roughness along the ridges.
        #[schema(minimum = 0.01, maximum = 0.6)]
        alpha_u: f64,
        /// Roughness across the ridges.
        #[schema(minimum = 0.01, maximum = 0.6)]
        alpha_v: f64,
        /// Diffuse reflectance seen outside.
        #[schema(minimum = 0, maximum = 1)]
        rho_d: f64,
    },
}

/// Longest note of a sample, in characters: lists return the notes of many samples.
pub const NOTE_LENGTH_MAX: usize = 4000;

/// A sample to add.
#[derive(Debug, Clone, PartialEq)]
pub struct NewSample {
    /// Name; need not be unique.
    pub name: String,
    /// Index of refraction with uncertainty.
    pub material: Material,
    /// Free text.
    pub note: Option<String>,
    /// Rendered surface, for a simulated rig.
    pub simulated: Option<SimulatedSurface>,
}

impl NewSample {
    /// Returns the field of the first invalid value, and what is wrong with it.
    #[must_use]
    pub fn fault(&self) -> Option<(&'static str, String)> {
        let long = self.name.chars().count() > 200;
        if is_blank(&self.name) || long || self.name.contains(char::is_control) {
            let problem = "must have 1 to 200 characters without line breaks, one of them visible";
            return Some(("name", problem.to_owned()));
        }
        let note = self.note.as_deref().unwrap_or_default();
        if note.chars().count() > NOTE_LENGTH_MAX {
            let problem = format!("must have at most {NOTE_LENGTH_MAX} characters");
            return Some(("note", problem));
        }
        let material: &[_] = match self.material {
            Material::Dielectric { eta, eta_std } => &[
                ("material.eta", eta, limits::RIGS_INDEX),
                ("material.eta_std", eta_std, limits::SAMPLE_K),
            ],
            Material::Conductor {
                eta,
                k,
                eta_std,
                k_std,
            } => &[
                ("material.eta", eta, limits::RIGS_ETA),
                ("material.k", k, limits::SAMPLE_K),
                ("material.eta_std", eta_std, limits::SAMPLE_K),
                ("material.k_std", k_std, limits::SAMPLE_K),
            ],
        };
        let simulated: &[_] = match self.simulated {
            Some(SimulatedSurface::Model {
                theta_r_deg,
                alpha_u,
                alpha_v,
                rho_d,
            }) => &[
                (
                    "simulated.theta_r_deg",
                    theta_r_deg,
                    limits::PAINTED_RIDGE_DEG,
                ),
                ("simulated.alpha_u", alpha_u, limits::PAINTED_ALPHA),
                ("simulated.alpha_v", alpha_v, limits::PAINTED_ALPHA),
                ("simulated.rho_d", rho_d, limits::RHO_D),
            ],
            Some(SimulatedSurface::Traced) | None => &[],
        };
        let mut values = material.iter().chain(simulated);
        let (field, value, limit) = values.find(|(_, value, limit)| !limit.holds(*value))?;
        Some((
            field,
            format!("{} is not within {}", stated(*value), limit.allowed()),
        ))
    }
}

/// A stored sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Number.
    pub id: i64,
    /// Name; need not be unique.
    pub name: String,
    /// Index of refraction with uncertainty.
    pub material: Material,
    /// Free text.
    pub note: Option<String>,
    /// Rendered surface, for a simulated rig.
    pub simulated: Option<SimulatedSurface>,
    /// When it was added, RFC 3339 UTC.
    pub created_at: String,
    /// Names that it had, oldest first.
    pub earlier_names: Vec<EarlierName>,
}

/// Several parts have one name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{} parts have the name `{name}`: {}", ids.len(), in_words(ids))]
pub struct AmbiguousPart {
    /// The name that was asked for.
    pub name: String,
    /// Their numbers, ascending.
    pub ids: Vec<i64>,
}

/// Numbers of parts for a message, the first ten at most.
fn in_words(ids: &[i64]) -> String {
    const LISTED: usize = 10;
    let shown: Vec<String> = ids.iter().take(LISTED).map(i64::to_string).collect();
    let more = if ids.len() > LISTED { ", …" } else { "" };
    format!("{}{more}", shown.join(", "))
}

#[derive(FromRow)]
struct SampleRow {
    id: i64,
    name: String,
    material: String,
    note: Option<String>,
    simulated: Option<String>,
    created_at: String,
    earlier_names: String,
}

impl TryFrom<SampleRow> for Sample {
    type Error = StoreError;

    fn try_from(row: SampleRow) -> Result<Sample, StoreError> {
        let bad = |e| StoreError::bad_row("samples", e);
        Ok(Sample {
            id: row.id,
            name: row.name,
            material: serde_json::from_str(&row.material).map_err(bad)?,
            note: row.note,
            simulated: row
                .simulated
                .as_deref()
                .map(serde_json::from_str)
                .transpose()
                .map_err(bad)?,
            created_at: row.created_at,
            earlier_names: serde_json::from_str(&row.earlier_names).map_err(bad)?,
        })
    }
}

fn select() -> String {
    format!(
        "SELECT p.id, n.name, p.material, p.note, p.simulated, p.created_at, {EARLIER_NAMES} AS earlier_names
         FROM samples p JOIN sample_now n ON n.sample_id = p.id"
    )
}

impl Store {
    /// Adds a sample.
    ///
    /// # Errors
    /// A database error.
    pub async fn add_sample(&self, new: &NewSample) -> Result<Sample, StoreError> {
        let bad = |e| StoreError::bad_row("samples", e);
        let simulated = new
            .simulated
            .map(|s| serde_json::to_string(&s))
            .transpose()
            .map_err(bad)?;
        let mut transaction = self.writing().await?;
        let id = sqlx::query(
            "INSERT INTO samples (name, material, note, simulated, created_at) VALUES (?, ?, ?, ?, ?)",
        )
        .bind(&new.name)
        .bind(serde_json::to_string(&new.material).map_err(bad)?)
        .bind(&new.note)
        .bind(simulated)
        .bind(self.now_text())
        .execute(&mut *transaction)
        .await?
        .last_insert_rowid();
        transaction.commit().await?;
        self.sample(id).await
    }

    /// Returns one sample.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn sample(&self, id: i64) -> Result<Sample, StoreError> {
        let select = select();
        sqlx::query_as::<_, SampleRow>(sqlx::AssertSqlSafe(format!("{select} WHERE p.id = ?")))
            .bind(id)
            .fetch_optional(self.readers())
            .await?
            .ok_or(StoreError::NotFound { noun: "part", id })?
            .try_into()
    }

    /// Returns samples, newest first; with `name`, only samples of this name.
    ///
    /// # Errors
    /// A database error; a row that cannot be read is listed beside the others.
    pub async fn samples(
        &self,
        name: Option<&str>,
        page: PageRequest,
    ) -> Result<Page<Sample>, StoreError> {
        let select = select();
        let rows = sqlx::query_as::<_, SampleRow>(sqlx::AssertSqlSafe(format!(
            "{select} WHERE (?1 IS NULL OR p.id < ?1) AND (?2 IS NULL OR n.name = ?2) ORDER BY p.id DESC LIMIT ?3"
        )))
        .bind(page.cursor)
        .bind(name)
        .bind(page.limit + 1)
        .fetch_all(self.readers())
        .await?;
        Ok(Page::read(rows, page.limit, |row: &SampleRow| row.id))
    }

    /// Returns the sample of a name; none if no sample has it. Old stores, parts of other material and clients may have
    /// several of one name.
    ///
    /// # Errors
    /// [`AmbiguousPart`] where several samples have the name, or a database error.
    pub async fn sample_named(
        &self,
        name: &str,
    ) -> Result<Result<Option<Sample>, AmbiguousPart>, StoreError> {
        let found = self.samples(Some(name), PageRequest::default()).await?;
        let mut ids: Vec<i64> = found.items.iter().map(|sample| sample.id).collect();
        ids.extend(found.damaged.iter().map(|damaged| damaged.id));
        ids.sort_unstable();
        Ok(match ids.len() {
            0 | 1 => Ok(found.items.into_iter().next()),
            _ => Err(AmbiguousPart {
                name: name.to_owned(),
                ids,
            }),
        })
    }

    /// Returns the newest sample; with `name`, the newest of this name.
    ///
    /// # Errors
    /// A database error; rows that cannot be read are skipped.
    pub async fn newest_sample(&self, name: Option<&str>) -> Result<Option<Sample>, StoreError> {
        let mut page = PageRequest::default();
        loop {
            let found = self.samples(name, page).await?;
            if let Some(sample) = found.items.into_iter().next() {
                return Ok(Some(sample));
            }
            match found.next_cursor {
                Some(cursor) => page.cursor = Some(cursor),
                None => return Ok(None),
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::store::tests::{damage, open};

    pub(crate) async fn polymer(store: &Store) -> Sample {
        store
            .add_sample(&NewSample {
                name: "polymer".into(),
                material: Material::Dielectric {
                    eta: 1.54,
                    eta_std: 0.005,
                },
                note: None,
                simulated: Some(SimulatedSurface::Traced),
            })
            .await
            .unwrap()
    }

    #[tokio::test]
    async fn a_damaged_row_does_not_hide_the_others() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        for _ in 0..3 {
            polymer(&store).await;
        }
        damage(&store, "samples", "material = '{\"kind\": \"dielec'", 2).await;
        let page = store.samples(None, PageRequest::default()).await.unwrap();
        let ids: Vec<i64> = page.items.iter().map(|s| s.id).collect();
        assert_eq!(ids, [3, 1]);
        assert_eq!(page.damaged.len(), 1);
        assert_eq!(page.damaged[0].id, 2);
        assert!(page.damaged[0].detail.contains("row of samples"));
        // Read by itself it is an error; a page that ends with it has a cursor beyond it.
        assert!(matches!(
            store.sample(2).await,
            Err(StoreError::BadRow { .. })
        ));
        let first = PageRequest {
            limit: 2,
            cursor: None,
        };
        let first = store.samples(None, first).await.unwrap();
        assert_eq!((first.items.len(), first.next_cursor), (1, Some(2)));
    }

    #[test]
    fn a_name_is_one_line_of_text() {
        let named = |name: &str| NewSample {
            name: name.to_owned(),
            material: Material::exactly(1.5, 0.0),
            note: None,
            simulated: None,
        };
        assert_eq!(named("Prüfling 7 “é”").fault(), None);
        for name in ["", " ", "a\nb", "a\u{1b}[31mb", "x\0y"] {
            let (field, problem) = named(name).fault().unwrap();
            assert_eq!(field, "name");
            assert!(problem.contains("without line breaks"), "{problem}");
        }
    }

    #[tokio::test]
    async fn a_name_of_several_samples_is_ambiguous_and_lists_them() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let named = async || store.sample_named("polymer").await.unwrap();
        assert_eq!(named().await, Ok(None));
        let first = polymer(&store).await;
        assert_eq!(named().await, Ok(Some(first)));
        polymer(&store).await;
        let message = named().await.unwrap_err().to_string();
        assert_eq!(message, "2 parts have the name `polymer`: 1, 2");
    }

    #[tokio::test]
    async fn pages_of_samples_join_without_gap_or_repeat() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        for _ in 0..5 {
            polymer(&store).await;
        }
        let mut ids = Vec::new();
        let mut cursor = None;
        loop {
            let page = store
                .samples(None, PageRequest { limit: 2, cursor })
                .await
                .unwrap();
            ids.extend(page.items.iter().map(|s| s.id));
            cursor = page.next_cursor;
            if cursor.is_none() {
                break;
            }
        }
        assert_eq!(ids, [5, 4, 3, 2, 1]);
    }
}
