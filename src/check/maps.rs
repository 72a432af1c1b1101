//! Maps of uniform surfaces: they must cover the known truth, must not depend on units, and series without information
//! must be refused.

use std::sync::atomic::AtomicBool;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::criterion::{covered, limit, one_of, refused};
use super::{CheckEffort, CheckRow};
use crate::cases::{MemorySeries, POLYMER, POLYMER_10};
use crate::frame::FrameKind;
use crate::geometry::Directions;
use crate::map::{Map, MapError, MapOptions, map};
use crate::model::{Optics, Surface, Variant, radiance};
use crate::series::SampleKind;

const AREA: &str = "maps";
const TRUTH: &str = "known truth";
const UNITS: &str = "a change of units";
const NONE: &str = "no value is possible";

/// Exposure time of all frames before the change of units.
const EXPOSURE_S: f64 = 0.02;
/// Counts of the brightest frame above black.
const PEAK_DN: f64 = 40_000.0;

/// A series of a uniform sample, with the noise-free counts of its frames.
struct UniformSeries {
    series: MemorySeries,
    /// Counts of each frame above black, before noise.
    clean_dn: Vec<f64>,
}

/// A uniform sample and its scan.
struct MapCase {
    surface: Surface,
    tilts: u32,
    azimuths: u32,
    /// Columns and rows of a frame.
    edge_px: u32,
    metal: bool,
    flats: bool,
    /// Factor of every exposure time.
    time_unit: f64,
    /// Factor of every length.
    length_unit: f64,
}

impl MapCase {
    fn new(effort: CheckEffort) -> Self {
        MapCase {
            surface: POLYMER.with_alpha(0.11, 0.13).surface,
            tilts: 7,
            azimuths: 12,
            edge_px: if effort == CheckEffort::Quick { 6 } else { 16 },
            metal: false,
            flats: true,
            time_unit: 1.0,
            length_unit: 1.0,
        }
    }
}

impl UniformSeries {
    fn new(case: &MapCase) -> Self {
        Self::painted_by(case, &|directions, surface, optics| {
            radiance(Variant::Sawtooth, directions, surface, optics)
        })
    }

    /// Paints the frames with the radiances of `painter`.
    fn painted_by(case: &MapCase, painter: &dyn Fn(&Directions, &Surface, &Optics) -> f64) -> Self {
        let mut manifest = POLYMER_10.manifest();
        let camera = &mut manifest.camera;
        (camera.width_px, camera.height_px) = (case.edge_px, case.edge_px);
        for side in [&mut camera.field_width_mm, &mut camera.field_height_mm] {
            *side = side.map(|mm| mm * case.length_unit);
        }
        let exposure_s = EXPOSURE_S * case.time_unit;
        camera.exposures_s = vec![exposure_s];
        manifest.rig.rotation_axis_px = Some([f64::from(case.edge_px) / 2.0; 2]);
        let mut surface = case.surface;
        if case.metal {
            let sample = &mut manifest.sample;
            sample.kind = SampleKind::Conductor;
            (sample.eta, sample.k) = (Some(1.5), Some(30.0));
            (sample.eta_std, sample.k_std) = (Some(0.0), Some(0.0));
            surface.rho_d = 0.0;
        }
        let rig = manifest.rig_geometry();
        let optics = Optics::new(&rig, &manifest.material());
        let flat = manifest.flat.as_ref();
        let white = flat.and_then(|f| f.reflectance).unwrap_or(1.0);
        let mut series = MemorySeries::new(manifest);
        series.take(FrameKind::Dark, 0.0, 0.0, exposure_s);
        for t in 0..case.tilts {
            let tilt_deg = -20.0 + 40.0 * f64::from(t) / f64::from((case.tilts - 1).max(1));
            if case.flats {
                series.take(FrameKind::Flat, tilt_deg, 0.0, exposure_s);
            }
            for a in 0..case.azimuths {
                let azimuth_deg = 360.0 / f64::from(case.azimuths) * f64::from(a);
                series.take(FrameKind::Sample, tilt_deg, azimuth_deg, exposure_s);
            }
        }
        let light = series.rows.iter().map(|row| {
            let directions = rig.directions(row.pose());
            match row.kind {
                FrameKind::Dark => 0.0,
                FrameKind::Flat => white / std::f64::consts::PI * directions.incident.z,
                FrameKind::Sample => painter(&directions, &surface, &optics),
            }
        });
        let light: Vec<f64> = light.collect();
        let brightest = light.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        UniformSeries {
            clean_dn: light.iter().map(|l| PEAK_DN * l / brightest).collect(),
            series,
        }
    }

    /// The series with frames that have counting and read noise.
    fn exposed(&self) -> MemorySeries {
        let camera = &self.series.manifest.camera;
        let black = camera.black_level_dn.unwrap_or(0.0);
        let gain = camera.gain_dn_per_electron;
        let read_noise = camera.read_noise_electrons_rms.unwrap_or(0.0);
        let mut random = rand_pcg::Pcg64::seed_from_u64(0);
        let mut series = self.series.clone();
        series.expose(|index, _, pixel| {
            if pixel == 0 {
                random = rand_pcg::Pcg64::seed_from_u64(index as u64);
            }
            let clean_dn = self.clean_dn[index];
            let std_dn = gain * (clean_dn / gain + read_noise * read_noise).sqrt();
            let draw: f64 = random.sample(StandardNormal);
            (black + clean_dn + std_dn * draw)
                .round()
                .clamp(0.0, f64::from(u16::MAX)) as u16
        });
        series
    }
}

/// Maps without integrated double reflections, because the closed form made the frames.
fn mapped(source: &UniformSeries, cancel: &AtomicBool) -> Result<Map, MapError> {
    let options = MapOptions {
        target_error: Some(0.5),
        ..MapOptions::default()
    };
    map(&source.exposed(), &options, &|_| {}, cancel)
}

/// Median of a layer with its standard uncertainty: the uncertainty of a single pixel over the root of their number, and
/// the part common to all pixels.
fn median(map: &Map, k: usize) -> Option<(f64, f64)> {
    let layer = &map.layers.parameters[k];
    let mut values: Vec<(f32, f32)> = layer
        .values
        .iter()
        .copied()
        .zip(layer.std.iter().copied())
        .filter(|(value, _)| value.is_finite())
        .collect();
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (value, std) = *values.get(values.len() / 2)?;
    // The variance of a median is π/2 that of a mean.
    let own = f64::from(std).powi(2) * std::f64::consts::FRAC_PI_2 / values.len() as f64;
    let shared = map.shared_std.map_or(0.0, |s| s[k]);
    Some((f64::from(value), (own + shared * shared).sqrt()))
}

/// Indices and true values of θr, both α and the fifth parameter; without a white reference there is no rho_d.
fn truths(case: &MapCase) -> Vec<(usize, f64)> {
    let s = &case.surface;
    let fifth = if case.metal { s.amplitude } else { s.rho_d };
    let mut truths = vec![(0, s.theta_r.to_degrees()), (2, s.alpha_u), (3, s.alpha_v)];
    if case.flats || case.metal {
        truths.push((4, fifth));
    }
    truths
}

pub(super) fn rows(effort: CheckEffort, cancel: &AtomicBool) -> Vec<CheckRow> {
    let mut rows = Vec::new();
    let plain = MapCase::new(effort);
    for (name, case) in [
        ("7 tilts, 12 azimuths", MapCase::new(effort)),
        (
            "single-pixel frames",
            MapCase {
                edge_px: 1,
                ..MapCase::new(effort)
            },
        ),
        (
            "k = 30",
            MapCase {
                metal: true,
                ..MapCase::new(effort)
            },
        ),
    ] {
        truth(&mut rows, name, &case, cancel);
    }
    for flats in [true, false] {
        let reference = MapCase {
            flats,
            ..MapCase::new(effort)
        };
        units(&mut rows, &reference, cancel);
    }
    hopeless(&mut rows, &plain, cancel);
    rows
}

fn truth(rows: &mut Vec<CheckRow>, name: &str, case: &MapCase, cancel: &AtomicBool) {
    let found = mapped(&UniformSeries::new(case), cancel);
    for (k, truth) in truths(case) {
        let (layer, value) = match &found {
            Ok(map) => (map.layers.parameters[k].name, median(map, k)),
            Err(_) => ("a parameter", None),
        };
        let (value, std) = value.unwrap_or((f64::NAN, f64::NAN));
        let quantity = format!("{layer}, median");
        let judged = covered(truth, std, value);
        rows.push(CheckRow::new(AREA, name, quantity, TRUTH, judged));
    }
}

/// A unit of time that is off by 1e12 changes only the scale of a map without white reference; a unit of length changes
/// only the positions of pixels.
fn units(rows: &mut Vec<CheckRow>, plain: &MapCase, cancel: &AtomicBool) {
    let reference = mapped(&UniformSeries::new(plain), cancel);
    let white = if plain.flats {
        "with a white reference"
    } else {
        "no white reference"
    };
    if !plain.flats
        && let Ok(map) = &reference
    {
        let found = median(map, 4).map_or("none", |_| "a value");
        let judged = one_of(&["none"], found);
        rows.push(CheckRow::new(AREA, white, "rho_d, median", NONE, judged));
    }
    for (what, time_unit, length_unit) in [
        ("times", 1e12, 1.0),
        ("times", 1e-12, 1.0),
        ("lengths", 1.0, 1e12),
        ("lengths", 1.0, 1e-12),
    ] {
        let factor = time_unit * length_unit;
        let case = MapCase {
            surface: plain.surface,
            time_unit,
            length_unit,
            ..*plain
        };
        let found = mapped(&UniformSeries::new(&case), cancel);
        let name = format!("unit of {what} off by {factor:e}, {white}");
        for (k, _) in truths(plain) {
            let of = |map: &Result<Map, MapError>| map.as_ref().ok().and_then(|m| median(m, k));
            let judged = match (of(&reference), of(&found)) {
                // Both maps reach the minimum to far less than its uncertainty.
                (Some((a, std)), Some((b, _))) => limit(0.0, 1e-3, (b - a) / std),
                _ => one_of(
                    &["a map"],
                    &found
                        .as_ref()
                        .map_or_else(|error| error.to_string(), |_| "no value".to_owned()),
                ),
            };
            let layer = found
                .as_ref()
                .map_or("a parameter", |map| map.layers.parameters[k].name);
            let quantity = format!("{layer}, change over its uncertainty");
            rows.push(CheckRow::new(AREA, name.clone(), quantity, UNITS, judged));
        }
    }
}

fn hopeless(rows: &mut Vec<CheckRow>, plain: &MapCase, cancel: &AtomicBool) {
    let mut refuse = |name: &str, word: &str, painted: UniformSeries| {
        let found = mapped(&painted, cancel)
            .map(|map| format!("{} pixels", map.pixels_fitted))
            .map_err(|e| e.to_string());
        rows.push(CheckRow::new(
            AREA,
            name,
            "a map",
            NONE,
            refused(word, &found),
        ));
    };
    let few = MapCase {
        tilts: 1,
        azimuths: 5,
        ..*plain
    };
    refuse("five poses", "scan at least 6", UniformSeries::new(&few));
    let matte = MapCase {
        surface: Surface {
            // A lobe this wide is constant.
            alpha_u: 1e3,
            alpha_v: 1e3,
            ..plain.surface
        },
        ..*plain
    };
    refuse("no lobe", "no pixel", UniformSeries::new(&matte));
    let mut dark = UniformSeries::new(plain);
    dark.clean_dn.fill(0.0);
    refuse("everything is dark", "no light", dark);
    let mut full = UniformSeries::new(plain);
    full.clean_dn.fill(1e9);
    refuse("all frames saturated", "saturated", full);

    // One azimuth determines the ridge angle only as far as the lean direction is known.
    let one = MapCase {
        azimuths: 1,
        ..*plain
    };
    let found = mapped(&UniformSeries::new(&one), cancel);
    let claimed = found.as_ref().ok().and_then(|map| median(map, 0));
    let (_, truth) = truths(&one)[0];
    let judged = match (claimed, &found) {
        (Some((value, std)), _) => covered(truth, std, value),
        (None, Ok(_)) => one_of(&["nothing"], "nothing"),
        (None, Err(error)) => refused("poses", &Err::<String, _>(error.to_string())),
    };
    rows.push(CheckRow::new(
        AREA,
        "one azimuth only",
        "theta_r_deg, median, if claimed",
        TRUTH,
        judged,
    ));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::left_out::POLARISATION;
    use crate::model::prepared::OpticsTable;
    use crate::model::quadrature::Quadrature;

    #[test]
    fn steep_plastic_is_mapped_right_with_and_without_polarisation() {
        let case = MapCase {
            surface: Surface {
                theta_r: 0.35,
                ..POLYMER.with_alpha(0.11, 0.13).surface
            },
            tilts: 9,
            edge_px: 8,
            ..MapCase::new(CheckEffort::Quick)
        };
        for polarised in [true, false] {
            let plate = UniformSeries::painted_by(&case, &|directions, surface, optics| {
                let table = OpticsTable::new(optics);
                let painter = Quadrature::new(surface, &table).with_polarisation(polarised);
                painter.radiance(directions, 1e-6).value
            });
            let go = AtomicBool::new(false);
            let found = map(&plate.exposed(), &MapOptions::default(), &|_| {}, &go).unwrap();
            let (angle, _) = median(&found, 0).unwrap();
            let off = angle - case.surface.theta_r.to_degrees();
            assert!(off.abs() < 0.05, "{polarised}: off by {off}");
            let without = found.left_out.iter().any(|l| l.what == POLARISATION);
            assert_eq!(without, !polarised, "{:?}", found.left_out);
        }
    }
}
