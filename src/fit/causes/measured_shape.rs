//! Checks whether a separately measured shape can be that of the sample: its ridge angle against the fitted one, the
//! length of its facets against the manifest.

use crate::fit::report::Parameter;
use crate::trace::surfaces::ridge_map::RidgeFacts;
use crate::trace::surfaces::surface_profile::SurfaceProfile;
use crate::wording::{decimals, significant};

/// Standard uncertainty of the vertical scale of adjusted instruments, relative.
const SCALE_STD: f64 = 0.01;
/// Standard uncertainty of an angle from levelling and noise, degrees.
const ANGLE_STD_DEG: f64 = 0.1;
/// Accepted relative difference between lengths of facets; nominal lengths are rounded.
const LENGTH_OFF: f64 = 0.03;

/// Lists contradictions as sentences for the user. `theta_r` is the fitted ridge angle in degrees, `pitch_length_um`
/// the length of a facet in the manifest.
#[must_use]
pub fn contradictions(
    profile: &SurfaceProfile,
    map: Option<&RidgeFacts>,
    theta_r: &Parameter,
    pitch_length_um: Option<f64>,
) -> Vec<String> {
    let own = profile.effective_ridge_angle();
    let by_light = theta_r.value.map(f64::abs);
    let angle = own.zip(by_light).and_then(|(own, by_light)| {
        off_in_angle(own, profile.lobe_error(), by_light, theta_r.expanded)
    });
    // An error of the vertical scale does not change the length of a ridge.
    let inclined = by_light.map(f64::to_radians).or(own).unwrap_or_default();
    let period_um = map.map_or_else(
        || profile.period() / profile.ridges().max(1) as f64,
        |facts| facts.period_um,
    );
    let length =
        pitch_length_um.and_then(|stated_um| off_in_length(period_um * inclined.cos(), stated_um));
    angle.into_iter().chain(length).collect()
}

fn off_in_angle(
    own: f64,
    lobe_error: f64,
    by_light_deg: f64,
    expanded_deg: Option<f64>,
) -> Option<String> {
    let own_deg = own.to_degrees();
    let scale_deg = (SCALE_STD * own.sin() * own.cos()).to_degrees();
    let own_std_deg = ANGLE_STD_DEG
        .hypot(scale_deg)
        .hypot(lobe_error.to_degrees());
    let expanded_deg = expanded_deg?;
    let may_differ = expanded_deg.hypot(2.0 * own_std_deg);
    ((own_deg - by_light_deg).abs() > may_differ).then(|| {
        let digits = decimals(expanded_deg);
        let factor = by_light_deg.to_radians().tan() / own.tan();
        format!(
            "The measured shape has a ridge angle of {own_deg:.1}°, but the fit gives {by_light_deg:.digits$} ± \
             {expanded_deg:.digits$}° (k = 2). Its heights were scaled to the fitted angle for tracing. Check its vertical \
             scale (multiply the heights by {} to agree) and whether it belongs to this sample.",
            significant(factor)
        )
    })
}

fn off_in_length(own_um: f64, stated_um: f64) -> Option<String> {
    ((own_um / stated_um - 1.0).abs() > LENGTH_OFF).then(|| {
        format!(
            "The measured shape has facets of {} µm, but the manifest states sample.pitch_length_um = {}. Check the lateral \
             scale of the shape, whether it belongs to this sample, and the manifest.",
            significant(own_um),
            significant(stated_um)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn by_light(value: Option<f64>, expanded: f64) -> Parameter {
        Parameter {
            value,
            std: Some(0.5 * expanded),
            expanded: Some(expanded),
            coverage_factor: Some(2.0),
            degrees_of_freedom: None,
            identifiable: true,
            budget: None,
            profile: None,
            bootstrap: None,
            note: None,
        }
    }

    /// Ten ridges with facets of 100 µm and `times` the heights of 10° ridges.
    fn ridges(times: f64) -> SurfaceProfile {
        let (sin, cos) = 10f64.to_radians().sin_cos();
        let period = 100.0 / cos;
        let corners = (0..10).flat_map(|n| {
            let v = f64::from(n) * period;
            [(v, 0.0), (v + 100.0 * cos, -100.0 * sin * times)]
        });
        SurfaceProfile::of_corners(&corners.collect::<Vec<_>>(), 10.0 * period)
    }

    #[test]
    fn only_a_shape_that_contradicts_fit_or_manifest_is_reported() {
        let light = by_light(Some(10.0), 0.05);
        let found = |times: f64, pitch_um| contradictions(&ridges(times), None, &light, pitch_um);
        assert_eq!(ridges(1.0).ridges(), 10);
        assert!(found(1.0, Some(100.0)).is_empty() && found(1.01, Some(101.5)).is_empty());
        for times in [0.001, 0.5, 0.9, 1.1, 2.0, 1e3, 1e6] {
            let found = found(times, None);
            assert!(
                found.len() == 1 && found[0].contains("vertical scale"),
                "{times}: {found:?}"
            );
        }
        for pitch_um in [50.0, 94.0, 110.0, 1e3] {
            let found = found(1.0, Some(pitch_um));
            assert!(
                found.len() == 1 && found[0].contains("pitch_length_um"),
                "{pitch_um}: {found:?}"
            );
        }
        assert_eq!(found(2.0, Some(50.0)).len(), 2);
        // An undetermined ridge angle contradicts nothing.
        let vague = by_light(Some(12.0), 4.0);
        assert!(contradictions(&ridges(1.0), None, &vague, None).is_empty());
        assert!(contradictions(&ridges(2.0), None, &by_light(None, 0.0), None).is_empty());
    }
}
