//! What a recipe states: how a part is measured, how the measurement is fitted, and the uncertainty to reach.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::fit::{Loss, VariantChoice};
use crate::lab::definitions::{Content, read};
use crate::lab::jobs::fits::{FitRequest, Prior};
use crate::lab::request_checks::{invalid, positive};
use crate::lab::{Lab, LabError};
use crate::material::Material;
use crate::scan::PlanRequest;
use crate::series::{INDEX_STD, LayoutFacts};
use crate::store::definitions::DefinitionKind;
use crate::store::samples::{NOTE_LENGTH_MAX, NewSample};

/// How a part is measured: the keys of docs/examples/recipe.toml.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Name, 1 to 200 characters. It stays the same in all versions.
    #[schema(min_length = 1, max_length = 200)]
    pub name: String,
    /// Free text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(max_length = 4000)]
    pub note: Option<String>,
    /// Expanded uncertainty (k = 2) of θr to reach, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub target_expanded_deg: Option<f64>,
    /// Poses, exposures, dark frames and white reference.
    pub plan: PlanRequest,
    /// Model and options of the fit that follows the scan.
    #[serde(default, skip_serializing_if = "is_default")]
    pub fit: RecipeFit,
    /// Nominal material of the parts, for parts that are new to the store.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<RecipeMaterial>,
    /// Patches of the parts, where they have several regions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layout: Option<RecipeLayout>,
}

/// The fit of a recipe: options of POST /fits without those of a single scan.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RecipeFit {
    /// Variant of the model; auto if omitted.
    #[serde(skip_serializing_if = "is_default")]
    pub variant: VariantChoice,
    /// The only region to fit; all regions of the layout if omitted.
    #[serde(skip_serializing_if = "is_default")]
    #[schema(max_length = 200)]
    pub region: Option<String>,
    /// Takes the difference to the variant traced as the model error of the budget.
    #[serde(skip_serializing_if = "is_default")]
    pub judge: bool,
    /// Ends search, ray tracer and bootstrap after this time, s.
    #[serde(skip_serializing_if = "is_default")]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub max_seconds: Option<f64>,
    /// Ends the ray tracer once its standard error, as a share of the largest radiance, is below this.
    #[serde(skip_serializing_if = "is_default")]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub target_error: Option<f64>,
    /// Share of the peak that the model may omit.
    #[serde(skip_serializing_if = "is_default")]
    #[schema(exclusive_minimum = 0, exclusive_maximum = 1)]
    pub tolerance: Option<f64>,
    /// Loss function of the residuals; linear if omitted.
    #[serde(skip_serializing_if = "is_default")]
    pub loss: Loss,
    /// Largest number of starts of a search per variant.
    #[serde(skip_serializing_if = "is_default")]
    #[schema(minimum = 1, maximum = 1024)]
    pub starts: Option<u32>,
    /// Adds profile-likelihood intervals.
    #[serde(skip_serializing_if = "is_default")]
    pub profile: bool,
    /// Number of series drawn for bootstrap intervals; none if omitted.
    #[serde(skip_serializing_if = "is_default")]
    #[schema(minimum = 20, maximum = 100_000)]
    pub bootstrap: Option<u32>,
    /// Parameters fixed at a value, by the names of the report, and eta, k: `{"rho_d": 0.3}`.
    #[serde(skip_serializing_if = "is_default")]
    pub fix: BTreeMap<String, f64>,
    /// Priors of parameters, by the same names.
    #[serde(skip_serializing_if = "is_default")]
    pub priors: BTreeMap<String, Prior>,
}

/// Nominal material of a part: complex index N = n + ik with standard uncertainties.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RecipeMaterial {
    /// Real part n of the index.
    #[schema(minimum = 0.01, maximum = 100)]
    pub eta: f64,
    /// Imaginary part k of the index; a metal if it is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 50)]
    pub k: Option<f64>,
    /// Standard uncertainty of n; 0.01 if omitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 50)]
    pub eta_std: Option<f64>,
    /// Standard uncertainty of k; 0.01 if omitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 50)]
    pub k_std: Option<f64>,
}

/// A board of square patches, as `[sample.layout]` of a manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RecipeLayout {
    /// Patches along the sample's x.
    #[schema(minimum = 1, maximum = 65_535)]
    pub patches_x: u32,
    /// Patches along the sample's y.
    #[schema(minimum = 1, maximum = 65_535)]
    pub patches_y: u32,
    /// Side of a patch, mm.
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub patch_size_mm: f64,
    /// Centre of the board from the rotation axis, mm.
    #[serde(default)]
    #[schema(min_items = 2, max_items = 2)]
    pub centre_mm: [f64; 2],
    /// Lean direction of patches with i + j even, in words (`v at phi_s`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(max_length = 1000)]
    pub even_patches: Option<String>,
    /// Lean direction of patches with i + j odd, in words (`v at phi_s + 90 deg`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(max_length = 1000)]
    pub odd_patches: Option<String>,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl From<&RecipeLayout> for LayoutFacts {
    fn from(layout: &RecipeLayout) -> Self {
        LayoutFacts {
            patches_x: layout.patches_x,
            patches_y: layout.patches_y,
            patch_size_mm: layout.patch_size_mm,
            centre_mm: layout.centre_mm,
            even_patches: layout.even_patches.clone(),
            odd_patches: layout.odd_patches.clone(),
            notes: BTreeMap::new(),
        }
    }
}

impl From<RecipeMaterial> for Material {
    fn from(stated: RecipeMaterial) -> Self {
        let RecipeMaterial {
            eta,
            k,
            eta_std,
            k_std,
        } = stated;
        let eta_std = eta_std.unwrap_or(INDEX_STD);
        match k {
            None => Material::Dielectric { eta, eta_std },
            Some(k) => Material::Conductor {
                eta,
                k,
                eta_std,
                k_std: k_std.unwrap_or(INDEX_STD),
            },
        }
    }
}

impl RecipeFit {
    /// The request for the fit of a scan or of one of its regions.
    pub(in crate::lab) fn request(&self, scan_id: i64, region: Option<String>) -> FitRequest {
        FitRequest {
            scan_id,
            variant: self.variant,
            region,
            judge: self.judge,
            iterations: false,
            max_seconds: self.max_seconds,
            target_error: self.target_error,
            tolerance: self.tolerance,
            shape: None,
            loss: self.loss,
            fix: self.fix.clone(),
            priors: self.priors.clone(),
            starts: self.starts,
            profile: self.profile,
            bootstrap: self.bootstrap,
        }
    }

    /// Refuses options that no fit accepts.
    fn check(&self, material: &Material) -> Result<(), LabError> {
        let request = self.request(0, None);
        let checked = request
            .check_values()
            .and_then(|()| request.check_tracer())
            .and_then(|()| request.options(material, None).map(drop));
        checked.map_err(|error| match error {
            LabError::Invalid { field, problem } => invalid(format!("fit.{field}"), problem),
            other => other,
        })
    }
}

impl Recipe {
    /// Reads a stored recipe.
    ///
    /// # Errors
    /// A content that this program cannot read.
    pub fn of_content(content: &serde_json::Value) -> Result<Recipe, LabError> {
        read(content)
    }

    /// Refuses a recipe that no scan of this rig could follow.
    fn refuse_faults(&self, lab: &Lab) -> Result<(), LabError> {
        let note = self.note.as_deref().unwrap_or_default();
        if note.chars().count() > NOTE_LENGTH_MAX {
            let problem = format!("must have at most {NOTE_LENGTH_MAX} characters");
            return Err(invalid("note", problem));
        }
        positive([("target_expanded_deg", self.target_expanded_deg)])?;
        if let Some(RecipeMaterial {
            k: None,
            k_std: Some(_),
            ..
        }) = self.material
        {
            return Err(invalid("material.k_std", "applies only beside k"));
        }
        let material = self.material.map_or_else(
            // The names and the values of constraints are checked with an ordinary plastic.
            || Material::exactly(1.5, 0.0),
            Material::from,
        );
        let part = NewSample {
            name: self.name.clone(),
            material,
            note: None,
            simulated: None,
        };
        if let Some((field, problem)) = part.fault() {
            return Err(invalid(field, problem));
        }
        self.fit.check(&material)?;
        if self.fit.region.is_some() && self.layout.is_none() {
            let problem = "there is no region without a layout: state [layout], or leave it out";
            return Err(invalid("fit.region", problem));
        }
        if self.plan.repeats == Some(0) {
            let problem = "must not be 0: a recipe measures a part";
            return Err(invalid("plan.repeats", problem));
        }
        lab.check_recipe_on_rig(self)
    }
}

impl Content for Recipe {
    const KIND: DefinitionKind = DefinitionKind::Recipe;

    fn name(&self) -> &str {
        &self.name
    }

    fn check(&self, lab: &Lab) -> Result<(), LabError> {
        self.refuse_faults(lab)
    }
}
