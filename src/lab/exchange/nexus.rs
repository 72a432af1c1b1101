//! A scan as a NeXus file: HDF5 with the groups, names and units of the NeXus standard.
//!
//! ```text
//! entry (NXentry)
//!   instrument (NXinstrument): detector (all frames), camera_tilt and sample_rotation (their poses), beam, geometry
//!   sample (NXsample), user (NXuser)
//!   frames (NXdata): the frames over their number, with poses
//!   observations (NXdata): reduced signals with their uncertainty
//!   fit (NXprocess): parameters with uncertainty, covariance, and the report as JSON
//! ```
//!
//! A sample with several regions has observations and a fit for each, with the name of the region behind an underscore.
//! Frames are read, compressed and written one by one.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use rust_hdf5::{Hdf5Error, VarLenUnicode};

use super::exports::{measured_between, not_for_this, of_other_size};
use super::hdf5_group::Group;
use crate::fit::FitReport;
use crate::fit::report::ParameterCovariance;
use crate::frame::FrameKind;
use crate::lab::jobs::chosen_fit::{ReportChoice, chosen};
use crate::lab::{Lab, LabError, StoredSeries};
use crate::observation::{Observation, ObservationSet};
use crate::reduction::{self, FrameSource};
use crate::series::FrameRow;
use crate::store::Store;
use crate::store::scans::Scan;
use crate::version::BUILD;

/// Compression level of the frames; higher ones gain little on the noise of a camera.
const DEFLATE: u32 = 4;
/// Place of the frames in the file.
const FRAMES: &str = "/entry/instrument/detector/data";

/// A scan with its fits, ready to be written.
#[derive(Debug, Clone)]
pub struct NexusFile {
    scan: Scan,
    series: StoredSeries,
    parts: Vec<Part>,
}

/// A region of the sample, or all of it.
#[derive(Debug, Clone)]
struct Part {
    region: Option<String>,
    /// The newest completed fit.
    fit: Option<StoredFit>,
}

#[derive(Debug, Clone)]
struct StoredFit {
    number: i64,
    ended_at: Option<String>,
    report: FitReport,
    set: ObservationSet,
}

/// Why a file is not written.
enum Unwritten {
    File(Hdf5Error),
    Lab(LabError),
}

impl From<Hdf5Error> for Unwritten {
    fn from(error: Hdf5Error) -> Self {
        Unwritten::File(error)
    }
}

impl From<LabError> for Unwritten {
    fn from(error: LabError) -> Self {
        Unwritten::Lab(error)
    }
}

impl Part {
    /// Returns a name with the region behind it.
    fn name(&self, of: &str) -> String {
        match &self.region {
            Some(region) => format!("{of}_{region}"),
            None => of.to_owned(),
        }
    }
}

impl NexusFile {
    /// Collects a scan with the newest completed fit of each region.
    ///
    /// # Errors
    /// An unknown scan, a scan without frames, or a store error.
    pub async fn open(store: &Store, scan_id: i64) -> Result<NexusFile, LabError> {
        let scan = store.scan(scan_id).await?;
        let series = StoredSeries::open(store, scan_id).await?;
        if series.rows().is_empty() {
            return Err(not_for_this(scan_id, "it has no frames"));
        }
        let mut regions: Vec<Option<String>> = Lab::regions(series.manifest())
            .into_iter()
            .map(Some)
            .collect();
        if regions.is_empty() {
            regions.push(None);
        }
        let mut parts = Vec::with_capacity(regions.len());
        for region in regions {
            let choice = ReportChoice {
                fit_id: None,
                region: region.clone(),
            };
            let fit = match chosen(store, &scan, &choice).await {
                Ok((job, report, set_id)) => Some(StoredFit {
                    number: job.number,
                    ended_at: job.ended_at,
                    report,
                    set: store.observations(set_id).await?,
                }),
                Err(LabError::NoReport { .. }) => None,
                Err(error) => return Err(error),
            };
            parts.push(Part { region, fit });
        }
        Ok(NexusFile {
            scan,
            series,
            parts,
        })
    }

    /// Number of frames.
    #[must_use]
    pub fn n_frames(&self) -> usize {
        self.series.rows().len()
    }

    /// Size of its frames before compression, an upper limit of the size of the file.
    #[must_use]
    pub fn bytes_max(&self) -> u64 {
        let camera = &self.series.manifest().camera;
        2 * u64::from(camera.width_px) * u64::from(camera.height_px) * self.n_frames() as u64
    }

    /// Writes a new file and calls `created` as soon as it exists. Blocks on the disk; memory holds one frame at a time.
    ///
    /// # Errors
    /// A damaged frame, one of another size than the camera's, a file that cannot be written, or [`LabError::BrokenOff`].
    pub fn write(
        &self,
        path: &Path,
        created: impl FnOnce() -> std::io::Result<()>,
        cancel: &AtomicBool,
    ) -> Result<(), LabError> {
        let written = self.write_file(path, created, cancel);
        written.map_err(|reason| match reason {
            Unwritten::Lab(error) => error,
            Unwritten::File(error) => LabError::Export(format!(
                "the NeXus file cannot be written: {error}; free some space in {} and try again",
                path.parent().unwrap_or(path).display()
            )),
        })
    }

    fn write_file(
        &self,
        path: &Path,
        created: impl FnOnce() -> std::io::Result<()>,
        cancel: &AtomicBool,
    ) -> Result<(), Unwritten> {
        let file = rust_hdf5::H5File::create(path)?;
        created().map_err(Hdf5Error::from)?;
        let root = Group::root(&file);
        root.attribute("NX_class", "NXroot")?;
        root.attribute("creator", BUILD)?;
        root.attribute("default", "entry")?;
        let entry = root.group("entry", "NXentry")?;
        self.write_facts(&entry)?;
        let instrument = entry.group("instrument", "NXinstrument")?;
        self.write_instrument(&instrument)?;
        let data = entry.group("frames", "NXdata")?;
        self.write_poses(&instrument, &data)?;
        let mut shown = "frames".to_owned();
        for part in &self.parts {
            if let Some(name) = self.write_part(&entry, part, cancel)?
                && shown == "frames"
            {
                shown = name;
            }
        }
        entry.attribute("default", &shown)?;
        self.write_frames(&instrument, cancel)?;
        file.close()?;
        Ok(())
    }

    fn write_facts(&self, entry: &Group) -> Result<(), Hdf5Error> {
        let scan = &self.scan;
        entry.text(
            "title",
            &format!("Scan {} of {}", scan.id, scan.sample_name),
        )?;
        entry.text("entry_identifier", &scan.id.to_string())?;
        let (start, end) = measured_between(scan, self.series.rows());
        entry.text("start_time", &start)?;
        if let Some(end) = end {
            entry.text("end_time", &end)?;
        }
        entry.text("program_name", BUILD)?;
        let user = entry.group("user", "NXuser")?;
        user.text("name", scan.operator_name.as_ref().unwrap_or(&scan.who))?;
        let sample = entry.group("sample", "NXsample")?;
        sample.text("name", &scan.sample_name)?;
        let (eta, k) = self.series.manifest().material().index();
        sample.number("refractive_index", eta, "1")?;
        sample.number("extinction_coefficient", k, "1")?;
        sample.link("rotation_angle", "/entry/instrument/sample_rotation/value")
    }

    /// Writes rig and camera as the manifest states them.
    fn write_instrument(&self, instrument: &Group) -> Result<(), Hdf5Error> {
        let manifest = self.series.manifest();
        let rig = &manifest.rig;
        instrument.text("name", "gonioreflectometer")?;
        if let Some(nm) = rig.wavelength_nm {
            let beam = instrument.group("beam", "NXbeam")?;
            beam.number("incident_wavelength", nm, "nm")?;
        }
        let geometry = instrument.group("geometry", "NXcollection")?;
        for (name, value) in [
            ("lamp_to_camera_angle", Some(rig.theta_l_deg)),
            ("lamp_azimuth", Some(rig.light_azimuth_deg)),
            ("azimuth_zero", Some(rig.azimuth_zero_deg)),
            ("lamp_angular_radius", rig.light_angular_radius_deg),
            ("lens_angular_radius", rig.lens_angular_radius_deg),
        ] {
            if let Some(value) = value {
                geometry.number(name, value, "deg")?;
            }
        }
        let white = manifest.flat.as_ref();
        if let Some(reflectance) = white.and_then(|flat| flat.reflectance) {
            let group = instrument.group("white_reference", "NXcollection")?;
            group.number("reflectance", reflectance, "1")?;
            if let Some(std) = white.and_then(|flat| flat.reflectance_std) {
                group.number("reflectance_errors", std, "1")?;
            }
        }
        Ok(())
    }

    /// Writes what is known of each frame, and the links that plot the frames.
    fn write_poses(&self, instrument: &Group, data: &Group) -> Result<(), Hdf5Error> {
        let rows = self.series.rows();
        let of = |value: fn(&FrameRow) -> f64| rows.iter().map(value).collect::<Vec<f64>>();
        for (name, what, values) in [
            (
                "camera_tilt",
                "camera tilt θc as read back",
                of(|row| row.theta_c_deg),
            ),
            (
                "sample_rotation",
                "sample azimuth φs as read back",
                of(|row| row.phi_s_deg),
            ),
        ] {
            let axis = instrument.group(name, "NXpositioner")?;
            axis.text("name", name)?;
            axis.text("description", what)?;
            axis.numbers("value", &values, "deg")?;
            data.link(name, &format!("/entry/instrument/{name}/value"))?;
            data.number_attribute(&format!("{name}_indices"), 0)?;
        }
        let detector = instrument.group("detector", "NXdetector")?;
        let manifest = self.series.manifest();
        let keys: Vec<u8> = rows.iter().map(|row| image_key(row.kind)).collect();
        detector.numbers("image_key", &keys, "")?;
        detector.numbers("count_time", &of(|row| row.exposure_s), "s")?;
        let repeats: Vec<u32> = rows.iter().map(|row| row.repeat).collect();
        detector.numbers("repeat", &repeats, "")?;
        let texts = |of: fn(&FrameRow) -> &str| rows.iter().map(of).collect::<Vec<&str>>();
        detector.texts("file_name", &texts(|row| &row.file))?;
        detector.texts("time_stamp", &texts(|row| &row.timestamp))?;
        detector.number(
            "gain",
            manifest.camera.gain_dn_per_electron,
            "count/electron",
        )?;
        let numbers: Vec<u32> = (0..rows.len() as u32).collect();
        data.numbers("frame", &numbers, "")?;
        data.link("data", FRAMES)?;
        data.link("image_key", "/entry/instrument/detector/image_key")?;
        data.number_attribute("image_key_indices", 0)?;
        data.attribute("signal", "data")?;
        data.list_attribute("axes", &["frame", ".", "."])
    }

    /// Writes the frames, a chunk each.
    fn write_frames(&self, instrument: &Group, cancel: &AtomicBool) -> Result<(), Unwritten> {
        let camera = &self.series.manifest().camera;
        let (width, height) = (camera.width_px as usize, camera.height_px as usize);
        let detector = instrument.existing("detector")?;
        let data = detector
            .dataset::<u16>()
            .shape([self.n_frames(), height, width])
            .chunk(&[1, height, width])
            .shuffle_deflate(DEFLATE)
            .create("data")?;
        data.new_attr::<VarLenUnicode>()
            .shape(())
            .create("units")?
            .write_string("count")?;
        for (index, row) in self.series.rows().iter().enumerate() {
            if cancel.load(Ordering::Relaxed) {
                return Err(LabError::BrokenOff.into());
            }
            let frame = self.series.read(index);
            let frame = frame.map_err(|reason| LabError::Frame { reason })?;
            if (frame.width_px(), frame.height_px()) != (camera.width_px, camera.height_px) {
                return Err(of_other_size(row, &frame).into());
            }
            let bytes: Vec<u8> = frame
                .pixels_dn()
                .iter()
                .flat_map(|dn| dn.to_le_bytes())
                .collect();
            data.write_chunk(index, &bytes)?;
        }
        Ok(())
    }

    /// Writes observations and fit of a region; returns the name of the observations' group. Frames that give no observations,
    /// as those of a scan that was aborted, have none.
    fn write_part(
        &self,
        entry: &Group,
        part: &Part,
        cancel: &AtomicBool,
    ) -> Result<Option<String>, Unwritten> {
        let reduced;
        let set = match &part.fit {
            Some(fit) => &fit.set,
            None => match reduction::reduce(&self.series, part.region.as_deref(), cancel) {
                Ok(set) => {
                    reduced = set;
                    &reduced
                }
                Err(_) if cancel.load(Ordering::Relaxed) => return Err(LabError::BrokenOff.into()),
                Err(_) => return Ok(None),
            },
        };
        let name = part.name("observations");
        let group = entry.group(&name, "NXdata")?;
        write_observations(&group, set)?;
        if let Some(fit) = &part.fit {
            let group = entry.group(&part.name("fit"), "NXprocess")?;
            write_fit(&group, fit)?;
        }
        Ok(Some(name))
    }
}

/// What a frame shows, as NXtomo has it.
fn image_key(kind: FrameKind) -> u8 {
    match kind {
        FrameKind::Sample => 0,
        FrameKind::Flat => 1,
        FrameKind::Dark => 2,
    }
}

fn write_observations(group: &Group, set: &ObservationSet) -> Result<(), Hdf5Error> {
    let radiance = radiance_unit(set);
    let of = |value: fn(&Observation) -> f64| -> Vec<f64> {
        set.observations.iter().map(value).collect()
    };
    let numbers: Vec<u32> = (0..set.observations.len() as u32).collect();
    group.numbers("observation", &numbers, "")?;
    for (name, unit, values) in [
        ("signal", radiance, of(|o| o.signal)),
        ("signal_errors", radiance, of(|o| o.sigma)),
        (
            "camera_tilt",
            "deg",
            of(|o| o.pose.theta_c.deg_for_tables()),
        ),
        (
            "sample_rotation",
            "deg",
            of(|o| o.pose.phi_s.deg_for_tables()),
        ),
        (
            "white_reference_errors",
            radiance,
            of(|o| o.shared.white_reference),
        ),
        ("lamp_drift_errors", radiance, of(|o| o.shared.led_drift)),
        ("camera_curve_errors", radiance, of(|o| o.shared.detector)),
        ("n_frames", "", of(|o| f64::from(o.n_frames))),
    ] {
        group.numbers(name, &values, unit)?;
    }
    group.text("title", "Radiance for an irradiance of 1 on a surface that faces the lamp; errors are standard uncertainties (k = 1)")?;
    group.attribute("signal", "signal")?;
    group.list_attribute("axes", &["observation"])?;
    group.number_attribute("camera_tilt_indices", 0)?;
    group.number_attribute("sample_rotation_indices", 0)
}

/// The unit of signals.
fn radiance_unit(set: &ObservationSet) -> &'static str {
    match set.white_reference {
        Some(_) => "1/sr",
        None => "arbitrary",
    }
}

fn write_fit(group: &Group, fit: &StoredFit) -> Result<(), Unwritten> {
    let report = &fit.report;
    group.text("program", &report.program)?;
    group.text("fit_identifier", &fit.number.to_string())?;
    if let Some(ended_at) = &fit.ended_at {
        group.text("date", ended_at)?;
    }
    group.text("variant", &report.variant.to_string())?;
    let parameters = group.group("parameters", "NXparameters")?;
    for (name, parameter) in report.parameters.named() {
        let Some(value) = parameter.value else {
            continue;
        };
        let unit = match name {
            "background" => radiance_unit(&fit.set),
            name if name.ends_with("_deg") => "deg",
            _ => "1",
        };
        let place = parameters.number(name, value, unit)?;
        for (word, known) in [
            ("standard_uncertainty", parameter.std),
            ("expanded_uncertainty", parameter.expanded),
            ("coverage_factor", parameter.coverage_factor),
        ] {
            if let Some(known) = known {
                place
                    .new_attr::<f64>()
                    .shape(())
                    .create(word)?
                    .write_numeric(&known)?;
            }
        }
    }
    if let Some(covariance) = &report.covariance {
        write_covariance(group, covariance)?;
    }
    let note = group.group("report", "NXnote")?;
    note.text("type", "application/json")?;
    let json = serde_json::to_string(report).map_err(|error| {
        LabError::Export(format!(
            "the report of fit {} has no JSON: {error}",
            fit.number
        ))
    })?;
    note.text("data", &json)?;
    Ok(())
}

fn write_covariance(group: &Group, covariance: &ParameterCovariance) -> Result<(), Hdf5Error> {
    let n = covariance.parameters.len();
    let values: Vec<f64> = covariance.values.iter().flatten().copied().collect();
    let data = group.group("covariance", "NXcollection")?;
    for (name, texts) in [
        ("parameters", &covariance.parameters),
        ("units", &covariance.units),
    ] {
        let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
        data.texts(name, &texts)?;
    }
    data.dataset::<f64>()
        .shape([n, n])
        .create("values")?
        .write_raw(&values)
}
