//! Plates of steep plastic, painted by nature's light and by a renderer's that knows no polarisation.

use super::*;
use crate::frame::{Frame, FrameKind};
use crate::model::left_out::POLARISATION;
use crate::model::prepared::OpticsTable;
use crate::model::quadrature::Quadrature;
use crate::model::{Optics, Surface};
use crate::reduction::FrameReadError;
use crate::series::{FrameRow, Manifest};

const EDGE: u32 = 8;
const EXPOSURE_S: f64 = 0.02;
const PEAK_DN: f64 = 40_000.0;
const SURFACE: Surface = Surface {
    theta_r: 0.35,
    alpha_u: 0.1,
    alpha_v: 0.12,
    rho_d: 0.3,
    amplitude: 1.0,
};

/// A plate that is the same everywhere.
struct Plate {
    manifest: Manifest,
    rows: Vec<FrameRow>,
    /// Above black, per frame.
    level_dn: Vec<f64>,
}

impl Plate {
    fn new(polarised: bool) -> Self {
        let text = include_str!("../../tests/data/series/polymer-10/manifest.toml");
        let mut manifest = Manifest::from_toml(text, "manifest.toml").unwrap();
        (manifest.camera.width_px, manifest.camera.height_px) = (EDGE, EDGE);
        manifest.camera.exposures_s = vec![EXPOSURE_S];
        manifest.rig.rotation_axis_px = Some([f64::from(EDGE) / 2.0; 2]);
        let rig = manifest.rig_geometry();
        let table = OpticsTable::new(&Optics::new(&rig, &manifest.material()));
        let painter = Quadrature::new(&SURFACE, &table).with_polarisation(polarised);
        let white = manifest.flat.as_ref().unwrap().reflectance.unwrap();
        let (mut rows, mut light) = (Vec::new(), Vec::new());
        let mut take = |kind, theta_c_deg, phi_s_deg| {
            let row = FrameRow {
                file: format!("frames/{}.png", rows.len()),
                kind,
                theta_c_deg,
                phi_s_deg,
                exposure_s: EXPOSURE_S,
                repeat: 0,
                timestamp: String::new(),
            };
            let directions = rig.directions(row.pose());
            light.push(match kind {
                FrameKind::Dark => 0.0,
                FrameKind::Flat => white / std::f64::consts::PI * directions.incident.z,
                FrameKind::Sample => painter.radiance(&directions, 1e-6).value,
            });
            rows.push(row);
        };
        take(FrameKind::Dark, 0.0, 0.0);
        for tilt in (-20..=20).step_by(5).map(f64::from) {
            take(FrameKind::Flat, tilt, 0.0);
            for turn in (0..360).step_by(30).map(f64::from) {
                take(FrameKind::Sample, tilt, turn);
            }
        }
        let brightest = light.iter().copied().fold(0.0, f64::max);
        Plate {
            manifest,
            rows,
            level_dn: light.iter().map(|l| PEAK_DN * l / brightest).collect(),
        }
    }
}

impl FrameSource for Plate {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }
    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }
    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let black = self.manifest.camera.black_level_dn.unwrap();
        let level = (black + self.level_dn[index]).round() as u16;
        let pixels = vec![level; (EDGE * EDGE) as usize];
        Ok(Frame::new(EDGE, EDGE, pixels).unwrap())
    }
}

#[test]
fn a_plate_of_plastic_is_read_right_by_either_light_and_the_map_says_which() {
    for polarised in [true, false] {
        let go = AtomicBool::new(false);
        let found = map(&Plate::new(polarised), &MapOptions::default(), &|_| {}, &go).unwrap();
        let angles = &found.layers.parameters[0].values;
        let finite: Vec<f64> = angles
            .iter()
            .filter(|a| a.is_finite())
            .map(|a| f64::from(*a))
            .collect();
        assert!(!finite.is_empty());
        for angle in finite {
            let off = angle - SURFACE.theta_r.to_degrees();
            assert!(off.abs() < 0.05, "{polarised}: off by {off}");
        }
        let without = found.left_out.iter().any(|l| l.what == POLARISATION);
        assert_eq!(without, !polarised, "{:?}", found.left_out);
    }
}
