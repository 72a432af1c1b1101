//! Recorded series as labs have them: frames of TIFF, bytes the wrong way round, lists from spreadsheets, links.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use sha2::{Digest, Sha256};
use tempfile::TempDir;
use tiff::encoder::{Compression, TiffEncoder, colortype};

use ridged::clock::SteppedClock;
use ridged::frame::{Frame, FrameKind};
use ridged::lab::{ImportOptions, Lab, export};
use ridged::observation::ObservationSet;
use ridged::reduction::{ReductionError, reduce};
use ridged::series::{FrameRow, Manifest, Series};
use ridged::store::PageRequest;
use ridged::store::disk::RealDisk;

const EDGE: usize = 24;
const EXPOSURE_S: f64 = 0.06;

/// The middle of the frames of a recorded series at one exposure and four azimuths.
struct Part {
    manifest: Manifest,
    rows: Vec<FrameRow>,
    frames: Vec<Frame>,
}

impl Part {
    fn new() -> Part {
        let recorded = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
        let series = Series::open(&recorded).unwrap();
        let mut manifest = series.manifest().clone();
        manifest.rig.rotation_axis_px = None;
        manifest.camera.width_px = EDGE as u32;
        manifest.camera.height_px = EDGE as u32;
        let wanted = |row: &FrameRow| {
            let quarter = (row.phi_s_deg / 90.0 - (row.phi_s_deg / 90.0).round()).abs() < 0.01;
            row.exposure_s == EXPOSURE_S && (row.kind != FrameKind::Sample || quarter)
        };
        let (mut rows, mut frames) = (Vec::new(), Vec::new());
        for (index, row) in series.rows().iter().enumerate().filter(|(_, r)| wanted(r)) {
            let whole = series.read(index).unwrap();
            let width = whole.width_px() as usize;
            let (left, top) = ((width - EDGE) / 2, (whole.height_px() as usize - EDGE) / 2);
            let lines = whole.pixels_dn().chunks(width).skip(top).take(EDGE);
            let counts = lines.flat_map(|line| line[left..left + EDGE].to_vec());
            frames.push(Frame::new(EDGE as u32, EDGE as u32, counts.collect()).unwrap());
            rows.push(row.clone());
        }
        assert!(rows.len() > 20, "{}", rows.len());
        Part {
            manifest,
            rows,
            frames,
        }
    }

    /// The same with other counts.
    fn with_counts(mut self, of: impl Fn(u16) -> u16) -> Part {
        for frame in &mut self.frames {
            let counts = frame.pixels_dn().iter().map(|dn| of(*dn)).collect();
            *frame = Frame::new(EDGE as u32, EDGE as u32, counts).unwrap();
        }
        self
    }

    /// A folder with frames as files of an ending.
    fn written(&self, ending: &str, file: impl Fn(&Frame) -> Vec<u8>) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        let mut rows = self.rows.clone();
        for (row, frame) in rows.iter_mut().zip(&self.frames) {
            row.file = row.file.replace("png", ending);
            let path = folder.path().join(&row.file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, file(frame)).unwrap();
        }
        let list = FrameRow::write_all(&rows);
        std::fs::write(folder.path().join("frames.csv"), list).unwrap();
        std::fs::write(folder.path().join("manifest.toml"), self.manifest.to_toml()).unwrap();
        folder
    }
}

fn png(frame: &Frame) -> Vec<u8> {
    frame.to_png().unwrap()
}

fn tiff(frame: &Frame) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    TiffEncoder::new(&mut file)
        .unwrap()
        .with_compression(Compression::Lzw)
        .write_image::<colortype::Gray16>(frame.width_px(), frame.height_px(), frame.pixels_dn())
        .unwrap();
    file.into_inner()
}

fn reduced(folder: &Path) -> Result<ObservationSet, ReductionError> {
    reduce(
        &Series::open(folder).unwrap(),
        None,
        &AtomicBool::new(false),
    )
}

async fn store_in(folder: &Path) -> Lab {
    let clock = Arc::new(SteppedClock::new());
    Lab::open(folder, Arc::new(RealDisk), clock, None)
        .await
        .unwrap()
        .0
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_tiff_are_reduced_kept_and_exported_as_those_of_png() {
    let part = Part::new();
    let (as_png, as_tiff) = (part.written("png", png), part.written("tif", tiff));
    let expected = reduced(as_png.path()).unwrap();
    assert_eq!(reduced(as_tiff.path()).unwrap(), expected);

    let place = tempfile::tempdir().unwrap();
    let lab = store_in(&place.path().join("store")).await;
    let imported = lab
        .import(as_tiff.path(), &ImportOptions::default(), &|_, _| {})
        .await
        .unwrap();
    assert_eq!(imported.n_frames, part.rows.len());
    let page = PageRequest {
        limit: 1000,
        ..PageRequest::default()
    };
    let kept = lab.store().frames_of_scan(imported.scan_id, None, page);
    for (frame, (row, counts)) in kept
        .await
        .unwrap()
        .items
        .iter()
        .zip(part.rows.iter().zip(&part.frames))
    {
        assert_eq!(frame.name, row.file);
        let original: String = Sha256::digest(tiff(counts))
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        assert_eq!(frame.original_sha256.as_deref(), Some(original.as_str()));
        let png = lab.store().read_png(&frame.sha256).unwrap();
        assert_eq!(&Frame::from_png(&png).unwrap(), counts);
    }
    let out = place.path().join("out");
    export(lab.store(), imported.scan_id, &out, Arc::default())
        .await
        .unwrap();
    lab.shut_down().await;
    assert_eq!(reduced(&out).unwrap(), expected);
}

#[test]
fn swapped_bytes_are_named_whatever_the_camera_and_the_file() {
    for bits in [16, 12] {
        let mut part = Part::new();
        // Dark frames of less than 256 counts do not show their byte order.
        let shift = 16 - bits;
        part.manifest.camera.bit_depth = Some(bits);
        part.manifest.camera.saturation_dn = None;
        part.manifest.camera.gain_dn_per_electron /= f64::from(1 << shift);
        part.manifest.camera.black_level_dn = Some(200.0 / f64::from(1 << shift));
        let part = part.with_counts(|dn| dn >> shift);
        assert!(reduced(part.written("png", png).path()).is_ok());
        let part = part.with_counts(u16::swap_bytes);
        for folder in [part.written("png", png), part.written("tif", tiff)] {
            let refused = reduced(folder.path()).unwrap_err();
            assert!(
                matches!(refused, ReductionError::ImpossibleCounts { .. }),
                "{bits} bits: {refused}"
            );
            assert!(
                refused
                    .to_string()
                    .contains("two bytes of each count are swapped")
            );
        }
    }
}

#[test]
fn one_frame_with_swapped_bytes_is_left_out_by_name() {
    let mut part = Part::new();
    let at = part
        .rows
        .iter()
        .rposition(|r| r.kind == FrameKind::Sample)
        .unwrap();
    let swapped = part.frames[at].pixels_dn().iter().map(|dn| dn.swap_bytes());
    part.frames[at] = Frame::new(EDGE as u32, EDGE as u32, swapped.collect()).unwrap();
    let set = reduced(part.written("png", png).path()).unwrap();
    let left_out: Vec<_> = set
        .rejected_frames
        .iter()
        .map(|f| (&f.file, f.reason.as_str()))
        .collect();
    let swapped = (&part.rows[at].file, "bytes swapped");
    assert!(left_out.contains(&swapped), "{left_out:?}");
}

#[test]
fn a_list_from_a_spreadsheet_is_the_same_series() {
    let part = Part::new();
    let folder = part.written("png", png);
    let frames = folder.path().join("frames");
    std::fs::rename(&frames, folder.path().join("Pru\u{308}fling 7")).unwrap();
    let plain = std::fs::read_to_string(folder.path().join("frames.csv")).unwrap();
    let listed = plain
        .replace("frames/", "Pr\u{fc}fling 7\\")
        .replace(",-", ",\u{2212}");
    assert!(listed.contains('\u{2212}'));
    let german = format!(
        "sep=;\r\n{}",
        listed.replace(',', ";").replace("0.06", "0,06")
    );
    let mut wide = vec![0xff, 0xfe];
    wide.extend(german.encode_utf16().flat_map(u16::to_le_bytes));
    for list in [listed.into_bytes(), german.into_bytes(), wide] {
        std::fs::write(folder.path().join("frames.csv"), list).unwrap();
        let series = Series::open(folder.path()).unwrap();
        for (index, frame) in part.frames.iter().enumerate() {
            assert_eq!(&series.read(index).unwrap(), frame);
            assert_eq!(series.rows()[index].pose(), part.rows[index].pose());
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn links_are_followed_in_a_folder_of_the_users_own_alone() {
    let part = Part::new();
    let folder = part.written("png", png);
    let place = tempfile::tempdir().unwrap();
    let elsewhere: PathBuf = place.path().join("disk");
    std::fs::rename(folder.path().join("frames"), &elsewhere).unwrap();
    std::os::unix::fs::symlink(&elsewhere, folder.path().join("frames")).unwrap();
    let own = Series::open_own(folder.path()).unwrap();
    assert_eq!(own.read(0).unwrap(), part.frames[0]);

    let lab = store_in(&place.path().join("store")).await;
    let strangers = ImportOptions::default();
    let refused = lab.import(folder.path(), &strangers, &|_, _| {}).await;
    let said = refused.unwrap_err().to_string();
    assert!(said.contains("a daemon does not follow"), "{said}");
    let own = ImportOptions {
        follow_links: true,
        ..ImportOptions::default()
    };
    let imported = lab.import(folder.path(), &own, &|_, _| {}).await.unwrap();
    assert_eq!(imported.n_frames, part.frames.len());
    lab.shut_down().await;
}
