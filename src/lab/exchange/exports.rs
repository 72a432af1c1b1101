//! Files that other programs read, made of a stored scan: its frames as one TIFF, its observations as BRDF, its fitted surface
//! as a material.

use std::sync::Arc;

use serde_json::{Value, json};

use crate::fit::FitReport;
use crate::fit::fitted_surface::{NoSurface, fitted_surface};
use crate::frame::tiff_stack::TiffStack;
use crate::frame::{Frame, FrameKind};
use crate::lab::jobs::chosen_fit::{ReportChoice, chosen};
use crate::lab::tasks::for_a_download;
use crate::lab::{Lab, LabError, StoredSeries};
use crate::observation::ObservationSet;
use crate::reduction::FrameSource;
use crate::series::FrameRow;
use crate::store::scans::Scan;
use crate::store::{Store, utc_of, utc_text};
use crate::tables::bird_out::{self, BirdFacts};
use crate::tables::rgl_out;
use crate::version::BUILD;

/// The frames of a scan as one TIFF, page by page.
#[derive(Debug, Clone)]
pub struct FrameStack {
    series: StoredSeries,
    layout: TiffStack,
}

impl FrameStack {
    /// Lays out the stack of a scan, calibrations included, in the order of its list of frames.
    ///
    /// # Errors
    /// An unknown scan, a scan without frames, or a store error.
    pub async fn open(store: &Store, scan_id: i64) -> Result<FrameStack, LabError> {
        let series = StoredSeries::open(store, scan_id).await?;
        if series.rows().is_empty() {
            return Err(not_for_this(scan_id, "it has no frames"));
        }
        let describe = |row: &FrameRow| {
            json!({
                "file": row.file, "kind": row.kind, "theta_c_deg": row.theta_c_deg, "phi_s_deg": row.phi_s_deg,
                "exposure_s": row.exposure_s, "repeat": row.repeat, "timestamp": row.timestamp,
            })
            .to_string()
        };
        let descriptions: Vec<String> = series.rows().iter().map(describe).collect();
        let camera = &series.manifest().camera;
        let layout = TiffStack::new(camera.width_px, camera.height_px, &descriptions);
        Ok(FrameStack { series, layout })
    }

    /// Size of the file.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.layout.bytes()
    }

    /// Number of pages.
    #[must_use]
    pub fn n_pages(&self) -> usize {
        self.layout.n_pages()
    }

    /// Returns the bytes before the first page.
    #[must_use]
    pub fn header(&self) -> Vec<u8> {
        self.layout.header()
    }

    /// As [`page`](Self::page), for a download.
    ///
    /// # Errors
    /// As there.
    pub async fn page_to_send(self: Arc<Self>, index: usize) -> Result<Vec<u8>, LabError> {
        for_a_download(move || self.page(index)).await?
    }

    /// Reads a frame and returns the bytes of its page. Blocks on the disk.
    ///
    /// # Errors
    /// A damaged frame, or one of another size than the camera's.
    pub fn page(&self, index: usize) -> Result<Vec<u8>, LabError> {
        let frame = self.series.read(index);
        let frame = frame.map_err(|reason| LabError::Frame { reason })?;
        let page = self.layout.page(index, &frame);
        page.ok_or_else(|| of_other_size(&self.series.rows()[index], &frame))
    }
}

/// Returns the observations of a scan as a BiRD file.
///
/// # Errors
/// [`LabError::Invalid`] for observations that are not a BRDF.
pub fn bird_file(
    scan: &Scan,
    series: &StoredSeries,
    set: &ObservationSet,
) -> Result<Value, LabError> {
    let facts = BirdFacts {
        id: format!("urn:ridged:scan:{}:{}", scan.id, scan.created_at),
        timestamp: measured_between(scan, series.rows()).0,
        sample: scan.sample_name.clone(),
        wavelength_nm: series.manifest().rig.wavelength_nm,
        operator_name: scan.operator_name.clone(),
        program: BUILD.to_owned(),
    };
    bird_out::file(set, &facts).map_err(|error| not_for_this(scan.id, &error.to_string()))
}

/// Returns start and end of the measurement of a scan. An imported series was measured when its frames were taken; if they
/// state no time, only that of the import is known.
pub(in crate::lab) fn measured_between(scan: &Scan, rows: &[FrameRow]) -> (String, Option<String>) {
    let of_frames = match scan.plan {
        Some(_) => None,
        None => taken_between(rows),
    };
    match of_frames {
        Some((first, last)) => (first, Some(last)),
        None => {
            let start = scan.started_at.as_ref().unwrap_or(&scan.created_at);
            (start.clone(), scan.ended_at().map(str::to_owned))
        }
    }
}

/// Returns the earliest and the latest time, UTC, of the frames of the part; `None` if they state none. Dark frames and white
/// reference may be much older.
fn taken_between(rows: &[FrameRow]) -> Option<(String, String)> {
    let of_part = rows.iter().filter(|row| row.kind == FrameKind::Sample);
    let times = of_part.filter_map(|row| utc_of(&row.timestamp));
    let (first, last) = (times.clone().min()?, times.max()?);
    Some((utc_text(first), utc_text(last)))
}

/// Wavelength in a file of a scan whose rig states none; the file has one value for all wavelengths.
const WAVELENGTH_NM: f64 = 550.0;

/// The fitted surface of a scan as a file that renderers read.
#[derive(Debug, Clone)]
pub struct SurfaceFile {
    /// Number of the fit.
    pub fit_id: i64,
    /// The file.
    pub bytes: Vec<u8>,
}

/// Returns the fitted surface of a scan as a measured material of the RGL database.
///
/// # Errors
/// An unknown scan or fit, [`LabError::NoReport`] without a completed fit, [`LabError::Invalid`] for a fit that does not
/// determine a surface, or a store error.
pub async fn surface_file(
    store: &Store,
    scan_id: i64,
    choice: &ReportChoice,
) -> Result<SurfaceFile, LabError> {
    let scan = store.scan(scan_id).await?;
    let (job, report, set_id) = chosen(store, &scan, choice).await?;
    let set = store.observations(set_id).await?;
    let manifest = StoredSeries::open(store, scan_id).await?.manifest().clone();
    let fit = job.number;
    let brdf = fitted_surface(&report, &set).map_err(|error| match error {
        NoSurface::NoResult => LabError::NoReport {
            scan_id,
            why: format!("fit {fit}: {error}"),
        },
        NoSurface::Undetermined { .. } | NoSurface::OutOfDomain(_) => LabError::Invalid {
            field: format!("fit {fit}"),
            problem: error.to_string(),
        },
    })?;
    let wavelength_nm = manifest.rig.wavelength_nm;
    let description = described(&scan, job.number, &report, wavelength_nm);
    let wavelength_nm = wavelength_nm.unwrap_or(WAVELENGTH_NM);
    let bytes = for_a_download(move || rgl_out::file(&brdf, wavelength_nm, &description)).await?;
    Ok(SurfaceFile { fit_id: fit, bytes })
}

/// Describes a file of a surface in one line.
fn described(scan: &Scan, fit_id: i64, report: &FitReport, wavelength_nm: Option<f64>) -> String {
    let value = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.4}"));
    let p = &report.parameters;
    let region = report.region.as_ref();
    let region = region.map_or_else(String::new, |region| format!(", region {region}"));
    let wavelength = match wavelength_nm {
        Some(nm) => format!("{nm} nm"),
        None => format!("wavelength not stated, {WAVELENGTH_NM} nm in the file"),
    };
    format!(
        "{}{region}: scan {}, fit {fit_id} ({}) by {BUILD}; theta_r {} deg, U {} deg (k = {}), alpha_u {}, alpha_v {}, rho_d {}; \
         {wavelength}; x along the ridges, y the direction in which the facets lean",
        scan.sample_name,
        scan.id,
        report.variant,
        value(p.theta_r_deg.value),
        value(p.theta_r_deg.expanded),
        p.theta_r_deg
            .coverage_factor
            .map_or_else(String::new, |k| format!("{k:.2}")),
        value(p.alpha_u.value),
        value(p.alpha_v.value),
        value(p.rho_d.value),
    )
}

/// The error for a frame of another size than the camera's.
pub(in crate::lab) fn of_other_size(row: &FrameRow, frame: &Frame) -> LabError {
    LabError::Export(format!(
        "{} has {} × {} pixels, and the camera of the scan has others; this file has frames of one size, so export the scan as \
         a series",
        row.file,
        frame.width_px(),
        frame.height_px()
    ))
}

/// The error for a scan that cannot have this form.
pub(in crate::lab) fn not_for_this(scan_id: i64, problem: &str) -> LabError {
    LabError::Invalid {
        field: format!("scan {scan_id}"),
        problem: problem.to_owned(),
    }
}

impl Lab {
    /// Returns the observations of a scan or of one of its regions as a BiRD file.
    ///
    /// # Errors
    /// As [`Lab::observations`] and [`bird_file`].
    pub async fn bird_file(&self, scan_id: i64, region: Option<&str>) -> Result<Value, LabError> {
        let reduced = self.observations(scan_id, region).await?;
        let scan = self.store().scan(scan_id).await?;
        let series = StoredSeries::open(self.store(), scan_id).await?;
        bird_file(&scan, &series, &reduced.set)
    }

    /// Returns the fitted surface of a scan as a measured material of the RGL database.
    ///
    /// # Errors
    /// As [`surface_file`].
    pub async fn surface_file(
        &self,
        scan_id: i64,
        choice: &ReportChoice,
    ) -> Result<SurfaceFile, LabError> {
        surface_file(self.store(), scan_id, choice).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_was_measured_when_the_frames_of_its_part_were_taken() {
        let list = |times: [&str; 3]| {
            let [flat, second, first] = times;
            let text = format!(
                "file,kind,theta_c_deg,phi_s_deg,exposure_s,timestamp\na.png,flat,0,0,1,{flat}\n\
                 b.png,sample,0,0,1,{second}\nc.png,sample,0,90,1,{first}\n"
            );
            FrameRow::read_all(&text, "frames.csv").unwrap()
        };
        let rows = list([
            "2025-01-01T00:00:00Z",
            "2026-03-02T11:00:00+01:00",
            "2026-03-02T09:00:00Z",
        ]);
        let expected = ("2026-03-02T09:00:00.000Z", "2026-03-02T10:00:00.000Z");
        let (first, last) = taken_between(&rows).unwrap();
        assert_eq!((first.as_str(), last.as_str()), expected);
        assert_eq!(taken_between(&list(["2025-01-01T00:00:00Z", "", ""])), None);
    }
}
