//! Reductions: the observations of a scan with everything else that a fit reads.

use serde::{Deserialize, Serialize};
use sqlx::FromRow;

use super::{PROGRAM, Store, StoreError};
use crate::geometry::{Cones, Directions, Field, Imaging, Pose, RigGeometry};
use crate::material::Material;
use crate::observation::{
    DetectorCurve, FlatObservation, Observation, ObservationSet, PowerLaw, Prior, RejectedFrame,
    SharedErrors, View, WhiteReference, WholeField,
};
use crate::units::Angle;

/// Everything of an [`ObservationSet`] but the observations, in degrees, as JSON.
#[derive(Serialize, Deserialize)]
struct Context {
    theta_l_deg: f64,
    light_azimuth_deg: f64,
    azimuth_zero_deg: f64,
    light_angular_radius_deg: f64,
    #[serde(default)]
    lens_angular_radius_deg: f64,
    material: Material,
    /// Tilt in degrees, signal, sigma.
    flats: Vec<(f64, f64, f64)>,
    /// Reflectance and its standard uncertainty.
    white_reference: Option<(f64, f64)>,
    /// For a near camera or lamp: per observation, views as lamp x, y, z, camera x, y, z, weight.
    #[serde(default)]
    views: Vec<Vec<[f64; 7]>>,
    /// What these views stand for; `None` in older rows.
    #[serde(default)]
    field: Option<FieldColumns>,
    /// Mean and standard uncertainty.
    background: (f64, f64),
    /// Per observation; empty in older rows, which have no times.
    #[serde(default)]
    taken_s: Vec<Option<f64>>,
    #[serde(default)]
    wedge_std_deg: Option<f64>,
    #[serde(default)]
    azimuth_zero_std_deg: Option<f64>,
    #[serde(default)]
    theta_l_std_deg: Option<f64>,
    #[serde(default)]
    dark_std: f64,
    /// Mean and standard uncertainty.
    #[serde(default)]
    translucency: Option<(f64, f64)>,
    /// Per flat, the times of its frames; empty in older rows.
    #[serde(default)]
    times_of_flats_s: Vec<Vec<f64>>,
    #[serde(default)]
    detector: Option<DetectorCurve>,
    #[serde(default)]
    power_law: Option<PowerLaw>,
    /// Per observation; empty in older rows.
    #[serde(default)]
    detector_errors: Vec<f64>,
    region_azimuth_deg: f64,
    n_frames_used: u32,
    rejected_frames: Vec<RejectedFrame>,
    warnings: Vec<String>,
}

/// A [`WholeField`]; its rig is that of the set.
#[derive(Serialize, Deserialize)]
struct FieldColumns {
    pixel_mm: [f64; 2],
    tilt_centre_px: [f64; 2],
    principal_point_px: [f64; 2],
    rotation_axis_px: [f64; 2],
    camera_mm: Option<f64>,
    light_mm: Option<f64>,
    width_px: usize,
    height_px: usize,
    narrowest_alpha: f64,
}

impl FieldColumns {
    fn of(whole: &WholeField) -> Self {
        let WholeField { field, narrowest } = *whole;
        let imaging = field.imaging;
        FieldColumns {
            pixel_mm: imaging.pixel_mm,
            tilt_centre_px: imaging.tilt_centre_px,
            principal_point_px: imaging.principal_point_px,
            rotation_axis_px: imaging.rotation_axis_px,
            camera_mm: imaging.camera_mm,
            light_mm: imaging.light_mm,
            width_px: field.width,
            height_px: field.height,
            narrowest_alpha: narrowest,
        }
    }

    fn on(&self, rig: RigGeometry) -> WholeField {
        WholeField {
            field: Field {
                imaging: Imaging {
                    rig,
                    pixel_mm: self.pixel_mm,
                    tilt_centre_px: self.tilt_centre_px,
                    principal_point_px: self.principal_point_px,
                    rotation_axis_px: self.rotation_axis_px,
                    camera_mm: self.camera_mm,
                    light_mm: self.light_mm,
                },
                width: self.width_px,
                height: self.height_px,
            },
            narrowest: self.narrowest_alpha,
        }
    }
}

#[derive(FromRow)]
struct ObservationRow {
    theta_c_deg: f64,
    phi_s_deg: f64,
    signal: f64,
    sigma: f64,
    white_reference: f64,
    led_drift: f64,
    theta_c_zero_deg: f64,
    phi_s_zero_deg: f64,
    n_frames: u32,
}

impl Store {
    /// Stores a reduction. `last_frame_id` is the newest frame in it.
    ///
    /// # Errors
    /// A database error.
    pub async fn add_observations(
        &self,
        scan_id: i64,
        last_frame_id: i64,
        set: &ObservationSet,
    ) -> Result<i64, StoreError> {
        let context = Context {
            theta_l_deg: set.rig.theta_l.deg(),
            light_azimuth_deg: set.rig.light_azimuth.deg(),
            azimuth_zero_deg: set.rig.azimuth_zero.deg(),
            light_angular_radius_deg: set.rig.cones.lamp.deg(),
            lens_angular_radius_deg: set.rig.cones.lens.deg(),
            material: set.material,
            flats: set
                .flats
                .iter()
                .map(|f| (f.theta_c.deg(), f.signal, f.sigma))
                .collect(),
            white_reference: set
                .white_reference
                .map(|w| (w.reflectance, w.reflectance_std)),
            taken_s: set.observations.iter().map(|o| o.taken_s).collect(),
            views: set
                .views
                .iter()
                .map(|views| views.iter().map(seven).collect())
                .collect(),
            field: set.field.as_ref().map(FieldColumns::of),
            background: (set.background.mean, set.background.std),
            wedge_std_deg: set.wedge_std.map(Angle::deg),
            azimuth_zero_std_deg: set.azimuth_zero_std.map(Angle::deg),
            theta_l_std_deg: set.theta_l_std.map(Angle::deg),
            dark_std: set.dark_std,
            translucency: set.translucency.map(|t| (t.mean, t.std)),
            times_of_flats_s: set.flats.iter().map(|f| f.times_s.clone()).collect(),
            detector: set.detector,
            power_law: set.power_law.clone(),
            detector_errors: set.observations.iter().map(|o| o.shared.detector).collect(),
            region_azimuth_deg: set.region_azimuth.deg(),
            n_frames_used: set.n_frames_used,
            rejected_frames: set.rejected_frames.clone(),
            warnings: set.warnings.clone(),
        };
        let context = serde_json::to_string(&context)
            .map_err(|e| StoreError::bad_row("observation_sets", e))?;
        let mut transaction = self.writing().await?;
        let id = sqlx::query(
            "INSERT INTO observation_sets (scan_id, region, context, last_frame_id, program, created_at)
             VALUES (?, ?, ?, ?, ?, ?)",
        )
        .bind(scan_id)
        .bind(&set.region)
        .bind(context)
        .bind(last_frame_id)
        .bind(PROGRAM)
        .bind(self.now_text())
        .execute(&mut *transaction)
        .await?
        .last_insert_rowid();
        for (position, o) in set.observations.iter().enumerate() {
            sqlx::query(
                "INSERT INTO observations (set_id, position, theta_c_deg, phi_s_deg, signal, sigma,
                   white_reference, led_drift, theta_c_zero_deg, phi_s_zero_deg, n_frames)
                 VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            )
            .bind(id)
            .bind(position as i64)
            .bind(o.pose.theta_c.deg())
            .bind(o.pose.phi_s.deg())
            .bind(o.signal)
            .bind(o.sigma)
            .bind(o.shared.white_reference)
            .bind(o.shared.led_drift)
            .bind(o.shared.theta_c_zero.deg())
            .bind(o.shared.phi_s_zero.deg())
            .bind(o.n_frames)
            .execute(&mut *transaction)
            .await?;
        }
        transaction.commit().await?;
        Ok(id)
    }

    /// Returns the number of the newest reduction of a scan's region by this program that includes every frame up to
    /// `last_frame_id`; `None` if the scan must be reduced again.
    ///
    /// # Errors
    /// A database error.
    pub async fn current_observations(
        &self,
        scan_id: i64,
        region: Option<&str>,
        last_frame_id: i64,
    ) -> Result<Option<i64>, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT id FROM observation_sets WHERE scan_id = ? AND region IS ? AND last_frame_id = ?
               AND program = ? ORDER BY id DESC LIMIT 1",
        )
        .bind(scan_id)
        .bind(region)
        .bind(last_frame_id)
        .bind(PROGRAM)
        .fetch_optional(self.readers())
        .await?)
    }

    /// Returns a stored reduction.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn observations(&self, set_id: i64) -> Result<ObservationSet, StoreError> {
        let (region, context): (Option<String>, String) =
            sqlx::query_as("SELECT region, context FROM observation_sets WHERE id = ?")
                .bind(set_id)
                .fetch_optional(self.readers())
                .await?
                .ok_or(StoreError::NotFound {
                    noun: "reduction",
                    id: set_id,
                })?;
        let context: Context = serde_json::from_str(&context)
            .map_err(|e| StoreError::bad_row("observation_sets", e))?;
        let rows: Vec<ObservationRow> = sqlx::query_as(
            "SELECT theta_c_deg, phi_s_deg, signal, sigma, white_reference, led_drift, theta_c_zero_deg,
               phi_s_zero_deg, n_frames FROM observations WHERE set_id = ? ORDER BY position",
        )
        .bind(set_id)
        .fetch_all(self.readers())
        .await?;
        let rig = RigGeometry {
            theta_l: Angle::from_deg(context.theta_l_deg),
            light_azimuth: Angle::from_deg(context.light_azimuth_deg),
            azimuth_zero: Angle::from_deg(context.azimuth_zero_deg),
            cones: Cones {
                lamp: Angle::from_deg(context.light_angular_radius_deg),
                lens: Angle::from_deg(context.lens_angular_radius_deg),
            },
        };
        Ok(ObservationSet {
            views: context
                .views
                .iter()
                .map(|v| v.iter().map(view).collect())
                .collect(),
            field: context.field.map(|field| field.on(rig)),
            rig,
            material: context.material,
            observations: rows
                .iter()
                .enumerate()
                .map(|(k, row)| {
                    let taken_s = context.taken_s.get(k).copied().flatten();
                    let mut kept = observation(row, taken_s);
                    kept.shared.detector = context.detector_errors.get(k).copied().unwrap_or(0.0);
                    kept
                })
                .collect(),
            flats: context
                .flats
                .iter()
                .enumerate()
                .map(|(k, (theta_c_deg, signal, sigma))| FlatObservation {
                    theta_c: Angle::from_deg(*theta_c_deg),
                    signal: *signal,
                    sigma: *sigma,
                    times_s: context.times_of_flats_s.get(k).cloned().unwrap_or_default(),
                })
                .collect(),
            white_reference: context
                .white_reference
                .map(|(reflectance, reflectance_std)| WhiteReference {
                    reflectance,
                    reflectance_std,
                }),
            background: Prior {
                mean: context.background.0,
                std: context.background.1,
            },
            wedge_std: context.wedge_std_deg.map(Angle::from_deg),
            azimuth_zero_std: context.azimuth_zero_std_deg.map(Angle::from_deg),
            theta_l_std: context.theta_l_std_deg.map(Angle::from_deg),
            dark_std: context.dark_std,
            translucency: context.translucency.map(|(mean, std)| Prior { mean, std }),
            lamp: None,
            detector: context.detector,
            power_law: context.power_law,
            region,
            region_azimuth: Angle::from_deg(context.region_azimuth_deg),
            n_frames_used: context.n_frames_used,
            rejected_frames: context.rejected_frames,
            warnings: context.warnings,
        })
    }

    #[cfg(test)]
    pub(crate) async fn add_empty_set(&self, scan_id: i64) -> i64 {
        self.add_observations(scan_id, 0, &tests::set(0))
            .await
            .unwrap()
    }
}

fn seven(view: &View) -> [f64; 7] {
    let (i, o) = (view.directions.incident, view.directions.outgoing);
    [i.x, i.y, i.z, o.x, o.y, o.z, view.weight]
}

fn view(seven: &[f64; 7]) -> View {
    let [ix, iy, iz, ox, oy, oz, weight] = *seven;
    View {
        directions: Directions {
            incident: [ix, iy, iz].into(),
            outgoing: [ox, oy, oz].into(),
        },
        weight,
    }
}

fn observation(row: &ObservationRow, taken_s: Option<f64>) -> Observation {
    Observation {
        pose: Pose::from_deg(row.theta_c_deg, row.phi_s_deg),
        signal: row.signal,
        sigma: row.sigma,
        shared: SharedErrors {
            white_reference: row.white_reference,
            led_drift: row.led_drift,
            detector: 0.0,
            theta_c_zero: Angle::from_deg(row.theta_c_zero_deg),
            phi_s_zero: Angle::from_deg(row.phi_s_zero_deg),
        },
        n_frames: row.n_frames,
        taken_s,
        row: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    pub(super) fn set(n: u32) -> ObservationSet {
        ObservationSet {
            views: Vec::new(),
            field: None,
            rig: RigGeometry::IN_PLANE,
            material: Material::Conductor {
                eta: 2.9,
                k: 3.1,
                eta_std: 0.02,
                k_std: 0.02,
            },
            observations: (0..n)
                .map(|i| Observation {
                    pose: Pose::from_deg(f64::from(i), 90.0),
                    signal: 0.1 / f64::from(i + 3),
                    sigma: 1e-4,
                    shared: SharedErrors {
                        white_reference: 5e-4,
                        led_drift: 1e-4,
                        detector: 2e-5 * f64::from(i),
                        theta_c_zero: Angle::from_deg(0.02),
                        phi_s_zero: Angle::from_deg(0.02),
                    },
                    n_frames: 3,
                    taken_s: Some(10.0 / f64::from(i + 3)),
                    row: None,
                })
                .collect(),
            flats: vec![FlatObservation {
                theta_c: Angle::from_deg(5.0),
                signal: 0.31,
                sigma: 1e-4,
                times_s: vec![-2.5, 2.5],
            }],
            wedge_std: Some(Angle::from_deg(0.1)),
            azimuth_zero_std: Some(Angle::from_deg(0.3)),
            theta_l_std: Some(Angle::from_deg(0.2)),
            dark_std: 1e-6,
            translucency: Some(Prior {
                mean: 0.4,
                std: 0.05,
            }),
            lamp: None,
            detector: Some(DetectorCurve {
                c: 0.06,
                exponent: 1.0,
                std: 0.0005,
                pairs: 41,
                full_scale_dn: 65335.0,
                explains: 0.99,
            }),
            power_law: Some(PowerLaw {
                exponent: 0.95,
                std: 0.001,
                spread: 0.08,
                explains: 0.99,
                pairs: 41,
                instead_of: "exposure times deviate".into(),
            }),
            white_reference: Some(WhiteReference {
                reflectance: 0.99,
                reflectance_std: 0.005,
            }),
            background: Prior {
                mean: 0.0,
                std: 0.01,
            },
            region: None,
            region_azimuth: Angle::ZERO,
            n_frames_used: 9,
            rejected_frames: vec![],
            warnings: vec!["a sentence".into()],
        }
    }

    #[tokio::test]
    async fn stored_observations_return_with_every_bit_of_their_degrees() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let id = store.add_observations(scan.id, 7, &set(20)).await.unwrap();
        let kept = store.observations(id).await.unwrap();
        assert_eq!(kept.observations.len(), 20);
        for (kept, given) in kept.observations.iter().zip(&set(20).observations) {
            assert_eq!(kept.signal, given.signal);
            assert_eq!(kept.sigma, given.sigma);
            assert_eq!(kept.shared.detector, given.shared.detector);
            // Degrees are stored and radians computed: 1 ulp of rounding each way.
            assert!((kept.pose.theta_c - given.pose.theta_c).abs().rad() < 1e-15);
        }
        assert_eq!(kept.white_reference, set(0).white_reference);
        assert_eq!(kept.detector, set(0).detector);
        assert_eq!(kept.flats[0].times_s, set(0).flats[0].times_s);
        assert_eq!(kept.warnings, set(0).warnings);
    }

    #[tokio::test]
    async fn a_later_frame_makes_a_reduction_out_of_date() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let id = store.add_observations(scan.id, 7, &set(1)).await.unwrap();
        let current = async |region, last| {
            store
                .current_observations(scan.id, region, last)
                .await
                .unwrap()
        };
        assert_eq!(current(None, 7).await, Some(id));
        assert_eq!(current(None, 8).await, None);
        assert_eq!(current(Some("even"), 7).await, None);
    }
}
