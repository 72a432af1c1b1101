//! Maps of surfaces that are the same everywhere: the truth that was put in, changes of unit that must change nothing,
//! and series that hold no map.

use std::sync::atomic::AtomicBool;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::criterion::{covered, limit, one_of, refused};
use super::{Effort, Row};
use crate::frame::{Frame, FrameKind};
use crate::geometry::Directions;
use crate::map::{Map, MapError, MapOptions, map};
use crate::model::{Optics, Surface, Variant, radiance};
use crate::reduction::{FrameReadError, FrameSource};
use crate::series::{FrameRow, Manifest, SampleKind};

const AREA: &str = "maps";
const TRUTH: &str = "truth that was put in";
const UNITS: &str = "a change of units";
const NONE: &str = "no such answer";

/// A rig and camera as in the recorded series.
const MANIFEST: &str = include_str!("../../tests/data/series/polymer-10/manifest.toml");
/// Exposure time of all frames before the unit changes, and what the brightest frame counts above black.
const EXPOSURE_S: f64 = 0.02;
const PEAK_DN: f64 = 40_000.0;

/// A series in memory whose frames show a closed form, with counting noise.
struct Painted {
    manifest: Manifest,
    rows: Vec<FrameRow>,
    /// What each frame counts above black, before noise.
    clean_dn: Vec<f64>,
}

/// What is painted.
struct Wish {
    surface: Surface,
    tilts: u32,
    turns: u32,
    /// Columns and rows of a frame.
    edge: u32,
    metal: bool,
    flats: bool,
    /// What every exposure time is multiplied by.
    time_unit: f64,
    /// What every length is multiplied by.
    length_unit: f64,
}

fn surface() -> Surface {
    Surface {
        theta_r: 11f64.to_radians(),
        alpha_u: 0.11,
        alpha_v: 0.13,
        rho_d: 0.3,
        amplitude: 1.0,
    }
}

impl Wish {
    fn new(effort: Effort) -> Self {
        Wish {
            surface: surface(),
            tilts: 7,
            turns: 12,
            edge: if effort == Effort::Quick { 6 } else { 16 },
            metal: false,
            flats: true,
            time_unit: 1.0,
            length_unit: 1.0,
        }
    }
}

impl Painted {
    fn new(wish: &Wish) -> Self {
        Self::by(wish, &|directions, surface, optics| {
            radiance(Variant::Sawtooth, directions, surface, optics)
        })
    }

    /// Frames of what a painter says of the radiance.
    fn by(wish: &Wish, painter: &dyn Fn(&Directions, &Surface, &Optics) -> f64) -> Self {
        let mut manifest = Manifest::from_toml(MANIFEST, "manifest.toml")
            .expect("the program's own manifest is right");
        let camera = &mut manifest.camera;
        (camera.width_px, camera.height_px) = (wish.edge, wish.edge);
        for side in [&mut camera.field_width_mm, &mut camera.field_height_mm] {
            *side = side.map(|mm| mm * wish.length_unit);
        }
        camera.exposures_s = vec![EXPOSURE_S * wish.time_unit];
        manifest.rig.rotation_axis_px = Some([f64::from(wish.edge) / 2.0; 2]);
        let mut surface = wish.surface;
        if wish.metal {
            let sample = &mut manifest.sample;
            sample.kind = SampleKind::Conductor;
            (sample.eta, sample.k) = (Some(1.5), Some(30.0));
            (sample.eta_std, sample.k_std) = (Some(0.0), Some(0.0));
            surface.rho_d = 0.0;
        }
        let rig = manifest.rig_geometry();
        let optics = Optics::new(&rig, &manifest.material());
        let white = manifest
            .flat
            .as_ref()
            .and_then(|f| f.reflectance)
            .unwrap_or(1.0);
        let mut rows = Vec::new();
        let mut light = Vec::new();
        let mut take = |kind: FrameKind, theta_c_deg: f64, phi_s_deg: f64| {
            let row = FrameRow {
                file: format!("frames/{}.png", rows.len()),
                kind,
                theta_c_deg,
                phi_s_deg,
                exposure_s: EXPOSURE_S * wish.time_unit,
                repeat: 0,
                timestamp: String::new(),
            };
            let directions = rig.directions(row.pose());
            light.push(match kind {
                FrameKind::Dark => 0.0,
                FrameKind::Flat => white / std::f64::consts::PI * directions.incident.z,
                FrameKind::Sample => painter(&directions, &surface, &optics),
            });
            rows.push(row);
        };
        take(FrameKind::Dark, 0.0, 0.0);
        for t in 0..wish.tilts {
            let tilt = -20.0 + 40.0 * f64::from(t) / f64::from((wish.tilts - 1).max(1));
            if wish.flats {
                take(FrameKind::Flat, tilt, 0.0);
            }
            for p in 0..wish.turns {
                let turn = 360.0 / f64::from(wish.turns) * f64::from(p);
                take(FrameKind::Sample, tilt, turn);
            }
        }
        let brightest = light.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        Painted {
            manifest,
            rows,
            clean_dn: light.iter().map(|l| PEAK_DN * l / brightest).collect(),
        }
    }
}

impl FrameSource for Painted {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let camera = &self.manifest.camera;
        let black = camera.black_level_dn.unwrap_or(0.0);
        let gain = camera.gain_dn_per_electron;
        let electrons = self.clean_dn[index] / gain;
        let read_noise = camera.read_noise_electrons_rms.unwrap_or(0.0);
        let std_dn = gain * (electrons + read_noise * read_noise).sqrt();
        let mut random = rand_pcg::Pcg64::seed_from_u64(index as u64);
        let pixels = (0..camera.width_px * camera.height_px)
            .map(|_| {
                let draw: f64 = random.sample(StandardNormal);
                (black + self.clean_dn[index] + std_dn * draw)
                    .round()
                    .clamp(0.0, f64::from(u16::MAX)) as u16
            })
            .collect();
        Ok(Frame::new(camera.width_px, camera.height_px, pixels).expect("a full frame"))
    }
}

/// A map without integrated double reflections, since the truth here is the closed form itself.
fn mapped(source: &Painted, cancel: &AtomicBool) -> Result<Map, MapError> {
    let options = MapOptions {
        target_error: Some(0.5),
        ..MapOptions::default()
    };
    map(source, &options, &|_| {}, cancel)
}

/// Median of a layer, and the standard uncertainty of it: a pixel's own over the root of their number, and what
/// they share.
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
    // A median scatters π/2 as much as a mean of as many, in variance.
    let own = f64::from(std).powi(2) * std::f64::consts::FRAC_PI_2 / values.len() as f64;
    let shared = map.shared_std.map_or(0.0, |s| s[k]);
    Some((f64::from(value), (own + shared * shared).sqrt()))
}

/// θr, α along and across the ridges, and the fifth, with their truths; without a white reference there is no rho_d.
fn truths(wish: &Wish) -> Vec<(usize, f64)> {
    let s = &wish.surface;
    let fifth = if wish.metal { s.amplitude } else { s.rho_d };
    let mut truths = vec![(0, s.theta_r.to_degrees()), (2, s.alpha_u), (3, s.alpha_v)];
    if wish.flats || wish.metal {
        truths.push((4, fifth));
    }
    truths
}

pub(super) fn rows(effort: Effort, cancel: &AtomicBool) -> Vec<Row> {
    let mut rows = Vec::new();
    let plain = Wish::new(effort);
    for (name, wish) in [
        ("7 tilts, 12 azimuths", Wish::new(effort)),
        (
            "single-pixel frames",
            Wish {
                edge: 1,
                ..Wish::new(effort)
            },
        ),
        (
            "k = 30",
            Wish {
                metal: true,
                ..Wish::new(effort)
            },
        ),
    ] {
        truth(&mut rows, name, &wish, cancel);
    }
    for flats in [true, false] {
        let reference = Wish {
            flats,
            ..Wish::new(effort)
        };
        units(&mut rows, &reference, cancel);
    }
    hopeless(&mut rows, &plain, cancel);
    rows
}

fn truth(rows: &mut Vec<Row>, name: &str, wish: &Wish, cancel: &AtomicBool) {
    let found = mapped(&Painted::new(wish), cancel);
    for (k, truth) in truths(wish) {
        let (layer, value) = match &found {
            Ok(map) => (map.layers.parameters[k].name, median(map, k)),
            Err(_) => ("a parameter", None),
        };
        let (value, std) = value.unwrap_or((f64::NAN, f64::NAN));
        let quantity = format!("{layer}, median");
        let judged = covered(truth, std, value);
        rows.push(Row::new(AREA, name, quantity, TRUTH, judged));
    }
}

/// Times in another unit by 1e12 either way change what a map calls 1 where no white reference tells it, and nothing
/// else; lengths change where pixels are, and nothing else.
fn units(rows: &mut Vec<Row>, plain: &Wish, cancel: &AtomicBool) {
    let reference = mapped(&Painted::new(plain), cancel);
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
        rows.push(Row::new(AREA, white, "rho_d, median", NONE, judged));
    }
    for (what, time_unit, length_unit) in [
        ("times", 1e12, 1.0),
        ("times", 1e-12, 1.0),
        ("lengths", 1.0, 1e12),
        ("lengths", 1.0, 1e-12),
    ] {
        let factor = time_unit * length_unit;
        let wish = Wish {
            surface: plain.surface,
            time_unit,
            length_unit,
            ..*plain
        };
        let found = mapped(&Painted::new(&wish), cancel);
        let name = format!("unit of {what} off by {factor:e}, {white}");
        for (k, _) in truths(plain) {
            let of = |map: &Result<Map, MapError>| map.as_ref().ok().and_then(|m| median(m, k));
            let judged = match (of(&reference), of(&found)) {
                // Both end at the minimum to well below what it means.
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
            rows.push(Row::new(AREA, name.clone(), quantity, UNITS, judged));
        }
    }
}

fn hopeless(rows: &mut Vec<Row>, plain: &Wish, cancel: &AtomicBool) {
    let mut refuse = |name: &str, word: &str, painted: Painted| {
        let told = mapped(&painted, cancel)
            .map(|map| format!("{} pixels", map.pixels_fitted))
            .map_err(|e| e.to_string());
        rows.push(Row::new(AREA, name, "a map", NONE, refused(word, &told)));
    };
    let few = Wish {
        tilts: 1,
        turns: 5,
        ..*plain
    };
    refuse("five poses", "scan at least 6", Painted::new(&few));
    let matte = Wish {
        surface: Surface {
            // A lobe this wide is as good as none.
            alpha_u: 1e3,
            alpha_v: 1e3,
            ..plain.surface
        },
        ..*plain
    };
    refuse("no lobe", "no pixel", Painted::new(&matte));
    let mut dark = Painted::new(plain);
    dark.clean_dn.fill(0.0);
    refuse("everything is dark", "no light", dark);
    let mut full = Painted::new(plain);
    full.clean_dn.fill(1e9);
    refuse("all frames saturated", "saturated", full);

    // One azimuth tells the ridge angle only as far as it is known which way the ridges lean.
    let one = Wish { turns: 1, ..*plain };
    let found = mapped(&Painted::new(&one), cancel);
    let claimed = found.as_ref().ok().and_then(|map| median(map, 0));
    let (_, truth) = truths(&one)[0];
    let judged = match (claimed, &found) {
        (Some((value, std)), _) => covered(truth, std, value),
        (None, Ok(_)) => one_of(&["nothing"], "nothing"),
        (None, Err(error)) => refused("poses", &Err::<String, _>(error.to_string())),
    };
    rows.push(Row::new(
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
    fn a_plate_of_steep_plastic_is_read_right_by_either_light_and_the_map_says_which() {
        let wish = Wish {
            surface: Surface {
                theta_r: 0.35,
                ..surface()
            },
            tilts: 9,
            edge: 8,
            ..Wish::new(Effort::Quick)
        };
        for polarised in [true, false] {
            let plate = Painted::by(&wish, &|directions, surface, optics| {
                let table = OpticsTable::new(optics);
                let painter = Quadrature::new(surface, &table).with_polarisation(polarised);
                painter.radiance(directions, 1e-6).value
            });
            let go = AtomicBool::new(false);
            let found = map(&plate, &MapOptions::default(), &|_| {}, &go).unwrap();
            let (angle, _) = median(&found, 0).unwrap();
            let off = angle - wish.surface.theta_r.to_degrees();
            assert!(off.abs() < 0.05, "{polarised}: off by {off}");
            let without = found.left_out.iter().any(|l| l.what == POLARISATION);
            assert_eq!(without, !polarised, "{:?}", found.left_out);
        }
    }
}
