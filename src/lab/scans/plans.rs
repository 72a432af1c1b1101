//! Starts and resumes scans: plan, calibrations, disk space, rig.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use tokio::sync::oneshot;

use super::recipes::Recipe;
use super::scan_run::{ScanRow, ScanWork};
use crate::bench::stage::{Stage, StageSettings};
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::lab::definitions::{NameOrId, find};
use crate::lab::request_checks::invalid;
use crate::lab::rig::work::Work;
use crate::lab::tasks::{blocking, to_the_end};
use crate::lab::{Lab, LabError};
use crate::material::Material;
use crate::scan::plan::{self, Estimate, PlanProblem};
use crate::scan::reference::{ReferenceRules, Times};
use crate::scan::{OperatorAction, Plan, PlanError, PlanRequest, ScanState, Step};
use crate::series::{DarkFacts, FlatFacts, LayoutFacts, Manifest, SCHEMA, SampleFacts, SampleKind};
use crate::store::definitions::DefinitionKind;
use crate::store::scans::{NewScan, Scan, ScanPurpose};
use crate::store::{StoreError, utc_text};
use crate::wording::differences::{self, Difference};
use crate::wording::is_blank;

/// How far in the future a calibration may be dated. Clock corrections are smaller than this; a later date comes from a
/// wrong clock, so the age is unknown.
const AHEAD: Duration = Duration::from_secs(60);

/// A request for a scan: of a plan, or of a recipe.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ScanRequest {
    /// Number of the part to scan.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub sample_id: i64,
    /// Poses, exposures and repeats of the scan. Required without a recipe.
    #[serde(default)]
    pub plan: Option<PlanRequest>,
    /// The recipe instead of a plan, by name or number, in its newest version. The fit that follows uses its model and
    /// options.
    #[serde(default)]
    pub recipe: Option<NameOrId>,
    /// The specification that the scan is judged against once it is fitted, by name or number, in its newest version.
    #[serde(default)]
    pub specification: Option<NameOrId>,
    /// The person at the rig, at most 200 characters.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub operator_name: Option<String>,
    /// Lot of the part, at most 200 characters.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub lot: Option<String>,
    /// Number of the part or order in another system, at most 200 characters.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub external_id: Option<String>,
}

/// Longest text of a request, in characters.
pub(in crate::lab) const TEXT_LENGTH_MAX: usize = 200;

impl ScanRequest {
    /// A request that states only sample and plan.
    #[must_use]
    pub fn of(sample_id: i64, plan: PlanRequest) -> Self {
        ScanRequest {
            sample_id,
            plan: Some(plan),
            ..ScanRequest::default()
        }
    }
}

/// Refuses texts that are empty or too long, by field.
pub(in crate::lab) fn check_texts<const N: usize>(
    texts: [(&str, &Option<String>); N],
) -> Result<(), LabError> {
    for (field, text) in texts {
        let Some(text) = text else { continue };
        let length = text.chars().count();
        if is_blank(text) || length > TEXT_LENGTH_MAX || text.chars().any(char::is_control) {
            let problem = format!(
                "must have 1 to {TEXT_LENGTH_MAX} characters without line breaks, one of them visible; leave it out if there is none"
            );
            return Err(invalid(field, problem));
        }
    }
    Ok(())
}

/// A request with what its recipe and its specification state.
struct Resolved {
    plan: PlanRequest,
    layout: Option<LayoutFacts>,
    purpose: ScanPurpose,
}

/// The estimated cost of a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimated {
    /// The plan without the frames that valid calibrations replace.
    pub plan: Plan,
    /// Time and disk space.
    pub estimate: Estimate,
    /// Free disk space.
    pub free_bytes: u64,
    /// Disk space that scans leave free.
    pub reserve_bytes: u64,
    /// Operator steps, in order.
    pub operator_steps: Vec<OperatorAction>,
    /// Calibrations of earlier scans that the scan uses.
    pub calibration_ids: Vec<i64>,
}

impl Estimated {
    /// Checks that the frames have room on the disk.
    ///
    /// # Errors
    /// [`LabError::NoRoom`].
    pub fn check_room(&self) -> Result<(), LabError> {
        let needed = self.estimate.disk_bytes;
        if self.free_bytes >= needed.saturating_add(self.reserve_bytes) {
            return Ok(());
        }
        Err(LabError::NoRoom {
            needed_mb: needed.div_ceil(1_000_000),
            reserve_mb: self.reserve_bytes.div_ceil(1_000_000),
            free_mb: self.free_bytes / 1_000_000,
        })
    }
}

impl Lab {
    /// Estimates the cost of a scan. Nothing moves and nothing is stored.
    ///
    /// # Errors
    /// [`LabError::Plan`] with all problems of the plan, an unknown sample, or a store error.
    pub async fn estimate(&self, request: &ScanRequest) -> Result<Estimated, LabError> {
        self.store().sample(request.sample_id).await?;
        let resolved = self.resolved(request).await?;
        self.estimate_plan(&resolved.plan).await
    }

    async fn estimate_plan(&self, request: &PlanRequest) -> Result<Estimated, LabError> {
        let side = self.side()?;
        let limits = self.limits()?;
        let mut plan = request.resolve(&side.settings.defaults)?;
        plan.check(&limits)?;
        plan.check_points(side.settings.runner.frame_bytes_max)?;
        let calibration_ids = match plan.reuse_calibrations {
            true => self.reuse(&mut plan).await?,
            false => Vec::new(),
        };
        let start = self.last_pose().await;
        let (stage, settings) = (side.access.stage(), side.stage_settings.clone());
        let frame_bytes_max = side.settings.runner.frame_bytes_max;
        let reference = ReferenceRules {
            every: plan.reference_every,
            ..side.settings.runner.reference
        };
        let alone = Arc::clone(&self.inner.estimating).lock_owned().await;
        let free_bytes = self.store().free_bytes().await?;
        let reserve_bytes = side.settings.runner.disk_reserve_bytes;
        blocking(move || {
            let _alone = alone;
            let move_time = |from, to| match &stage {
                Some(stage) => stage.predicted_move(from, to),
                None => settings.predicted_move(from, to),
            };
            let steps = plan.steps(&limits, start, &move_time);
            check_regions(&steps, &settings)?;
            let of_a_person = |step: &Step| match step {
                Step::Operator(action) => Some(*action),
                Step::Shot(_) => None,
            };
            let mut estimate = plan::estimate(&steps, start, &move_time, frame_bytes_max);
            let slips_show = stage.as_ref().is_some_and(Stage::shows_slips);
            let move_times = match &stage {
                Some(stage) => stage.move_times(),
                None => settings.move_times(),
            };
            let times = Times {
                of_move: &move_time,
                of_homing: &|from| move_times.predict_homing(from),
            };
            let checks = reference.predicted(&steps, start, &limits, times, slips_show);
            estimate.duration_s += checks.as_secs_f64();
            Ok(Estimated {
                estimate,
                free_bytes,
                reserve_bytes,
                operator_steps: steps.iter().filter_map(of_a_person).collect(),
                calibration_ids,
                plan,
            })
        })
        .await?
    }

    /// Finds the recipe and the specification that a request names.
    async fn resolved(&self, request: &ScanRequest) -> Result<Resolved, LabError> {
        check_texts([
            ("operator_name", &request.operator_name),
            ("lot", &request.lot),
            ("external_id", &request.external_id),
        ])?;
        let mut purpose = ScanPurpose {
            operator_name: request.operator_name.clone(),
            lot: request.lot.clone(),
            external_id: request.external_id.clone(),
            ..ScanPurpose::default()
        };
        if let Some(wanted) = &request.specification {
            let kind = DefinitionKind::Specification;
            let found = find(self.store(), kind, wanted, "specification").await?;
            purpose.specification_version_id = Some(found.version_id);
        }
        let (plan, layout) = match (&request.plan, &request.recipe) {
            (Some(plan), None) => (plan.clone(), None),
            (None, Some(wanted)) => {
                let kind = DefinitionKind::Recipe;
                let found = find(self.store(), kind, wanted, "recipe").await?;
                let recipe = Recipe::of_content(&found.content)?;
                purpose.recipe_version_id = Some(found.version_id);
                (recipe.plan, recipe.layout.as_ref().map(LayoutFacts::from))
            }
            (None, None) => {
                return Err(invalid("plan", "is missing: give a plan or a recipe"));
            }
            (Some(_), Some(_)) => {
                let problem = "a recipe states its own plan: leave out one of the two";
                return Err(invalid("recipe", problem));
            }
        };
        Ok(Resolved {
            plan,
            layout,
            purpose,
        })
    }

    /// Refuses a recipe that this rig cannot follow; without a rig nothing is known.
    pub(in crate::lab) fn check_recipe_on_rig(&self, recipe: &Recipe) -> Result<(), LabError> {
        let Ok(side) = self.side() else {
            return Ok(());
        };
        let plan = recipe.plan.resolve(&side.settings.defaults)?;
        plan.check(&self.limits()?)?;
        plan.check_points(side.settings.runner.frame_bytes_max)?;
        let layout = recipe.layout.as_ref().map(LayoutFacts::from);
        let material = Material::exactly(1.5, 0.0);
        let manifest = self.manifest_for(&recipe.name, &material, layout, &plan)?;
        let regions = Lab::regions(&manifest);
        match &recipe.fit.region {
            Some(region) if !regions.contains(region) => Err(invalid(
                "fit.region",
                format!("expected one of {}, got `{region}`", regions.join(", ")),
            )),
            _ => Ok(()),
        }
    }

    /// Removes the frames that valid calibrations replace from a plan, and returns the calibrations' numbers.
    async fn reuse(&self, plan: &mut Plan) -> Result<Vec<i64>, LabError> {
        let side = self.side()?;
        let now = self.clock().utc();
        let until = utc_text(now + AHEAD);
        let usable = async |kind, exposures_s: &[f64], theta_c_deg: &[f64], valid: Duration| {
            let since = utc_text(now - valid);
            let store = self.store();
            store
                .usable_calibrations(kind, side.id, exposures_s, theta_c_deg, &since, &until)
                .await
        };
        let dark = async |exposures_s: &[f64]| {
            let all = usable(FrameKind::Dark, exposures_s, &[], side.settings.dark_valid).await?;
            Ok::<_, LabError>(all.into_iter().next().map(|dark| dark.id))
        };
        let mut ids = Vec::new();
        let all_exposures_s = plan.all_exposures_s();
        let mut dark_id = None;
        if plan.dark.repeats > 0 {
            dark_id = dark(&all_exposures_s).await?;
        }
        if plan.flat.repeats > 0 {
            let (exposures_s, tilts) = (&plan.flat.exposures_s, &plan.flat.theta_c_deg);
            let valid = side.settings.flat_valid;
            let flats = usable(FrameKind::Flat, exposures_s, tilts, valid).await?;
            for flat in flats {
                if !self.is_of_this_white_reference(flat.scan_id).await? {
                    continue;
                }
                // The plan's own dark frames have the sample's exposures.
                let own = |s: &f64| plan.exposures_s.iter().any(|e| (e - s).abs() < 1e-9);
                let others: Vec<f64> = exposures_s.iter().copied().filter(|s| !own(s)).collect();
                if plan.dark.repeats > 0 && dark_id.is_none() && !others.is_empty() {
                    let Some(id) = dark(&others).await? else {
                        break;
                    };
                    ids.push(id);
                }
                ids.push(flat.id);
                plan.flat.repeats = 0;
                break;
            }
        }
        if let Some(id) = dark_id {
            ids.insert(0, id);
            plan.dark.repeats = 0;
        }
        Ok(ids)
    }

    /// Returns whether a scan used the white reference that the settings now describe.
    async fn is_of_this_white_reference(&self, scan_id: i64) -> Result<bool, LabError> {
        let then = self.store().manifest(scan_id).await?;
        let then = Manifest::from_toml(&then, "manifest.toml").map_err(LabError::from)?;
        let now = &self.side()?.settings.flat;
        let facts = |flat: &FlatFacts| (flat.reflectance, flat.reflectance_std);
        Ok(then.flat.as_ref().is_some_and(|then| {
            let certificates = then.certificate().zip(now.certificate());
            certificates.is_none_or(|(then, now)| then == now) && facts(then) == facts(now)
        }))
    }

    /// Returns the pose of the stages, or the middle if they do not answer.
    async fn last_pose(&self) -> Pose {
        let stage = match self.side() {
            Ok(side) => side.access.stage(),
            Err(_) => None,
        };
        match stage {
            Some(stage) => match stage.status().await {
                Ok(status) => status.pose(),
                Err(_) => Pose::from_deg(0.0, 0.0),
            },
            None => Pose::from_deg(0.0, 0.0),
        }
    }

    /// Starts a scan and returns it in state planned; events report its course.
    ///
    /// # Errors
    /// [`LabError::Plan`], [`LabError::NoRoom`], [`LabError::Busy`], or [`LabError::Stage`].
    pub async fn start_scan(&self, request: &ScanRequest) -> Result<Scan, LabError> {
        let (lab, request) = (self.clone(), request.clone());
        // A client that disconnects between the row and the rig's answer would leave a planned scan that never starts.
        to_the_end(async move {
            // Nothing begins later, after a person was refused.
            lab.store()
                .check_writing(super::commands::ORDER_ANSWER)
                .await?;
            lab.plan_and_begin(&request, None).await
        })
        .await
    }

    /// Starts the scan of an order of the queue.
    ///
    /// # Errors
    /// As [`Lab::start_scan`].
    pub(in crate::lab) async fn start_ordered_scan(
        &self,
        request: &ScanRequest,
        order_id: i64,
    ) -> Result<Scan, LabError> {
        self.plan_and_begin(request, Some(order_id)).await
    }

    async fn plan_and_begin(
        &self,
        request: &ScanRequest,
        order_id: Option<i64>,
    ) -> Result<Scan, LabError> {
        let sample = self.store().sample(request.sample_id).await?;
        // Once, so that plan and purpose are of the same version of the recipe.
        let Resolved {
            plan,
            layout,
            purpose,
        } = self.resolved(request).await?;
        let estimated = self.estimate_plan(&plan).await?;
        let side = self.side()?;
        estimated.check_room()?;
        // An unreachable rig is an error before the scan gets its row.
        self.request(Work::Connect).await?;
        let manifest =
            self.manifest_for(&sample.name, &sample.material, layout, &estimated.plan)?;
        let plan = estimated.plan;
        let new = NewScan {
            sample_id: sample.id,
            rig_id: Some(side.id),
            name: sample.name,
            plan: Some(plan.clone()),
            manifest: manifest.to_toml(),
            frames_csv: None,
            calibration_ids: estimated.calibration_ids,
            purpose: ScanPurpose {
                order_id,
                ..purpose
            },
            who: self.who.to_string(),
        };
        let (reply, row) = oneshot::channel();
        let work = ScanWork {
            row: ScanRow::New(Box::new(new), reply),
            plan,
            done: Default::default(),
            full: Default::default(),
            elapsed_s: 0.0,
            first_state: None,
        };
        self.request(Work::Scan(Box::new(work))).await?;
        Ok(row.await.map_err(|_| LabError::Stopping)??)
    }

    /// Resumes an interrupted scan: committed points stay, the others are taken.
    pub(in crate::lab) async fn resume(&self, scan: &Scan) -> Result<ScanState, LabError> {
        let side = self.side()?;
        let (Some(plan), Some(rig_id)) = (scan.plan.clone(), scan.rig_id) else {
            return Err(LabError::NotOfThisRig {
                scan_id: scan.id,
                why: "it is an import, which has no frames left to take".into(),
            });
        };
        if rig_id != side.id {
            return Err(LabError::NotOfThisRig {
                scan_id: scan.id,
                why: self.other_rig(rig_id, side.id).await?,
            });
        }
        plan.check(&self.limits()?)?;
        self.request(Work::Connect).await?;
        let done = self.store().shots_done(scan.id).await?;
        let full = self.store().shots_full(scan.id).await?;
        // The state stays interrupted until the runner reports another; a runner that cannot record it sends no event.
        let (first_state, state) = oneshot::channel();
        let work = ScanWork {
            row: ScanRow::Kept(scan.id),
            plan,
            done: done.into_iter().collect(),
            full: full.into_iter().collect(),
            elapsed_s: self.store().last_progress(scan.id).await?.elapsed_s,
            first_state: Some(first_state),
        };
        self.request(Work::Scan(Box::new(work))).await?;
        Ok(state.await.map_err(|_| LabError::Stopping)??)
    }

    /// Lists the settings that changed since a scan was started: its frames would come from two different rigs.
    async fn other_rig(&self, then: i64, now: i64) -> Result<String, LabError> {
        let settings = async |id| {
            let text = self.store().rig_settings(id).await?;
            let settings = serde_json::from_str::<serde_json::Value>(&text);
            settings.map_err(|e| LabError::from(StoreError::bad_row("rigs", e)))
        };
        let differences = differences::between(&settings(then).await?, &settings(now).await?);
        let as_in_the_file = |mut difference: Difference| {
            // Sections have the names of the settings file.
            difference.key = match difference.key.as_str() {
                "camera_is" => "the camera".into(),
                "label" => "the simulated rig".into(),
                key => key.replacen("stages.", "stage.", 1),
            };
            difference
        };
        let differences: Vec<Difference> = differences.into_iter().map(as_in_the_file).collect();
        Ok(format!(
            "the rig's settings have changed since the scan was started ({}); restore them and start again, or plan a new scan",
            differences::in_words(&differences)
        ))
    }

    /// Returns the manifest that a reduction of the scan will read.
    fn manifest_for(
        &self,
        name: &str,
        material: &Material,
        layout: Option<LayoutFacts>,
        plan: &Plan,
    ) -> Result<Manifest, LabError> {
        let settings = &self.side()?.settings;
        let mut camera = settings.camera.clone();
        camera.exposures_s = plan.exposures_s.clone();
        let has_layout = layout.is_some();
        let manifest = Manifest {
            schema: SCHEMA.into(),
            name: name.to_owned(),
            frames: "frames.csv".into(),
            notes: Default::default(),
            rig: settings.rig.clone(),
            camera,
            flat: Some(settings.flat.clone()),
            dark: Some(DarkFacts::default()),
            sample: SampleFacts {
                layout,
                ..sample_facts(material)
            },
        };
        // The settings of the rig were checked when they were read.
        if has_layout && let Err(error) = Manifest::from_toml(&manifest.to_toml(), "layout") {
            return Err(invalid("layout", error.to_string()));
        }
        Ok(manifest)
    }
}

/// Refuses a plan with points in forbidden regions, or with points between which no way is free. The way to the first point
/// is checked when it is taken.
fn check_regions(steps: &[Step], settings: &StageSettings) -> Result<(), LabError> {
    let mut problems = Vec::new();
    let mut at: Option<Pose> = None;
    for step in steps {
        let Step::Shot(shot) = step else { continue };
        let Some(target) = shot.target else { continue };
        let blocked = match (settings.region_at(target), at) {
            (Some(region), _) => Some(format!(
                "theta_c = {}, phi_s = {} is in the forbidden region {region}",
                target.theta_c, target.phi_s
            )),
            (None, Some(from)) => settings
                .check_way(from, target)
                .err()
                .map(|error| error.to_string()),
            (None, None) => None,
        };
        match blocked {
            Some(why) => problems.push(PlanProblem::new(format!("plan point {}", shot.index), why)),
            None => at = Some(target),
        }
    }
    match problems.is_empty() {
        true => Ok(()),
        false => Err(PlanError { problems }.into()),
    }
}

/// Returns `[sample]` of a manifest for a nominal material.
pub(in crate::lab) fn sample_facts(material: &Material) -> SampleFacts {
    let blank = SampleFacts {
        metal: None,
        kind: SampleKind::Dielectric,
        index_of_refraction: None,
        index_of_refraction_std: None,
        eta: None,
        k: None,
        eta_std: None,
        k_std: None,
        pitch_length_um: None,
        translucency: None,
        translucency_std: None,
        notes: Default::default(),
        layout: None,
    };
    match *material {
        Material::Dielectric { eta, eta_std } => SampleFacts {
            index_of_refraction: Some(eta),
            index_of_refraction_std: Some(eta_std),
            ..blank
        },
        Material::Conductor {
            eta,
            k,
            eta_std,
            k_std,
        } => SampleFacts {
            kind: SampleKind::Conductor,
            eta: Some(eta),
            k: Some(k),
            eta_std: Some(eta_std),
            k_std: Some(k_std),
            ..blank
        },
    }
}

impl Lab {
    /// Returns the time until which a calibration is valid, and whether it still is.
    ///
    /// # Errors
    /// A creation time that cannot be parsed.
    pub fn calibration_valid_until(
        &self,
        kind: FrameKind,
        created_at: &str,
    ) -> Result<(OffsetDateTime, bool), LabError> {
        let created = crate::store::utc_of(created_at)
            .ok_or_else(|| StoreError::bad_row("calibrations", created_at))?;
        let valid = match &self.inner.rig {
            None => Duration::ZERO,
            Some(side) if kind == FrameKind::Dark => side.settings.dark_valid,
            Some(side) => side.settings.flat_valid,
        };
        let (now, until) = (self.clock().utc(), created + valid);
        Ok((until, now <= until && created <= now + AHEAD))
    }
}
