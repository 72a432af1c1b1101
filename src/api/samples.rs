//! `/samples`

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::error::{ApiError, Problem};
use super::extract::{Body, Id, Params, page};
use super::{App, List};
use crate::material::{Material, tables};
use crate::series::INDEX_STD;
use crate::store::samples::{NewSample, Sample, SimulatedSurface};

/// Nominal material: complex index N = n + ik with standard uncertainties.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum MaterialBody {
    /// Transparent below the surface.
    Dielectric {
        /// Real part n of the complex index, no unit.
        #[serde(alias = "index_of_refraction")]
        eta: f64,
        /// Standard uncertainty of n; 0.01 if not given.
        #[serde(alias = "index_of_refraction_std", default = "index_std")]
        eta_std: f64,
    },
    /// A metal: opaque below the surface.
    Conductor {
        /// Real part n of the complex index, no unit.
        eta: f64,
        /// Imaginary part k of the complex index, no unit.
        k: f64,
        /// Standard uncertainty of n; 0.01 if not given.
        #[serde(default = "index_std")]
        eta_std: f64,
        /// Standard uncertainty of k; 0.01 if not given.
        #[serde(default = "index_std")]
        k_std: f64,
    },
}

/// The same as in the manifest of a recorded series.
fn index_std() -> f64 {
    INDEX_STD
}

/// What a sample of unknown material is taken for: wide enough for the common plastics, so that the
/// budget of a fit carries what is not known.
const ORDINARY_PLASTIC: MaterialBody = MaterialBody::Dielectric {
    eta: 1.5,
    eta_std: 0.05,
};
/// What the note of such a sample says.
const ASSUMED: &str = "material not given: index 1.5 ± 0.05 assumed (an ordinary plastic)";

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

/// A metal by its name.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MetalBody {
    /// `Ag`, `Al`, `Au`, `Cr`, `Cu` or `W`.
    name: String,
    /// Wavelength; the rig's lamp's if not given.
    #[serde(default)]
    wavelength_nm: Option<f64>,
}

/// A sample to be added.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SampleRequest {
    /// What people call it; 1 to 200 characters.
    name: String,
    /// Nominal material. Without one an ordinary plastic is assumed (index 1.5 ± 0.05), and the
    /// sample's note says so.
    #[serde(default)]
    material: Option<MaterialBody>,
    /// In place of a material: a metal of the tables, taken at the lamp's wavelength.
    #[serde(default)]
    metal: Option<MetalBody>,
    /// Free text for people.
    #[serde(default)]
    note: Option<String>,
    /// How a simulated rig paints it: `{"surface": "traced"}` or
    /// `{"surface": "model", "theta_r_deg", "alpha_u", "alpha_v", "rho_d"}`.
    #[serde(default)]
    #[schema(value_type = Option<Object>)]
    simulated: Option<SimulatedSurface>,
}

/// A sample.
#[derive(Debug, Serialize, ToSchema)]
pub struct SampleBody {
    /// Number of the sample.
    id: i64,
    /// Name of the sample.
    name: String,
    /// Nominal material.
    material: MaterialBody,
    /// Free text for people.
    note: Option<String>,
    /// How a simulated rig draws it; null on a real rig.
    #[schema(value_type = Option<Object>)]
    simulated: Option<SimulatedSurface>,
    /// When the sample was added, RFC 3339 in UTC.
    created_at: String,
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
        }
    }
}

/// Which samples.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct SampleParams {
    /// Of exactly this name.
    name: Option<String>,
    /// Rows at most, 1 to 1000; 100 if not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// Samples, newest first.
#[utoipa::path(get, path = "/api/v1/samples", tag = "samples", params(SampleParams), responses(
    (status = 200, description = "A page of samples", body = List<SampleBody>),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<SampleParams>,
) -> Result<Json<List<SampleBody>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = app.lab.store().samples(params.name.as_deref(), page);
    Ok(Json(found.await?.into()))
}

/// Add a sample.
#[utoipa::path(post, path = "/api/v1/samples", tag = "samples", request_body = SampleRequest, responses(
    (status = 201, description = "The sample", body = SampleBody),
    (status = 400, description = "The body cannot be understood", body = Problem),
    (status = 422, description = "A value makes no sense", body = Problem),
))]
pub(super) async fn add(
    State(app): State<App>,
    Body(body): Body<SampleRequest>,
) -> Result<impl IntoResponse, ApiError> {
    let mut body = body;
    if let Some(metal) = &body.metal {
        if body.material.is_some() {
            let message = "stands in place of a material: give one of them";
            return Err(ApiError::invalid("metal", message));
        }
        let wavelength_nm = match metal.wavelength_nm {
            None => app.lab.rig().await?.rig_facts.wavelength_nm,
            given => given,
        };
        let Some(wavelength_nm) = wavelength_nm else {
            let message = "is not known of this rig's lamp: give it";
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
    Ok((
        StatusCode::CREATED,
        [(header::LOCATION, location)],
        Json(SampleBody::from(sample)),
    ))
}

/// One sample.
#[utoipa::path(get, path = "/api/v1/samples/{id}", tag = "samples", params(("id" = i64, Path, description = "Number of the sample")), responses(
    (status = 200, description = "The sample", body = SampleBody),
    (status = 404, description = "There is none", body = Problem),
))]
pub(super) async fn get(State(app): State<App>, Id(id): Id) -> Result<Json<SampleBody>, ApiError> {
    Ok(Json(app.lab.store().sample(id).await?.into()))
}
