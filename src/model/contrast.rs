//! Contrast after rotation, the quantity that the authors of the first paper measure.
//!
//! [`predict`] returns the table of θr × θc with the contrasts between φs = 0° and 90° and between 90° and 180°
//! (Luongo et al. 2017, section 4); [`Table::of`] makes the same table from other radiances (a scan, a path tracer).
//! Contrast is the absolute difference of two radiant exposures, known up to the rig's constant k; here it is that of
//! two radiances for lamp irradiance 1 on a surface that faces the lamp. The Michelson contrast |a − b|/(a + b) is
//! independent of k.
//!
//! [`super::optimum`] searches for the surface of greatest contrast.
//!
//! *Conditioning.* An absolute contrast is a difference of radiances of one form, so its error is theirs, not
//! multiplied. Michelson's is computed in units of the greater radiance, since the sum of two large ones may exceed
//! the largest double.
//!
//! Limits of contrast belong to a specification, not to this module.

use crate::geometry::{Pose, RigGeometry};
use crate::units::Angle;

use super::prepared::{OpticsTable, Prepared};
use super::quadrature::Quadrature;
use super::{Optics, Surface, Variant};

/// Ridge angles of the paper's samples, degrees.
pub const PAPER_RIDGES_DEG: [f64; 4] = [5.0, 10.0, 15.0, 20.0];
/// Camera tilts of the paper's experiment, degrees.
pub const PAPER_TILTS_DEG: [f64; 5] = [-20.0, -10.0, 0.0, 10.0, 20.0];
/// Azimuths of the paper's experiment, degrees.
pub const PAPER_AZIMUTHS_DEG: [f64; 3] = [0.0, 90.0, 180.0];

/// The model that computes the radiances.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tier {
    /// A closed form.
    Closed(Variant),
    /// The two-bounce quadrature of the sawtooth.
    Quadrature,
}

/// One radiance of the experiment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Ridge angle.
    pub theta_r: Angle,
    /// Camera tilt.
    pub theta_c: Angle,
    /// Azimuth, as recorded.
    pub phi_s: Angle,
    /// Radiance (or anything proportional to it).
    pub radiance: f64,
}

/// Absolute and Michelson contrast of one pair of azimuths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contrast {
    /// |a − b|.
    pub absolute: f64,
    /// |a − b|/(a + b); 0 if both are dark.
    pub michelson: f64,
}

impl Contrast {
    /// Returns the contrast of two radiances.
    #[must_use]
    pub fn between(a: f64, b: f64) -> Self {
        let absolute = (a - b).abs();
        // In units of the greater one, since the sum of two large ones may exceed the largest double.
        let (low, high) = (a.min(b), a.max(b));
        let michelson = if high > 0.0 && low > -high {
            absolute / high / (1.0 + low / high)
        } else {
            0.0
        };
        Contrast {
            absolute,
            michelson,
        }
    }
}

/// The pairs of azimuths that are compared, by name.
pub const PAIRS: [(&str, usize, usize); 2] = [("0-90", 0, 1), ("90-180", 1, 2)];

/// One line of the table: one ridge angle at one tilt.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Ridge angle.
    pub theta_r: Angle,
    /// Camera tilt.
    pub theta_c: Angle,
    /// Radiances at φs = 0°, 90°, 180°.
    pub radiance: [f64; 3],
    /// Contrasts 0°–90° and 90°–180°.
    pub contrast: [Contrast; 2],
}

/// A mean over the lines that share one setting (the paper's Fig. 8).
#[derive(Debug, Clone, PartialEq)]
pub struct Mean {
    /// The shared setting as text: degrees of θc or θr, or the pair of azimuths.
    pub setting: String,
    /// Mean contrast over the other settings.
    pub contrast: Contrast,
}

/// The contrast table with its means.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// By θr, then θc.
    pub lines: Vec<Line>,
    /// Mean contrast for each tilt.
    pub by_theta_c: Vec<Mean>,
    /// Mean contrast for each ridge angle.
    pub by_theta_r: Vec<Mean>,
    /// Mean contrast for each pair of azimuths.
    pub by_phi_s: Vec<Mean>,
}

/// Whether a table shows the paper's findings (section 5).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Findings {
    /// Mean contrast is greatest at θc = 0.
    pub greatest_at_normal_tilt: bool,
    /// Mean contrast is greatest at the smallest ridge angle (5° in the paper).
    pub greatest_at_smallest_ridge: bool,
    /// Mean contrast of 0°–90° is greater than that of 90°–180°.
    pub first_quarter_stronger: bool,
}

impl Table {
    /// Makes the table from any radiances. Lines that lack an azimuth are left out; angles are matched to a
    /// thousandth of a degree.
    #[must_use]
    pub fn of(exposures: &[Exposure]) -> Self {
        let key = |a: Angle| (a.deg() * 1000.0).round() as i64;
        let mut settings: Vec<(i64, i64)> = Vec::new();
        for e in exposures {
            let setting = (key(e.theta_r), key(e.theta_c));
            if !settings.contains(&setting) {
                settings.push(setting);
            }
        }
        settings.sort_unstable();
        let lines = settings
            .iter()
            .filter_map(|&(ridge, tilt)| {
                let at = |azimuth_deg: f64| {
                    exposures
                        .iter()
                        .find(|e| {
                            key(e.theta_r) == ridge
                                && key(e.theta_c) == tilt
                                && key(e.phi_s) == (azimuth_deg * 1000.0) as i64
                        })
                        .map(|e| (e.radiance, e.theta_r, e.theta_c))
                };
                let [a, b, c] = PAPER_AZIMUTHS_DEG.map(at);
                let ((a, theta_r, theta_c), (b, ..), (c, ..)) = (a?, b?, c?);
                let radiance = [a, b, c];
                Some(Line {
                    theta_r,
                    theta_c,
                    radiance,
                    contrast: PAIRS.map(|(_, j, k)| Contrast::between(radiance[j], radiance[k])),
                })
            })
            .collect();
        Table::from_lines(lines)
    }

    /// Removes the Michelson contrasts of dark pairs: they become NaN and are not part of a mean.
    #[must_use]
    pub fn without_dark(self, is_dark: impl Fn(usize, usize) -> bool) -> Self {
        let mut lines = self.lines;
        for (n, line) in lines.iter_mut().enumerate() {
            for (pair, contrast) in line.contrast.iter_mut().enumerate() {
                if is_dark(n, pair) {
                    contrast.michelson = f64::NAN;
                }
            }
        }
        Table::from_lines(lines)
    }

    fn from_lines(lines: Vec<Line>) -> Self {
        let distinct = |of: fn(&Line) -> Angle| {
            let mut angles: Vec<f64> = lines.iter().map(|l| of(l).deg()).collect();
            angles.sort_by(f64::total_cmp);
            angles.dedup_by(|a, b| (*a - *b).abs() < 5e-4);
            angles
        };
        let mean = |setting: String, keep: &dyn Fn(&Line, usize) -> bool| {
            let kept: Vec<Contrast> = lines
                .iter()
                .flat_map(|l| {
                    (0..PAIRS.len())
                        .filter(|&pair| keep(l, pair))
                        .map(|pair| l.contrast[pair])
                        .collect::<Vec<_>>()
                })
                .collect();
            let n = kept.len().max(1) as f64;
            let known: Vec<f64> = kept
                .iter()
                .map(|c| c.michelson)
                .filter(|m| !m.is_nan())
                .collect();
            Mean {
                setting,
                contrast: Contrast {
                    absolute: kept.iter().map(|c| c.absolute).sum::<f64>() / n,
                    michelson: known.iter().sum::<f64>() / known.len() as f64,
                },
            }
        };
        let by = |of: fn(&Line) -> Angle| {
            distinct(of)
                .into_iter()
                .map(|deg| {
                    mean(format!("{}", (deg * 1e6).round() / 1e6), &|l, _| {
                        (of(l).deg() - deg).abs() < 5e-4
                    })
                })
                .collect()
        };
        Table {
            by_theta_c: by(|l| l.theta_c),
            by_theta_r: by(|l| l.theta_r),
            by_phi_s: PAIRS
                .iter()
                .enumerate()
                .map(|(j, (name, ..))| mean((*name).to_owned(), &|_, pair| pair == j))
                .collect(),
            lines,
        }
    }

    /// Returns which of the paper's findings hold, by absolute contrast; `None` if the table lacks a line at θc = 0, a
    /// second tilt or a second ridge angle.
    #[must_use]
    pub fn findings(&self) -> Option<Findings> {
        let [first, second] = self.by_phi_s.as_slice() else {
            return None;
        };
        if self.by_theta_c.len() < 2 || self.by_theta_r.len() < 2 {
            return None;
        }
        let greatest = |means: &[Mean]| {
            means
                .iter()
                .max_by(|a, b| a.contrast.absolute.total_cmp(&b.contrast.absolute))
                .map(|m| m.setting.clone())
        };
        self.by_theta_c.iter().find(|m| m.setting == "0")?;
        Some(Findings {
            greatest_at_normal_tilt: greatest(&self.by_theta_c).as_deref() == Some("0"),
            greatest_at_smallest_ridge: greatest(&self.by_theta_r)
                == self.by_theta_r.first().map(|m| m.setting.clone()),
            first_quarter_stronger: first.contrast.absolute > second.contrast.absolute,
        })
    }

    /// Returns the largest difference of a radiance from that of another table with the same lines, as a share of the
    /// other's brightest; `None` if the lines differ or all are dark.
    #[must_use]
    pub fn apart(&self, other: &Table) -> Option<f64> {
        let same = |(a, b): (&Line, &Line)| a.theta_r == b.theta_r && a.theta_c == b.theta_c;
        let lines = || self.lines.iter().zip(&other.lines);
        if self.lines.len() != other.lines.len() || !lines().all(same) {
            return None;
        }
        let brightest = other.lines.iter().flat_map(|l| l.radiance);
        let brightest = brightest.fold(0.0, f64::max);
        let differences =
            lines().flat_map(|(a, b)| [0, 1, 2].map(|j| a.radiance[j] - b.radiance[j]));
        let largest = differences.fold(0.0, |worst: f64, d| worst.max(d.abs()));
        (brightest > 0.0).then(|| largest / brightest)
    }

    /// Returns the mean absolute contrast of all lines and pairs.
    #[must_use]
    pub fn mean_absolute(&self) -> f64 {
        let n = (self.lines.len() * PAIRS.len()).max(1) as f64;
        self.lines
            .iter()
            .flat_map(|l| l.contrast.iter().map(|c| c.absolute))
            .sum::<f64>()
            / n
    }
}

/// Allowed error and stopping condition of a prediction.
#[derive(Clone, Copy)]
pub struct Pace<'a> {
    /// Allowed error of the quadrature, as a share of a surface's brightest radiance.
    pub tolerance: f64,
    /// Called before each surface; returns whether to continue.
    pub go_on: &'a (dyn Fn() -> bool + Sync),
}

/// Default of the quadrature's allowed error: below the printed digits of a contrast.
pub const TOLERANCE: f64 = 1e-5;

impl Pace<'_> {
    /// With [`TOLERANCE`] and without a stop.
    pub const UNHURRIED: Pace<'static> = Pace {
        tolerance: TOLERANCE,
        go_on: &|| true,
    };

    /// Returns the same allowed error without a stop.
    #[must_use]
    pub fn to_the_end(&self) -> Pace<'static> {
        Pace {
            tolerance: self.tolerance,
            ..Pace::UNHURRIED
        }
    }
}

/// A predicted table with its error and the ridge angles that were not reached.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// The table.
    pub table: Table,
    /// Largest error of a radiance by the quadrature's estimate, as a share of the brightest; `None` for closed forms.
    pub error: Option<f64>,
    /// Ridge angles that were not reached, degrees.
    pub left: Vec<f64>,
}

/// Predicts the table for surfaces that differ in their ridge angle only (`surface.theta_r` is not used). Angles in
/// degrees, as in the paper.
#[must_use]
pub fn predict(
    tier: Tier,
    rig: &RigGeometry,
    optics: &Optics,
    surface: &Surface,
    ridges_deg: &[f64],
    tilts_deg: &[f64],
) -> Table {
    let all = Pace::UNHURRIED;
    predict_paced(tier, rig, optics, surface, ridges_deg, tilts_deg, &all).table
}

/// As [`predict`], with the allowed error and the stopping condition of `pace`.
#[must_use]
pub fn predict_paced(
    tier: Tier,
    rig: &RigGeometry,
    optics: &Optics,
    surface: &Surface,
    ridges_deg: &[f64],
    tilts_deg: &[f64],
    pace: &Pace<'_>,
) -> Prediction {
    let table = OpticsTable::new(optics);
    let mut exposures = Vec::new();
    let mut poses = Vec::new();
    for &tilt in tilts_deg {
        poses.extend(PAPER_AZIMUTHS_DEG.map(|azimuth| Pose::from_deg(tilt, azimuth)));
    }
    let directions: Vec<_> = poses.iter().map(|&p| rig.directions(p)).collect();
    let (mut error, mut brightest) = (0.0f64, f64::MIN_POSITIVE);
    let mut left = Vec::new();
    for &ridge in ridges_deg {
        if !(pace.go_on)() {
            left.push(ridge);
            continue;
        }
        let surface = Surface {
            theta_r: ridge.to_radians(),
            ..*surface
        };
        let closed = |variant| {
            let prepared = Prepared::new(variant, &surface, &table);
            let all = directions.iter().map(move |d| prepared.partials(d).value);
            all.collect::<Vec<f64>>()
        };
        let radiances: Vec<f64> = match tier {
            Tier::Closed(variant) => closed(variant),
            Tier::Quadrature => {
                let peak = closed(Variant::Sawtooth).into_iter().fold(0.0, f64::max);
                // In agreement with the closed form and the path-traced tables that predictions are compared with.
                let polarised = optics.k > 0.0;
                let quadrature = Quadrature::new(&surface, &table).with_polarisation(polarised);
                let found = quadrature.radiances(&directions, pace.tolerance * peak);
                error = found.iter().map(|e| e.error).fold(error, f64::max);
                found.iter().map(|e| e.value).collect()
            }
        };
        brightest = radiances.iter().copied().fold(brightest, f64::max);
        exposures.extend(
            poses
                .iter()
                .zip(radiances)
                .map(|(pose, radiance)| Exposure {
                    theta_r: Angle::from_deg(ridge),
                    theta_c: pose.theta_c,
                    phi_s: pose.phi_s,
                    radiance,
                }),
        );
    }
    Prediction {
        table: Table::of(&exposures),
        error: (tier == Tier::Quadrature).then_some(error / brightest),
        left,
    }
}

/// Inputs of the tests of contrast and its optimum: the paper's plastic under its lamp.
#[cfg(test)]
pub(super) mod fixture {
    use super::{Optics, RigGeometry, Surface};
    use crate::material::Material;

    /// Plastic on the paper's rig.
    pub fn optics() -> Optics {
        Optics::new(&RigGeometry::BESIDE, &Material::exactly(1.54, 0.0))
    }

    /// Ridges of angle 0 with the same roughness along and across.
    pub fn plastic(alpha: f64) -> Surface {
        Surface {
            theta_r: 0.0,
            alpha_u: alpha,
            alpha_v: alpha,
            rho_d: 0.35,
            amplitude: 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::fixture::{optics, plastic};
    use super::*;

    fn table(tier: Tier, rig: &RigGeometry, alpha: f64) -> Table {
        predict(
            tier,
            rig,
            &optics(),
            &plastic(alpha),
            &PAPER_RIDGES_DEG,
            &PAPER_TILTS_DEG,
        )
    }

    #[test]
    fn on_the_papers_rig_narrow_lobes_show_its_three_findings() {
        for tier in [
            Tier::Closed(Variant::Paper),
            Tier::Closed(Variant::Sawtooth),
            Tier::Quadrature,
        ] {
            let t = table(tier, &RigGeometry::BESIDE, 0.05);
            assert_eq!(t.lines.len(), 20);
            assert_eq!(
                t.findings(),
                Some(Findings {
                    greatest_at_normal_tilt: true,
                    greatest_at_smallest_ridge: true,
                    first_quarter_stronger: true,
                }),
                "{tier:?} {t:?}"
            );
        }
    }

    #[test]
    fn with_the_lamp_in_the_tilt_plane_the_findings_do_not_all_hold() {
        let f = table(Tier::Closed(Variant::Paper), &RigGeometry::IN_PLANE, 0.05)
            .findings()
            .unwrap();
        assert!(
            !(f.greatest_at_normal_tilt
                && f.greatest_at_smallest_ridge
                && f.first_quarter_stronger)
        );
    }

    fn traced(text: &str, alpha: Option<f64>) -> Vec<Exposure> {
        text.lines()
            .skip(1)
            .filter_map(|line| {
                let x: Vec<f64> = line.split(',').map(|f| f.parse().unwrap()).collect();
                let at = usize::from(alpha.is_some());
                if alpha.is_some_and(|a| a != x[0]) {
                    return None;
                }
                Some(Exposure {
                    theta_r: Angle::from_deg(x[at]),
                    theta_c: Angle::from_deg(x[at + 1]),
                    phi_s: Angle::from_deg(x[at + 2]),
                    radiance: x[at + 3],
                })
            })
            .collect()
    }

    /// Returns the largest and the rms difference of the absolute contrasts, over the largest contrast.
    fn off(a: &Table, b: &Table) -> (f64, f64) {
        let pairs: Vec<(f64, f64)> = a
            .lines
            .iter()
            .zip(&b.lines)
            .flat_map(|(x, y)| [0, 1].map(|j| (x.contrast[j].absolute, y.contrast[j].absolute)))
            .collect();
        let scale = pairs.iter().map(|p| p.1).fold(0.0, f64::max);
        let worst = pairs.iter().map(|p| (p.0 - p.1).abs()).fold(0.0, f64::max);
        let square = pairs.iter().map(|p| (p.0 - p.1).powi(2)).sum::<f64>() / pairs.len() as f64;
        (worst / scale, square.sqrt() / scale)
    }

    #[test]
    fn contrasts_agree_with_path_tracing() {
        let beside = include_str!("../../tests/data/contrast-raytraced-paper-rig.csv");
        let in_plane = include_str!("../../tests/data/contrast-raytraced.csv");
        for (rig, text, column, alpha, rho_d) in [
            (RigGeometry::BESIDE, beside, Some(0.06), 0.06, 0.342),
            (RigGeometry::BESIDE, beside, Some(0.12), 0.12, 0.33725),
            (RigGeometry::IN_PLANE, in_plane, None, 0.12, 0.33725),
        ] {
            let truth = Table::of(&traced(text, column));
            assert_eq!(truth.lines.len(), 20);
            let surface = Surface {
                rho_d,
                ..plastic(alpha)
            };
            let ours = |tier| {
                predict(
                    tier,
                    &rig,
                    &optics(),
                    &surface,
                    &PAPER_RIDGES_DEG,
                    &PAPER_TILTS_DEG,
                )
            };
            let (worst, rms) = off(&ours(Tier::Quadrature), &truth);
            let (closed, _) = off(&ours(Tier::Closed(Variant::Sawtooth)), &truth);
            let (paper, _) = off(&ours(Tier::Closed(Variant::Paper)), &truth);
            eprintln!(
                "alpha {alpha}: quadrature {worst:.5} rms {rms:.5}; closed {closed:.5}; paper {paper:.5}"
            );
            // As shares of the largest contrast; the tracer itself is good to 0.0003.
            assert!(worst < 0.006, "{worst} {rms}");
            assert!(closed < 0.012, "{closed}");
            // The printed lobe lacks the diffuse light and has three times the contrast.
            assert!(paper > 1.0, "{paper}");
        }
    }
}
