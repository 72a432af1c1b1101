//! A series held in memory.

use crate::frame::{Frame, FrameKind};
use crate::reduction::{FrameReadError, FrameSource};
use crate::series::{FrameRow, Manifest};

/// A series in memory; `None` is a frame that cannot be decoded.
#[derive(Debug, Clone)]
pub struct MemorySeries {
    /// Rig, camera, white reference and sample.
    pub manifest: Manifest,
    /// One per frame.
    pub rows: Vec<FrameRow>,
    /// In the order of the rows.
    pub frames: Vec<Option<Frame>>,
}

impl MemorySeries {
    /// A series without frames.
    #[must_use]
    pub fn new(manifest: Manifest) -> Self {
        MemorySeries {
            manifest,
            rows: Vec::new(),
            frames: Vec::new(),
        }
    }

    /// Adds a row; its frame comes with [`MemorySeries::expose`].
    pub fn take(&mut self, kind: FrameKind, theta_c_deg: f64, phi_s_deg: f64, exposure_s: f64) {
        self.rows.push(FrameRow {
            file: format!("frames/{}.png", self.rows.len()),
            kind,
            theta_c_deg,
            phi_s_deg,
            exposure_s,
            repeat: 0,
            timestamp: String::new(),
        });
    }

    /// Replaces all frames; `count` returns the counts of a pixel from the number of the frame, its row and the number of the pixel.
    pub fn expose(&mut self, mut count: impl FnMut(usize, &FrameRow, u32) -> u16) {
        let (width, height) = (
            self.manifest.camera.width_px,
            self.manifest.camera.height_px,
        );
        let rows = self.rows.iter().enumerate();
        let frames = rows.map(|(n, row)| {
            let counts = (0..width * height).map(|pixel| count(n, row, pixel));
            Frame::new(width, height, counts.collect()).ok()
        });
        self.frames = frames.collect();
    }
}

impl FrameSource for MemorySeries {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        self.frames[index]
            .clone()
            .ok_or_else(|| FrameReadError::Store {
                file: self.rows[index].file.clone(),
                source: "half of the file is missing".into(),
            })
    }
}
