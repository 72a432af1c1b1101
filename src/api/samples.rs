//! `/samples`: list, add, read and rename parts.

use axum::Json;
use axum::extract::State;
use axum::response::Response;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::{Body, Id, Params, page};
use super::status::{self, ApiError, Problem};
use super::{App, List};
use crate::material::{Material, tables};
use crate::series::INDEX_STD;
use crate::store::earlier::EarlierName;
use crate::store::samples::{NewSample, Sample, SimulatedSurface};

/// Nominal material: complex index N = n + ik with standard uncertainties.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum MaterialBody {
    /// Transparent below the surface.
    Dielectric {
        /// Real part n of the complex index, no unit.
        #[serde(alias = "index_of_refraction")]
        #[schema(minimum = 1.0001, maximum = 10)]
        eta: f64,
        /// Standard uncertainty of n; 0.01 if omitted.
        #[serde(alias = "index_of_refraction_std", default = "index_std")]
        #[schema(minimum = 0, maximum = 50)]
        eta_std: f64,
    },
    /// A metal: opaque below the surface.
    Conductor {
        /// Real part n of the complex index, no unit.
        #[schema(minimum = 0.01, maximum = 100)]
        eta: f64,
        /// Imaginary part k of the complex index, no unit.
        #[schema(minimum = 0, maximum = 50)]
        k: f64,
        /// Standard uncertainty of n; 0.01 if omitted.
        #[serde(default = "index_std")]
        #[schema(minimum = 0, maximum = 50)]
        eta_std: f64,
        /// Standard uncertainty of k; 0.01 if omitted.
        #[serde(default = "index_std")]
        #[schema(minimum = 0, maximum = 50)]
        k_std: f64,
    },
}

/// Kind of a material.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum MaterialKind {
    Dielectric,
    Conductor,
}

/// A material as it is read. An enumeration tagged by its kind would lose the path of a wrong value.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MaterialFields {
    kind: MaterialKind,
    #[serde(alias = "index_of_refraction")]
    eta: f64,
    #[serde(default)]
    k: Option<f64>,
    #[serde(default = "index_std", alias = "index_of_refraction_std")]
    eta_std: f64,
    #[serde(default)]
    k_std: Option<f64>,
}

/// Default of the standard uncertainty of an index, the same as in the manifest of a recorded series.
fn index_std() -> f64 {
    INDEX_STD
}

impl<'de> Deserialize<'de> for MaterialBody {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        const OF_DIELECTRIC: &[&str] = &["kind", "eta", "eta_std"];
        let MaterialFields {
            kind,
            eta,
            k,
            eta_std,
            k_std,
        } = MaterialFields::deserialize(from)?;
        match (kind, k, k_std) {
            (MaterialKind::Dielectric, None, None) => Ok(MaterialBody::Dielectric { eta, eta_std }),
            (MaterialKind::Dielectric, Some(_), _) => {
                Err(D::Error::unknown_field("k", OF_DIELECTRIC))
            }
            (MaterialKind::Dielectric, None, Some(_)) => {
                Err(D::Error::unknown_field("k_std", OF_DIELECTRIC))
            }
            (MaterialKind::Conductor, Some(k), k_std) => Ok(MaterialBody::Conductor {
                eta,
                k,
                eta_std,
                k_std: k_std.unwrap_or(INDEX_STD),
            }),
            (MaterialKind::Conductor, None, _) => Err(D::Error::missing_field("k")),
        }
    }
}

/// Material of a part whose material is unknown. Its uncertainty covers the common plastics and enters the budget
/// of a fit.
const ORDINARY_PLASTIC: MaterialBody = MaterialBody::Dielectric {
    eta: 1.5,
    eta_std: 0.05,
};
/// Note of such a part.
const ASSUMED: &str = "material not given: index 1.5 (u = 0.05) assumed (an ordinary plastic)";

impl From<MaterialBody> for Material {
    fn from(body: MaterialBody) -> Self {
        match body {
            MaterialBody::Dielectric { eta, eta_std } => Material::Dielectric { eta, eta_std },
            MaterialBody::Conductor {
                eta,
                k,
                eta_std,
                k_std,
            } => Material::Conductor {
                eta,
                k,
                eta_std,
                k_std,
            },
        }
    }
}

impl From<Material> for MaterialBody {
    fn from(material: Material) -> Self {
        match material {
            Material::Dielectric { eta, eta_std } => MaterialBody::Dielectric { eta, eta_std },
            Material::Conductor {
                eta,
                k,
                eta_std,
                k_std,
            } => MaterialBody::Conductor {
                eta,
                k,
                eta_std,
                k_std,
            },
        }
    }
}

/// A metal of the tables, by its name.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MetalBody {
    /// `Ag`, `Al`, `Au`, `Cr`, `Cu` or `W`.
    #[schema(max_length = 2)]
    name: String,
    /// Wavelength, nm; that of the rig's lamp if omitted.
    #[serde(default)]
    #[schema(minimum = 100, maximum = 100_000)]
    wavelength_nm: Option<f64>,
}

/// A part to add.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SampleRequest {
    /// Name, 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200)]
    name: String,
    /// Nominal material. If omitted, an ordinary plastic is assumed (index 1.5, u = 0.05), and the
    /// part's note states so.
    #[serde(default)]
    material: Option<MaterialBody>,
    /// Instead of a material: a metal of the tables, at the lamp's wavelength.
    #[serde(default)]
    metal: Option<MetalBody>,
    /// Free text.
    #[serde(default)]
    #[schema(max_length = 4000)]
    note: Option<String>,
    /// How a simulated rig renders it: `{"surface": "traced"}` or
    /// `{"surface": "model", "theta_r_deg", "alpha_u", "alpha_v", "rho_d"}`.
    #[serde(default)]
    simulated: Option<SimulatedSurface>,
}

/// A part.
#[derive(Debug, Serialize, ToSchema)]
pub struct SampleBody {
    /// Number of the part.
    id: i64,
    /// Name of the part.
    name: String,
    /// Nominal material.
    material: MaterialBody,
    /// Free text.
    note: Option<String>,
    /// How a simulated rig renders it; null on a real rig.
    simulated: Option<SimulatedSurface>,
    /// When the part was added, RFC 3339 in UTC.
    created_at: String,
    /// Names that it had, oldest first.
    earlier_names: Vec<EarlierName>,
}

impl From<Sample> for SampleBody {
    fn from(sample: Sample) -> Self {
        SampleBody {
            id: sample.id,
            name: sample.name,
            material: sample.material.into(),
            note: sample.note,
            simulated: sample.simulated,
            created_at: sample.created_at,
            earlier_names: sample.earlier_names,
        }
    }
}

/// Filter of the list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct SampleParams {
    /// Parts of exactly this name.
    name: Option<String>,
    /// Largest number of rows, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Parts, newest first.
#[utoipa::path(get, path = "/api/v1/samples", tag = "samples", params(SampleParams), responses(
    (status = 200, description = "A page of parts", body = List<SampleBody>),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<SampleParams>,
) -> Result<Json<List<SampleBody>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = app.lab.store().samples(params.name.as_deref(), page);
    Ok(Json(found.await?.into()))
}

/// Add a part.
#[utoipa::path(post, path = "/api/v1/samples", tag = "samples", request_body = SampleRequest, responses(
    (status = 201, description = "The part", body = SampleBody),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn add(
    State(app): State<App>,
    Body(body): Body<SampleRequest>,
) -> Result<Response, ApiError> {
    let mut body = body;
    if let Some(metal) = &body.metal {
        if body.material.is_some() {
            let message = "give either a material or a metal, not both";
            return Err(ApiError::invalid("metal", message));
        }
        let wavelength_nm = match metal.wavelength_nm {
            None => app.lab.rig().await?.rig_facts.wavelength_nm,
            given => given,
        };
        let Some(wavelength_nm) = wavelength_nm else {
            let message = "is missing, and the rig's settings do not state that of the lamp";
            return Err(ApiError::invalid("metal.wavelength_nm", message));
        };
        let found = tables::metal(&metal.name, wavelength_nm)
            .map_err(|e| ApiError::invalid("metal", e.to_string()))?;
        body.material = Some(found.into());
    }
    let note = match (body.material, body.note) {
        (Some(_), note) => note,
        (None, None) => Some(ASSUMED.to_owned()),
        (None, Some(note)) => Some(format!("{note} ({ASSUMED})")),
    };
    let new = NewSample {
        name: body.name,
        material: body.material.unwrap_or(ORDINARY_PLASTIC).into(),
        note,
        simulated: body.simulated,
    };
    let sample = app.lab.add_sample(&new).await?;
    let location = format!("/api/v1/samples/{}", sample.id);
    Ok(status::created(location, SampleBody::from(sample)))
}

/// One part.
#[utoipa::path(get, path = "/api/v1/samples/{id}", tag = "samples", params(("id" = i64, Path, description = "Number of the part")), responses(
    (status = 200, description = "The part", body = SampleBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn get(State(app): State<App>, Id(id): Id) -> Result<Json<SampleBody>, ApiError> {
    Ok(Json(app.lab.store().sample(id).await?.into()))
}

/// Another name for a part.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenameBody {
    /// Name, 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200)]
    name: String,
}

/// Rename a part. The earlier names stay on record.
#[utoipa::path(patch, path = "/api/v1/samples/{id}", tag = "samples", params(("id" = i64, Path, description = "Number of the part")),
    request_body = RenameBody, responses(
    (status = 200, description = "The part", body = SampleBody),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "Another part has this name (`name-taken`)", body = Problem),
    (status = 422, description = "The name is not valid", body = Problem),
    (status = 503, description = "The store cannot be written (`store-locked`, `disk-silent`, `data-folder-gone`)", body = Problem),
    (status = 507, description = "The disk is full (`disk-full`)", body = Problem),
))]
pub(super) async fn rename(
    Caller(app): Caller,
    Id(id): Id,
    Body(body): Body<RenameBody>,
) -> Result<Json<SampleBody>, ApiError> {
    Ok(Json(app.lab.rename_sample(id, &body.name).await?.into()))
}
