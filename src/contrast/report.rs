//! The report of a contrast table, as `contrast --json` prints it.

use serde::Serialize;
use utoipa::ToSchema;

use super::{ContrastKind, ContrastScan, ScanPair, StrayLight, rounded_deg};
use crate::forecast::Expected;
use crate::model::LeftOut;
use crate::model::contrast::{Contrast, Findings, Line, Mean, PAIRS, Table};

/// The contrasts of a scan.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ContrastReport {
    /// The table.
    #[serde(flatten)]
    pub table: ReportedTable,
    /// `measured`.
    #[schema(value_type = String)]
    pub mode: &'static str,
    /// Region of the frames; null for the whole frame.
    pub region: Option<String>,
    /// `white reference`: radiances and absolute contrasts are for a lamp irradiance of 1; `arbitrary`: they are fractions
    /// of the brightest level.
    #[schema(value_type = String)]
    pub scale: &'static str,
    /// Stray light in every signal.
    pub stray_light: StrayLight,
    /// What a person must know.
    pub warnings: Vec<String>,
    /// Largest standard uncertainty of a contrast, as a share of the largest; null where all contrasts are 0.
    pub model_error: Option<Expected>,
    /// What no uncertainty includes.
    pub left_out: Vec<LeftOut>,
}

/// A contrast table, measured or predicted.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ReportedTable {
    /// One line for each tilt, and where it was predicted for each ridge angle.
    pub lines: Vec<ReportedLine>,
    /// Means of the contrasts.
    pub mean: ReportedMeans,
    /// The findings of Luongo et al. 2017; null where the table has too few lines.
    pub findings: Option<ReportedFindings>,
    /// Program and version.
    #[schema(value_type = String)]
    pub program: &'static str,
}

/// A contrast, with its standard uncertainties (k = 1) where it was measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct ReportedContrast {
    /// |a − b|, in the unit of the radiances.
    pub absolute: f64,
    /// Its standard uncertainty.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub absolute_std: Option<f64>,
    /// |a − b|/(a + b); null where both are dark.
    #[schema(value_type = Option<f64>)]
    pub michelson: f64,
    /// Its standard uncertainty.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub michelson_std: Option<f64>,
}

/// A line of the table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct ReportedLine {
    /// Ridge angle, degrees; only of a prediction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub theta_r_deg: Option<f64>,
    /// Camera tilt, degrees.
    pub theta_c_deg: f64,
    /// Radiances by azimuth.
    pub radiance: RadianceByAzimuth,
    /// Contrasts by pair of azimuths.
    pub contrast: ContrastByPair,
}

/// Radiances at the paper's azimuths φs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct RadianceByAzimuth {
    /// At 0°.
    #[serde(rename = "0")]
    pub at_0: f64,
    /// At 90°.
    #[serde(rename = "90")]
    pub at_90: f64,
    /// At 180°.
    #[serde(rename = "180")]
    pub at_180: f64,
}

/// Contrasts of the paper's pairs of azimuths φs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct ContrastByPair {
    /// Between 0° and 90°.
    #[serde(rename = "0-90")]
    pub first: ReportedContrast,
    /// Between 90° and 180°.
    #[serde(rename = "90-180")]
    pub second: ReportedContrast,
}

/// Means of contrasts over all other settings.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ReportedMeans {
    /// By camera tilt.
    pub by_theta_c: Vec<MeanAtTilt>,
    /// By pair of azimuths.
    pub by_phi_s: Vec<MeanOfPair>,
    /// Means by ridge angle; only of a prediction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by_theta_r: Option<Vec<MeanAtRidge>>,
    /// The mean of all contrasts; only of a measurement.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub all: Option<MeanOfAll>,
}

/// The mean at a tilt.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct MeanAtTilt {
    /// Camera tilt, degrees.
    pub theta_c_deg: f64,
    /// The mean.
    #[serde(flatten)]
    pub contrast: ReportedContrast,
}

/// The mean of a pair of azimuths.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MeanOfPair {
    /// `0-90` or `90-180`.
    pub phi_s_deg: String,
    /// The mean.
    #[serde(flatten)]
    pub contrast: ReportedContrast,
}

/// The mean of a ridge angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct MeanAtRidge {
    /// Ridge angle, degrees.
    pub theta_r_deg: f64,
    /// The mean.
    #[serde(flatten)]
    pub contrast: ReportedContrast,
}

/// The mean of all contrasts.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MeanOfAll {
    /// The tilts that it includes, degrees.
    pub theta_c_deg: Vec<f64>,
    /// The mean.
    #[serde(flatten)]
    pub contrast: ReportedContrast,
}

/// The paper's three findings, each with whether the table shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
pub struct ReportedFindings {
    /// Mean contrast is greatest at θc = 0.
    pub greatest_at_theta_c_0: bool,
    /// Mean contrast is greatest at the smallest ridge angle.
    pub greatest_at_smallest_theta_r: bool,
    /// The mean of 0° to 90° is greater than that of 90° to 180°.
    #[serde(rename = "0-90_above_90-180")]
    pub first_pair_above_second: bool,
}

impl From<Findings> for ReportedFindings {
    fn from(found: Findings) -> Self {
        ReportedFindings {
            greatest_at_theta_c_0: found.greatest_at_normal_tilt,
            greatest_at_smallest_theta_r: found.greatest_at_smallest_ridge,
            first_pair_above_second: found.first_quarter_stronger,
        }
    }
}

impl ReportedTable {
    /// Reports a predicted table.
    #[must_use]
    pub fn predicted(table: &Table) -> Self {
        ReportedTable::of(table, None)
    }

    /// Reports the table that was measured in a scan, with the standard uncertainties of contrasts and means.
    #[must_use]
    pub fn measured(table: &Table, scan: &ContrastScan<'_>) -> Self {
        ReportedTable::of(table, Some(scan))
    }

    fn of(table: &Table, scan: Option<&ContrastScan<'_>>) -> Self {
        let contrast = |of: &Contrast, pairs: &[ScanPair]| {
            let std = |kind| scan.map(|scan| scan.mean(kind, pairs).std);
            ReportedContrast {
                absolute: of.absolute,
                absolute_std: std(ContrastKind::Absolute),
                michelson: of.michelson,
                michelson_std: std(ContrastKind::Michelson),
            }
        };
        let line = |(n, line): (usize, &Line)| ReportedLine {
            theta_r_deg: scan.is_none().then(|| rounded_deg(line.theta_r)),
            theta_c_deg: rounded_deg(line.theta_c),
            radiance: RadianceByAzimuth {
                at_0: line.radiance[0],
                at_90: line.radiance[1],
                at_180: line.radiance[2],
            },
            contrast: ContrastByPair {
                first: contrast(&line.contrast[0], &[(n, 0)]),
                second: contrast(&line.contrast[1], &[(n, 1)]),
            },
        };
        let at_tilt =
            |n: usize| -> Vec<ScanPair> { (0..PAIRS.len()).map(|pair| (n, pair)).collect() };
        let of_pair =
            |pair: usize| -> Vec<ScanPair> { (0..table.lines.len()).map(|n| (n, pair)).collect() };
        let deg = |mean: &Mean| mean.setting.parse().unwrap_or(f64::NAN);
        let means = ReportedMeans {
            by_theta_c: (0..)
                .zip(&table.by_theta_c)
                .map(|(n, mean)| MeanAtTilt {
                    theta_c_deg: deg(mean),
                    contrast: contrast(&mean.contrast, &at_tilt(n)),
                })
                .collect(),
            by_phi_s: (0..)
                .zip(&table.by_phi_s)
                .map(|(pair, mean)| MeanOfPair {
                    phi_s_deg: mean.setting.clone(),
                    contrast: contrast(&mean.contrast, &of_pair(pair)),
                })
                .collect(),
            by_theta_r: scan.is_none().then(|| {
                let means = table.by_theta_r.iter();
                means
                    .map(|mean| MeanAtRidge {
                        theta_r_deg: deg(mean),
                        contrast: contrast(&mean.contrast, &[]),
                    })
                    .collect()
            }),
            all: scan.map(|scan| {
                let pairs = scan.pairs();
                let value = |kind| scan.mean(kind, &pairs).value;
                let of = Contrast {
                    absolute: value(ContrastKind::Absolute),
                    michelson: value(ContrastKind::Michelson),
                };
                MeanOfAll {
                    theta_c_deg: scan.turns.theta_c_deg(),
                    contrast: contrast(&of, &pairs),
                }
            }),
        };
        ReportedTable {
            lines: table.lines.iter().enumerate().map(line).collect(),
            mean: means,
            findings: table.findings().map(ReportedFindings::from),
            program: concat!("ridged ", env!("CARGO_PKG_VERSION")),
        }
    }
}
