//! The points of the rig in the frame, from a manifest: [`Manifest::imaging`].

use super::manifest::{CameraFacts, Manifest, RigFacts};
use crate::geometry::{AIM_MAX, Imaging, RigGeometry};

impl Manifest {
    /// Which place of the sample each pixel sees, and its directions. `None` where a near camera or lamp is stated without the
    /// width of the field. Without any field a pixel counts as 1 mm, which far cameras and lamps do not mind.
    #[must_use]
    pub fn imaging(&self) -> Option<Imaging> {
        let far = self.is_telecentric();
        if !far && self.camera.field_width_mm.is_none() {
            return None;
        }
        let near = |distance: Option<f64>| distance.filter(|_| !far);
        Some(of_facts(
            &self.rig,
            &self.camera,
            self.rig_geometry(),
            near(self.camera_distance_mm()),
            near(self.rig.light_distance_mm),
        ))
    }

    /// Where a near camera is not aimed as it can be: what `principal_point_px` may be.
    pub(super) fn misaimed(&self) -> Option<String> {
        misaimed(&self.rig, &self.camera, self.camera_distance_mm())
    }
}

fn of_facts(
    rig: &RigFacts,
    camera: &CameraFacts,
    geometry: RigGeometry,
    camera_mm: Option<f64>,
    light_mm: Option<f64>,
) -> Imaging {
    let (width, height) = (f64::from(camera.width_px), f64::from(camera.height_px));
    let column_mm = camera.field_width_mm.map(|w| w / width);
    let row_mm = camera.field_height_mm.map(|h| h / height);
    let centre = rig.tilt_centre_px.unwrap_or([0.5 * width, 0.5 * height]);
    Imaging {
        rig: geometry,
        pixel_mm: [
            column_mm.or(row_mm).unwrap_or(1.0),
            row_mm.or(column_mm).unwrap_or(1.0),
        ],
        tilt_centre_px: centre,
        principal_point_px: camera.principal_point_px.unwrap_or(centre),
        rotation_axis_px: rig.rotation_axis_px.unwrap_or(centre),
        camera_mm,
        light_mm,
    }
}

/// What `camera.principal_point_px` may be, where it is not: an optical axis that passes the centre of tilt at nearly the
/// camera's distance is none.
#[must_use]
pub fn misaimed(rig: &RigFacts, camera: &CameraFacts, camera_mm: Option<f64>) -> Option<String> {
    let imaging = of_facts(rig, camera, RigGeometry::IN_PLANE, camera_mm, None);
    (!imaging.is_aimed()).then(|| {
        format!(
            "within {AIM_MAX} × camera_distance_mm of rig.tilt_centre_px, [{}, {}]",
            imaging.tilt_centre_px[0], imaging.tilt_centre_px[1]
        )
    })
}

#[cfg(test)]
mod tests {
    use crate::series::Manifest;

    const CHECKER: &str = include_str!("../../tests/data/series/checker/manifest.toml");

    fn read(rig: &str, camera: &str) -> Result<Manifest, String> {
        let text = CHECKER
            .replacen("rotation_axis_px = [128.0, 128.0]\n", rig, 1)
            .replace("light_distance = \"infinity\"\n", "")
            .replace("camera_distance = \"infinity\"\n", "")
            .replacen("[camera]\n", &format!("[camera]\n{camera}"), 1);
        Manifest::from_outside(&text, "manifest.toml").map_err(|e| e.to_string())
    }

    #[test]
    fn a_distance_in_metres_is_refused() {
        let far_enough = "light_distance_mm = 300.0\ncamera_distance_mm = 280.0\n";
        let near = read(far_enough, "");
        assert!(near.is_ok(), "{near:?}");
        for key in ["light_distance_mm", "camera_distance_mm"] {
            let refused = read(&format!("{key} = 0.3\n"), "").unwrap_err();
            assert!(
                refused.contains(key) && refused.contains("51.2 mm"),
                "{refused}"
            );
        }
    }

    #[test]
    fn each_point_is_the_next_one_where_it_is_not_stated() {
        let points = |rig: &str, camera: &str| {
            let imaging = read(rig, camera).unwrap().imaging().unwrap();
            [
                imaging.tilt_centre_px,
                imaging.principal_point_px,
                imaging.rotation_axis_px,
            ]
        };
        assert_eq!(points("", ""), [[128.0, 128.0]; 3]);
        assert_eq!(
            points("rotation_axis_px = [120.0, 131.0]\n", ""),
            [[128.0, 128.0], [128.0, 128.0], [120.0, 131.0]]
        );
        assert_eq!(
            points("tilt_centre_px = [120.0, 131.0]\n", ""),
            [[120.0, 131.0]; 3]
        );
        assert_eq!(
            points(
                "tilt_centre_px = [120.0, 131.0]\nrotation_axis_px = [1.0, 2.0]\n",
                "principal_point_px = [3.0, 4.0]\n"
            ),
            [[120.0, 131.0], [3.0, 4.0], [1.0, 2.0]]
        );
    }

    #[test]
    fn a_point_that_no_camera_can_have_is_refused_by_name() {
        let wild = read("tilt_centre_px = [inf, 0.0]\n", "").unwrap_err();
        assert!(wild.contains("tilt_centre_px"), "{wild}");
        let stray = read("", "rotation_axis_px = [1.0, 1.0]\n").unwrap_err();
        assert!(stray.contains("belongs in [rig]"), "{stray}");
        let aimed = |column: f64| {
            let text = CHECKER
                .replacen(
                    "camera_distance = \"infinity\"",
                    "camera_distance_mm = 100.0",
                    1,
                )
                .replacen(
                    "[camera]\n",
                    &format!("[camera]\nprincipal_point_px = [{column:?}, 128.0]\n"),
                    1,
                );
            Manifest::from_outside(&text, "manifest.toml").map_err(|e| e.to_string())
        };
        // 51.2 mm over 256 columns: 100 mm are 500 columns.
        assert!(aimed(128.0 + 440.0).is_ok());
        let error = aimed(128.0 + 460.0).unwrap_err();
        assert!(
            error.contains("principal_point_px") && error.contains("tilt_centre_px"),
            "{error}"
        );
    }
}
