//! The steps of a map before and after its pixels are fitted, apart from the pixels themselves: what they share, with doubts
//! and omissions, and from both the finished map.

use serde::{Deserialize, Serialize};

use super::calibration::GlobalCalibration;
use super::calibration::globals::Globals;
use super::calibration::mean_fit::Mean;
use super::layers::Layers;
use super::signals::view::View;
use super::solve::kernel::{FREE, Parameters};
use super::tiles::Tiles;
use super::{Map, MapError, defects};
use crate::model::{LeftOut, left_out};
use crate::observation::RejectedFrame;
use crate::plan::Decision;
use crate::robust;
use crate::series::Manifest;
use crate::units::Angle;

/// Common standard uncertainty of the ridge angle, in degrees, above which the map warns.
const SHARED_THETA_R_STD_MAX_DEG: f64 = 0.5;

/// All that the finished map needs besides its pixels. It depends on all frames, so equal frames give an equal basis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Basis {
    #[serde(with = "manifest_text")]
    manifest: Manifest,
    n_poses: usize,
    globals: Globals,
    /// Usual χ² per degree of freedom.
    birge: f64,
    /// In radians and ln α.
    shared_std: Option<Parameters>,
    sampled: usize,
    has_white: bool,
    /// The fit of the pixels' mean, or why there is none.
    mean: Result<Mean, String>,
    warnings: Vec<String>,
    left_out: Vec<LeftOut>,
    rejected_frames: Vec<RejectedFrame>,
}

/// A manifest as TOML: its further keys may be of any type.
mod manifest_text {
    use serde::{Deserialize as _, Deserializer, Serializer, de, ser};

    use crate::series::Manifest;

    pub(super) fn serialize<S: Serializer>(manifest: &Manifest, to: S) -> Result<S::Ok, S::Error> {
        let text = toml::to_string(manifest).map_err(ser::Error::custom)?;
        to.serialize_str(&text)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Manifest, D::Error> {
        let text = String::deserialize(from)?;
        toml::from_str(&text).map_err(de::Error::custom)
    }
}

impl Basis {
    pub(super) fn new(
        manifest: &Manifest,
        warnings: &[String],
        rejected_frames: Vec<RejectedFrame>,
        has_white: bool,
        settled: &GlobalCalibration,
    ) -> Self {
        let mut warnings = warnings.to_owned();
        warnings.extend(doubts(settled));
        Basis {
            manifest: manifest.clone(),
            n_poses: settled.costly.poses().len(),
            globals: settled.globals,
            birge: settled.birge,
            shared_std: settled.shared_std,
            sampled: settled.sampled,
            has_white,
            mean: settled.mean.clone(),
            warnings,
            left_out: what_is_left_out(settled, wedge_of(manifest)),
            rejected_frames,
        }
    }

    /// Rows and columns of the map, and whether its pixels have amplitudes.
    pub(super) fn layers(&self) -> Layers {
        let view = self.view();
        let amplitude = View::fits_amplitude(&self.manifest.material());
        Layers::new(view.width, view.height, amplitude)
    }

    fn view(&self) -> View {
        View::new(&self.manifest)
    }
}

#[cfg(test)]
impl Basis {
    /// A basis without poses, for tests of what does not depend on them.
    pub(super) fn empty(manifest: &Manifest, birge: f64) -> Self {
        Basis {
            manifest: manifest.clone(),
            n_poses: 0,
            globals: Globals::first(1.0),
            birge,
            shared_std: Some([f64::INFINITY, 0.1 + 0.2, -0.0, 1e-300, 5e-324]),
            sampled: 0,
            has_white: false,
            mean: Ok(Mean {
                known: [
                    Some((f64::INFINITY, 0.1 + 0.2)),
                    None,
                    Some((-0.0, 1e-300)),
                    Some((5e-324, 0.0)),
                    None,
                ],
                of_all: true,
                stray: None,
                tilt_offset_deg: None,
            }),
            warnings: vec!["a warning".to_owned()],
            left_out: vec![left_out::third_bounce()],
            rejected_frames: Vec::new(),
        }
    }
}

fn wedge_of(manifest: &Manifest) -> Option<Angle> {
    manifest.rig.sample_wedge_std_deg.map(Angle::from_deg)
}

/// Marks borders and defects of the fitted pixels and adds what they share.
///
/// # Errors
/// [`MapError::Late`] or [`MapError::NothingFitted`] where no pixel was fitted.
pub(super) fn finished(basis: Basis, tiles: Tiles) -> Result<Map, MapError> {
    let view = basis.view();
    let (mut layers, evaluations) = (tiles.layers, tiles.evaluations);
    let pixels_left_out = view.pixels() - tiles.pixels;
    let leans = defects::leans(&layers);
    defects::mark_borders(&mut layers, &leans);
    let pixel_mm = view.has_scale.then_some(view.imaging.pixel_mm);
    let found = defects::defects(
        &mut layers,
        &leans,
        &|pixel| view.place_mm(pixel),
        view.imaging.pixel_mm,
    );
    let pixels_fitted = layers.chi2_reduced.iter().filter(|x| x.is_finite()).count();
    if pixels_fitted == 0 && pixels_left_out > 0 {
        return Err(MapError::Late);
    }
    if pixels_fitted == 0 {
        return Err(MapError::NothingFitted {
            poses: basis.n_poses,
            chi2: basis.birge,
        });
    }

    let mut warnings = basis.warnings;
    if !basis.has_white && layers.parameters.iter().any(|l| l.name == "rho_d") {
        layers.without_rho_d();
        warnings.push(
            "the series has no white reference, so rho_d, which is relative to it, is not given"
                .to_owned(),
        );
    }
    let mut globals = basis.globals;
    let mut shared_std = basis.shared_std.map(|std| in_layer_units(&std, &layers));
    match &basis.mean {
        Ok(mean) => {
            mean.raise(&mut globals);
            let uniform = leans.len() <= 1;
            shared_std = shared_std
                .map(|std| mean.at_least(std, &layers, uniform, |k| average(&layers, k)));
        }
        Err(why) => warnings.push(format!(
            "the mean of the pixels was not fitted ({why}), so std_shared is too small: it includes only the counting \
             statistics of gain, stray light and tilt offset, not the uncertainties of the stages and the model"
        )),
    }
    let mut left_out = basis.left_out;
    if pixels_left_out > 0 {
        left_out.push(LeftOut::new(
            format!("{pixels_left_out} of {} pixels", view.pixels()),
            "the time limit passed; the fitted pixels are spread over the field",
            None,
        ));
    }
    Ok(Map {
        shared_std,
        layers,
        pixel_mm,
        axis_px: view.imaging.rotation_axis_px,
        globals,
        birge: basis.birge,
        leans,
        defects: found,
        pixels_fitted,
        pixels_sampled: basis.sampled,
        evaluations: evaluations / pixels_fitted.max(1) as f64,
        n_poses: basis.n_poses,
        rejected_frames: basis.rejected_frames,
        warnings,
        left_out,
        pixels_left_out,
    })
}

/// Lists what the map omits.
fn what_is_left_out(settled: &GlobalCalibration, wedge: Option<Angle>) -> Vec<LeftOut> {
    let view = &settled.view;
    let mut list = settled.plan.omissions();
    list.extend(left_out::lens(&view.imaging.rig.cones));
    list.push(left_out::ideal_profile());
    list.push(left_out::third_bounce());
    if wedge.is_none() {
        list.push(left_out::wedge());
    }
    let included = |decision| settled.plan.on(decision).is_some_and(|c| c.included);
    if included(Decision::Bounces) {
        list.push(LeftOut::new(
            "double reflections by integration, pixel by pixel",
            "integrated only on the surfaces that represent most pixels; each pixel takes the nearest",
            None,
        ));
    }
    if included(Decision::PerPixelGeometry) {
        list.push(match &settled.beside {
            Some(beside) => LeftOut::new(
                "the pixel's own surface in the off-centre change of light reflected between the facets",
                "the change is small and smooth; that of the surfaces that represent most pixels is used",
                Some(beside.left),
            ),
            None => LeftOut::new(
                "each pixel's own directions in light reflected between the facets",
                "they vary slowly; those of the field's centre are used",
                settled.centre_for_all,
            ),
        });
    }
    list
}

/// Converts shared shifts to the layers' units; those of ln α are multiplied by the median α.
fn in_layer_units(std: &Parameters, layers: &Layers) -> [f64; FREE] {
    let alpha = |k: usize| {
        let values = layers.parameters[k].values.iter();
        robust::median_of_finite(values.map(|x| f64::from(*x))).unwrap_or(0.0)
    };
    [
        std[0].to_degrees(),
        std[1].to_degrees(),
        std[2] * alpha(2),
        std[3] * alpha(3),
        std[4],
    ]
}

/// Returns the mean of a layer's values without the outer twentieths, as a fit of all pixels together sees it.
fn average(layers: &Layers, k: usize) -> f64 {
    let values = layers.parameters[k].values.iter().map(|x| f64::from(*x));
    let mut values: Vec<f64> = values.filter(|x| x.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let out = values.len() / 20;
    let middle = &values[out..values.len() - out];
    middle.iter().sum::<f64>() / middle.len().max(1) as f64
}

fn doubts(settled: &GlobalCalibration) -> Vec<String> {
    let mut doubts = Vec::new();
    let zero = settled.globals.tilt_offset_std.deg();
    if zero > 1.0 {
        doubts.push(format!(
            "these poses do not determine the tilt offset (± {zero:.1}°), so the recorded tilts are used; scan more azimuths"
        ));
    }
    let mean = settled.mean.as_ref().ok().and_then(|mean| mean.known[0]);
    let of_pixels = settled.shared_std.map_or(0.0, |std| std[0].to_degrees());
    let shared = mean.map_or(0.0, |(_, std)| std).max(of_pixels);
    if shared > SHARED_THETA_R_STD_MAX_DEG {
        doubts.push(format!(
            "these poses leave an uncertainty of {shared:.1}° (k = 1) that the ridge angles of all pixels share (they do not separate it from gain, stray light, tilt offset and model error): differences between pixels are valid, the absolute angle is not; scan more tilts"
        ));
    }
    if settled.birge > 4.0 {
        doubts.push(format!(
            "the usual χ² per degree of freedom is {:.1}: the model does not explain the pixels of this sample within their noise; uncertainties are scaled by its square root",
            settled.birge
        ));
    }
    if settled.costly.is_amplitude() {
        doubts.push(
            "on metal, double reflections are a large part of the light, and this map takes them from the surfaces that represent most pixels: pixels unlike these, or with few observations in the lobe, may be wrong by several standard uncertainties; use `ridged fit` for the full model"
                .to_owned(),
        );
    }
    if !settled.view.has_scale {
        doubts.push(
            "the manifest states no field_width_mm: positions are given in pixels in place of mm"
                .to_owned(),
        );
    }
    doubts
}
