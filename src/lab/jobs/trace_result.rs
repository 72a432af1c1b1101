//! The result of a trace, and its files.

use serde::Serialize;

use crate::model::polarisation::Stokes;
use crate::trace::counting::bins;
use crate::trace::counting::polarisation_difference::{
    DifferenceSummary, DirectionDifference, DirectionMask, LobePoint, PolarisationDifference, lobe,
};
use crate::trace::counting::tally::Totals;
use crate::trace::ellipsometer::{EllipsometerPoint, PolariserSetting, SETTINGS, curve_of};
use crate::trace::report::TraceReport;
use crate::trace::scene::Scene;
use crate::trace::surfaces::height_field::Side;

/// The result of a trace. Its description has what the daemon adds to the report.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct TraceResult {
    #[serde(flatten)]
    #[schema(ignore)]
    pub(in crate::lab) report: TraceReport,
    /// The lamp.
    pub(in crate::lab) light: Light,
    /// Layout of `bins.f32`.
    pub(in crate::lab) bins: Bins,
    /// Differences between polarised and scalar light, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::lab) comparison: Option<Comparison>,
    /// Names of the files of the result.
    pub(in crate::lab) files: Vec<String>,
    /// Warnings for the user.
    pub(in crate::lab) warnings: Vec<String>,
}

/// The lamp of a trace.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = TraceLight)]
pub(in crate::lab) struct Light {
    /// Polar angle of the incident light, degrees.
    theta_i_deg: f64,
    /// Azimuth of the incident light, degrees.
    phi_i_deg: f64,
    /// Wavelength, nm.
    wavelength_nm: f64,
    /// Stokes vector I, Q, U, V, normalised to intensity 1.
    stokes: [f64; 4],
}

/// The layout of `bins.f32`.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = TraceBins)]
pub(in crate::lab) struct Bins {
    /// Bins over the polar angle.
    n_theta: usize,
    /// Bins over the azimuth.
    n_phi: usize,
    /// Sides of the surface: `reflected`, and `transmitted` where light leaves below.
    #[schema(value_type = Vec<String>)]
    sides: Vec<&'static str>,
    /// Names of the numbers of each bin.
    numbers: Vec<String>,
}

/// Differences between polarised and scalar light.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = TraceComparison)]
pub(in crate::lab) struct Comparison {
    /// Wavelengths of the average, nm.
    wavelengths_nm: Vec<f64>,
    /// The directions that count.
    mask: DirectionMask,
    /// Statistics of the mean of |d| over the wavelengths; null without a direction that counts.
    adm: Option<DifferenceSummary>,
    /// Statistics of the largest |d|; null without a direction that counts.
    mdm: Option<DifferenceSummary>,
    /// The direction with the largest difference; null without a direction that counts.
    worst: Option<DirectionDifference>,
    /// Number of directions that count.
    directions: usize,
    /// Number of lit directions left out as too dark.
    too_dark: usize,
    /// Number of directions left out as unresolved.
    not_settled: usize,
}

/// A state of the lamp's light.
#[derive(Debug, Serialize)]
struct State {
    name: &'static str,
    stokes: [f64; 4],
}

/// The file `plane.json`.
#[derive(Debug, Serialize)]
struct Plane {
    /// States of the lamp, the scene's first, in the order of each point's readings.
    states: Vec<State>,
    /// Settings of the camera's columns.
    settings: [PolariserSetting; 6],
    points: Option<Vec<EllipsometerPoint>>,
    lobe: Option<Vec<LobePoint>>,
}

impl Light {
    /// Returns the lamp of a scene.
    pub(in crate::lab) fn of(scene: &Scene) -> Self {
        let [i, q, u, v] = scene.light.stokes;
        Light {
            theta_i_deg: scene.light.theta_i_deg,
            phi_i_deg: scene.light.phi_i_deg,
            wavelength_nm: scene.light.wavelength_nm,
            stokes: [1.0, q / i, u / i, v / i],
        }
    }
}

impl Bins {
    /// Returns the layout of a trace's bins.
    pub(in crate::lab) fn of(totals: &Totals) -> Self {
        let numbers = match totals.elements() {
            0..16 => vec!["brdf".to_owned()],
            n => {
                let mueller = (0..16).map(|i| format!("m{}{}", i / 4, i % 4));
                let paired = ["scalar", "m00-scalar"].map(str::to_owned);
                mueller.chain(paired).take(n).collect()
            }
        };
        let names = bins::sides(totals).into_iter().map(|side| match side {
            Side::Above => "reflected",
            Side::Below => "transmitted",
        });
        Bins {
            n_theta: totals.grid().n_theta,
            n_phi: totals.grid().n_phi,
            sides: names.collect(),
            numbers,
        }
    }
}

impl Comparison {
    /// Returns the summary of the differences, averaged over the wavelengths.
    pub(in crate::lab) fn of(
        difference: &PolarisationDifference,
        wavelengths_nm: Vec<f64>,
    ) -> Self {
        Comparison {
            wavelengths_nm,
            mask: DirectionMask::default(),
            adm: difference.adm(),
            mdm: difference.mdm(),
            worst: difference.worst().copied(),
            directions: difference.directions.len(),
            too_dark: difference.too_dark,
            not_settled: difference.not_settled,
        }
    }
}

impl Plane {
    fn of(totals: &Totals, light: &Light) -> Self {
        let own = ("scene", Stokes::from(light.stokes));
        let states: Vec<(&str, Stokes)> = std::iter::once(own)
            .chain(SETTINGS.iter().map(|s| (s.name, s.lamp())))
            .collect();
        Plane {
            settings: SETTINGS,
            points: curve_of(totals, light.phi_i_deg, &states),
            states: states
                .iter()
                .map(|(name, stokes)| State {
                    name,
                    stokes: (*stokes).into(),
                })
                .collect(),
            lobe: lobe(totals, light.phi_i_deg),
        }
    }
}

/// Returns the files of a trace: names and contents.
///
/// # Errors
/// The plane of incidence is not JSON.
pub(in crate::lab) fn files(
    totals: &Totals,
    light: &Light,
    difference: Option<&PolarisationDifference>,
) -> serde_json::Result<Vec<(&'static str, Vec<u8>)>> {
    let table = bins::csv(totals, &light.stokes, "", |_, _| String::new());
    let mut files = vec![
        ("bins.csv", table.into_bytes()),
        ("bins.f32", bins::float32(totals)),
        ("plane.json", serde_json::to_vec(&Plane::of(totals, light))?),
    ];
    files.extend(difference.map(|d| ("difference.f32", block_of(d))));
    Ok(files)
}

/// Returns d, its standard error, ADM and MDM for each bin of the upper side; NaN for directions outside the mask.
fn block_of(difference: &PolarisationDifference) -> Vec<u8> {
    let mut values = vec![[f64::NAN; 4]; difference.grid.per_side()];
    for d in &difference.directions {
        values[d.bin] = [d.mean, d.std, d.adm, d.mdm];
    }
    let numbers = values.iter().flatten();
    numbers.flat_map(|x| (*x as f32).to_le_bytes()).collect()
}
