//! Checks settings: each number in its range, and settings that depend on each other.

use super::{Config, ConfigError, bounds};
use crate::bench::stage::{StageError, StageSettings};
use crate::geometry::Pose;
use crate::scan::plan::{EXPOSURE_S_MAX, EXPOSURE_S_MIN};
use crate::series::misaimed;

/// A setting with a value that is not allowed.
struct WrongSetting {
    key: String,
    found: String,
    allowed: String,
}

impl WrongSetting {
    fn new(
        key: impl Into<String>,
        found: impl Into<String>,
        allowed: impl Into<String>,
    ) -> WrongSetting {
        WrongSetting {
            key: key.into(),
            found: found.into(),
            allowed: allowed.into(),
        }
    }
}

impl Config {
    /// Names the first setting that is not allowed; `origin_of` says where a key is.
    pub(super) fn check(&self, origin_of: impl Fn(&str) -> String) -> Result<(), ConfigError> {
        let checked = self
            .check_numbers()
            .and_then(|()| self.check_exposures())
            .and_then(|()| self.check_certificate())
            .and_then(|()| self.check_camera())
            .and_then(|()| self.check_stage())
            .and_then(|()| self.check_park())
            .and_then(|()| self.check_access())
            .and_then(|()| self.check_due())
            .and_then(|()| self.check_suspend());
        checked.map_err(|wrong| ConfigError::OutOfRange {
            origin: origin_of(&wrong.key),
            key: wrong.key,
            found: wrong.found,
            allowed: wrong.allowed,
        })
    }

    fn check_numbers(&self) -> Result<(), WrongSetting> {
        for (key, limit, of) in bounds::BOUNDED {
            match of(self) {
                Some(value) if !limit.holds(value) => {
                    return Err(WrongSetting::new(*key, value.to_string(), limit.allowed()));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn check_exposures(&self) -> Result<(), WrongSetting> {
        let camera = self.camera.exposures_s.as_slice();
        let flat = self.flat.exposures_s.as_deref().unwrap_or(camera);
        for (key, list) in [("camera.exposures_s", camera), ("flat.exposures_s", flat)] {
            let fine = |s: &f64| (EXPOSURE_S_MIN..=EXPOSURE_S_MAX).contains(s);
            if list.is_empty() || !list.iter().all(fine) {
                let allowed = format!("one or more of {EXPOSURE_S_MIN} to {EXPOSURE_S_MAX} s");
                return Err(WrongSetting::new(key, format!("{list:?}"), allowed));
            }
        }
        Ok(())
    }

    fn check_certificate(&self) -> Result<(), WrongSetting> {
        match &self.flat.certificate {
            Some(text) if text.trim().is_empty() || text.chars().count() > 200 => {
                let found = format!("{} characters", text.chars().count());
                let allowed = "a text of 1 to 200 characters";
                Err(WrongSetting::new("flat.certificate", found, allowed))
            }
            _ => Ok(()),
        }
    }

    /// Checks settings that depend on each other.
    fn check_camera(&self) -> Result<(), WrongSetting> {
        if let Some(found) = self.camera_facts().contradiction() {
            let key = format!("camera.{}", found.key);
            return Err(WrongSetting::new(
                key,
                found.value.to_string(),
                found.allowed,
            ));
        }
        let (facts, camera) = (self.rig_facts(), self.camera_facts());
        if let Some(allowed) = misaimed(&facts, &camera, facts.camera_distance_mm) {
            let found = format!("{:?}", camera.principal_point_px.unwrap_or_default());
            return Err(WrongSetting::new(
                "camera.principal_point_px",
                found,
                allowed,
            ));
        }
        let rig = &self.rig;
        let (lamp, lens) = (rig.light_angular_radius_deg, rig.lens_angular_radius_deg);
        for (key, radius_mm, distance, spans) in [
            (
                "rig.light_radius_mm",
                rig.light_radius_mm,
                "light_distance_mm",
                rig.light_distance_mm.or(lamp),
            ),
            (
                "rig.lens_radius_mm",
                rig.lens_radius_mm,
                "camera_distance_mm",
                rig.camera_distance_mm.or(lens),
            ),
        ] {
            if let (Some(radius_mm), None) = (radius_mm, spans) {
                let allowed = format!("only beside {distance}, without which it spans no angle");
                return Err(WrongSetting::new(key, radius_mm.to_string(), allowed));
            }
        }
        Ok(())
    }

    fn check_stage(&self) -> Result<(), WrongSetting> {
        if self.port.is_some() && self.stage.is_none() {
            let allowed = "address, limit_min_deg and limit_max_deg of both axes";
            return Err(WrongSetting::new("stage", "missing beside a port", allowed));
        }
        match self.stage.as_ref().map(StageSettings::validate) {
            None | Some(Ok(())) => Ok(()),
            Some(Err(StageError::BadSetting {
                key,
                found,
                allowed,
            })) => Err(WrongSetting::new(format!("stage.{key}"), found, allowed)),
            Some(Err(other)) => Err(WrongSetting::new(
                "stage",
                other.to_string(),
                "a setting that a stage supports",
            )),
        }
    }

    fn check_park(&self) -> Result<(), WrongSetting> {
        let Some(park) = self.park else {
            return Ok(());
        };
        for (key, deg) in [
            ("park.theta_c_deg", park.theta_c_deg),
            ("park.phi_s_deg", park.phi_s_deg),
        ] {
            if !deg.is_finite() {
                return Err(WrongSetting::new(key, deg.to_string(), "a finite angle"));
            }
        }
        // A simulated rig has its own limits, which are checked when it is assembled.
        let Some(stage) = &self.stage else {
            return Ok(());
        };
        let target = Pose::from_deg(park.theta_c_deg, park.phi_s_deg);
        if let Err(StageError::OutsideLimits {
            axis,
            target,
            min,
            max,
        }) = stage.check_limits(target)
        {
            return Err(WrongSetting::new(
                format!("park.{axis}_deg"),
                target.to_string(),
                format!("{min} to {max}, the limits of {axis}"),
            ));
        }
        match stage.region_at(target) {
            Some(region) => Err(WrongSetting::new(
                "park",
                format!("in the forbidden region {region}"),
                "a place outside the forbidden regions",
            )),
            None => Ok(()),
        }
    }

    fn check_access(&self) -> Result<(), WrongSetting> {
        let server = &self.server;
        for (key, given, other) in [
            ("server.tls_key", &server.tls_key, &server.tls_cert),
            ("server.tls_cert", &server.tls_cert, &server.tls_key),
        ] {
            if given.is_none() && other.is_some() {
                let allowed = "the files of both: server.tls_cert and server.tls_key";
                return Err(WrongSetting::new(key, "missing", allowed));
            }
        }
        let hosts = server.hosts.iter().flatten();
        let is_name = |host: &&String| {
            let part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_');
            !host.is_empty() && host.chars().all(part)
        };
        if let Some(host) = hosts.clone().find(|host| !is_name(host)) {
            let allowed = "names without scheme and port, like lab-pc.example.org";
            return Err(WrongSetting::new(
                "server.hosts",
                format!("{host:?}"),
                allowed,
            ));
        }
        let roots = self.import.roots.iter().flatten();
        if let Some(root) = roots.clone().find(|root| !root.is_absolute()) {
            let found = root.display().to_string();
            return Err(WrongSetting::new("import.roots", found, "absolute paths"));
        }
        Ok(())
    }

    fn check_due(&self) -> Result<(), WrongSetting> {
        let Some((key, found, allowed)) = self.due.fault() else {
            return Ok(());
        };
        Err(WrongSetting::new(key, found, allowed))
    }

    fn check_suspend(&self) -> Result<(), WrongSetting> {
        for (i, value) in self.suspend.iter().enumerate() {
            if let Some((key, allowed)) = value.invalid() {
                let found = format!("invalid in {:?}", value.name);
                return Err(WrongSetting::new(
                    format!("suspend[{i}].{key}"),
                    found,
                    allowed,
                ));
            }
        }
        Ok(())
    }
}
