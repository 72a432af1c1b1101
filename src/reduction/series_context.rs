//! What is the same for all reductions of a series: how its pixels look at the sample, and what its calibration depends on.

use std::collections::HashMap;
use std::fmt::Write;

use serde::Serialize;
use serde_json::json;
use sha2::{Digest, Sha256};

use super::flats::Judged;
use super::viewing::Viewing;
use super::{FrameSource, ReductionError};
use crate::frame::FrameKind;
use crate::series::FrameRow;

/// Form of the stored sums. A program that computes others raises it, and computes them again.
const FORM: u32 = 1;

/// What the response of the pixels is taken from.
#[derive(Clone, Copy, Serialize)]
#[serde(rename_all = "lowercase")]
enum ResponseOf {
    Flats,
    Samples,
    Nothing,
}

/// What is the same for all reductions of a series.
pub(super) struct SeriesContext {
    pub(super) viewing: Viewing,
    /// The sample fills the field evenly, so that it can stand in for missing flats.
    pub(super) uniform: bool,
    /// Frame ids in the order of the list.
    pub(super) ids: Vec<i64>,
    /// Places in the list by frame id.
    pub(super) places: HashMap<i64, usize>,
}

impl SeriesContext {
    pub(super) fn new(source: &dyn FrameSource) -> Result<Self, ReductionError> {
        let manifest = source.manifest();
        let viewing = Viewing::of(manifest)?;
        let ids: Vec<i64> = (0..source.rows().len())
            .map(|i| source.frame_id(i))
            .collect();
        Ok(SeriesContext {
            uniform: manifest.sample.layout.is_none() && viewing.is_far() && !source.is_growing(),
            viewing,
            places: ids
                .iter()
                .enumerate()
                .map(|(place, id)| (*id, place))
                .collect(),
            ids,
        })
    }

    /// Keys by which the calibration may be kept: with usable flats, then without.
    pub(super) fn keys(&self, source: &dyn FrameSource, judged: Option<&Judged>) -> [String; 2] {
        let without = match self.uniform {
            true => ResponseOf::Samples,
            false => ResponseOf::Nothing,
        };
        [ResponseOf::Flats, without].map(|of| self.key(source, of, judged))
    }

    /// SHA-256 of everything that a calibration depends on. The samples count where they stand in for missing flats.
    fn key(
        &self,
        source: &dyn FrameSource,
        response: ResponseOf,
        judged: Option<&Judged>,
    ) -> String {
        let manifest = source.manifest();
        let of = |kind: FrameKind| -> Vec<(i64, f64, f64)> {
            let rows = source.rows().iter().zip(&self.ids);
            rows.filter(|(row, _)| row.kind == kind)
                .map(|(row, id)| (*id, row.exposure_s, row.theta_c_deg))
                .collect()
        };
        let inputs = json!({
            "form": FORM,
            "camera": manifest.camera,
            "rig": manifest.rig,
            "flat": manifest.flat,
            "layout": manifest.sample.layout,
            "response": response,
            "darks": of(FrameKind::Dark),
            "flats": of(FrameKind::Flat),
            "samples": match response {
                ResponseOf::Samples => of(FrameKind::Sample),
                ResponseOf::Flats | ResponseOf::Nothing => Vec::new(),
            },
            "judged": judged.map(|j| j.keys().map(|place| self.ids[*place]).collect::<Vec<_>>()),
        });
        let digest = Sha256::digest(inputs.to_string().as_bytes());
        digest.iter().fold(String::new(), |mut text, byte| {
            write!(text, "{byte:02x}").ok();
            text
        })
    }

    pub(super) fn ids_of(&self, rows: &[FrameRow], kind: FrameKind) -> Vec<i64> {
        let rows = rows.iter().zip(&self.ids);
        rows.filter(|(row, _)| row.kind == kind)
            .map(|(_, id)| *id)
            .collect()
    }
}

/// Keys under which the calibration of a series may be stored.
///
/// # Errors
/// [`ReductionError::FieldUnknown`].
pub fn calibration_keys(source: &dyn FrameSource) -> Result<Vec<String>, ReductionError> {
    let series = SeriesContext::new(source)?;
    Ok(series.keys(source, None).to_vec())
}
