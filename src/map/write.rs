//! A map as files: a float32 TIFF and a PNG for each quantity and its standard uncertainty, the flags, and the table of
//! defects.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use tiff::TiffError;
use tiff::encoder::colortype::{self, ColorType};
use tiff::encoder::{Compression, TiffEncoder, TiffValue};
use tiff::tags::Tag;

use super::Map;
use super::defects::Defect;
use super::layers;
use super::picture::{self, Picture, Scale, Sheet};
use crate::colour::Rgb;

/// The reason why files could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The operating system returned an error.
    #[error(
        "cannot write {file}: {source}; check the folder's permissions and the free space on its disk"
    )]
    File {
        /// The file.
        file: String,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The encoder returned an error.
    #[error("cannot encode {file}: {cause}")]
    Encoding {
        /// The file.
        file: String,
        /// The encoder's error.
        cause: String,
    },
    /// The cancel flag was raised; all files of the map are deleted, and an older map is unchanged.
    #[error("the map was cancelled while its files were written")]
    Cancelled,
}

/// The content of one file.
enum Sheetful<'a> {
    Tiff(&'a [f32]),
    Png(Box<dyn Fn() -> Picture + Sync + Send + 'a>),
}

/// Writes all files of a map except its summary into `folder`, which is created if missing, as drafts. Checks `cancel`
/// between two files; if cancelled, no draft remains.
///
/// # Errors
/// [`WriteError`] names the file.
pub fn write<'f>(
    map: &Map,
    folder: &'f Path,
    cancel: &AtomicBool,
) -> Result<Drafts<'f>, WriteError> {
    std::fs::create_dir_all(folder).map_err(|source| WriteError::File {
        file: folder.display().to_string(),
        source,
    })?;
    let drafts = Drafts {
        folder,
        files: Mutex::default(),
    };
    write_all(map, &drafts, cancel)?;
    Ok(drafts)
}

/// Files under temporary names, so that an incomplete map is not mistaken for a complete one, and an older map stays
/// intact until the new one is complete. Drafts that are not kept are deleted.
pub struct Drafts<'f> {
    folder: &'f Path,
    /// Final names, in the order in which the files were started.
    files: Mutex<Vec<String>>,
}

impl Drafts<'_> {
    /// Lets `make` write one file completely, unless cancelled.
    pub(super) fn file(
        &self,
        name: &str,
        cancel: &AtomicBool,
        make: impl FnOnce(&Path) -> Result<(), WriteError>,
    ) -> Result<(), WriteError> {
        if cancel.load(Ordering::Relaxed) {
            return Err(WriteError::Cancelled);
        }
        let mut files = self.files.lock().expect("no holder of this lock panics");
        files.push(name.to_owned());
        drop(files);
        make(&self.draft(name))
    }

    /// Returns the names of the files, in alphabetical order.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let files = self.files.lock().expect("no holder of this lock panics");
        let mut names = files.clone();
        names.sort_unstable();
        names
    }

    /// Renames all files to their final names, `last` at the end: if it exists, so do the others.
    ///
    /// # Errors
    /// [`WriteError`] names the file; the drafts after it are deleted.
    pub(super) fn keep(self, last: &str) -> Result<(), WriteError> {
        // `last` of an older map must not exist beside files of the new one.
        std::fs::remove_file(self.folder.join(last)).ok();
        let others = self.names().into_iter().filter(|name| name != last);
        for name in others.chain([last.to_owned()]) {
            let path = self.folder.join(&name);
            std::fs::rename(self.draft(&name), &path).map_err(failed(&path))?;
        }
        Ok(())
    }

    fn draft(&self, name: &str) -> PathBuf {
        let of_this_run = std::process::id();
        self.folder.join(format!(".{name}.{of_this_run}.part"))
    }
}

impl Drop for Drafts<'_> {
    fn drop(&mut self) {
        for name in self.names() {
            // Best effort: a draft that cannot be removed is not reported. Kept files are no longer drafts.
            std::fs::remove_file(self.draft(&name)).ok();
        }
    }
}

fn write_all(map: &Map, drafts: &Drafts<'_>, cancel: &AtomicBool) -> Result<(), WriteError> {
    let layers = &map.layers;
    let sheet = Sheet {
        width: layers.width,
        height: layers.height,
        column_mm: map.pixel_mm.map(|p| p[0]),
        aspect: map.pixel_mm.map_or(1.0, |p| p[1] / p[0]),
    };
    let mut sheets: Vec<(String, Sheetful<'_>)> = Vec::new();
    for layer in &layers.parameters {
        sheets.push((format!("{}.tif", layer.name), Sheetful::Tiff(&layer.values)));
        sheets.push((
            format!("{}_std.tif", layer.name),
            Sheetful::Tiff(&layer.std),
        ));
        let cyclic = layer.cyclic;
        sheets.push((
            format!("{}.png", layer.name),
            Sheetful::Png(Box::new(move || {
                let scale = Scale::of(&layer.values);
                let scale = if cyclic {
                    scale.map(|_| Scale::Directions)
                } else {
                    scale
                };
                picture::layer(&sheet, &layer.values, scale, layer.title, layer.unit)
            })),
        ));
        sheets.push((
            format!("{}_std.png", layer.name),
            Sheetful::Png(Box::new(move || {
                let title = format!("{}, standard uncertainty of a pixel", layer.title);
                let scale = Scale::of(&layer.std);
                picture::layer(&sheet, &layer.std, scale, &title, layer.unit)
            })),
        ));
    }
    sheets.push((
        "chi2_reduced.tif".to_owned(),
        Sheetful::Tiff(&layers.chi2_reduced),
    ));
    sheets.push((
        "chi2_reduced.png".to_owned(),
        Sheetful::Png(Box::new(move || {
            let scale = Scale::of(&layers.chi2_reduced);
            picture::layer(
                &sheet,
                &layers.chi2_reduced,
                scale,
                "χ² per degree of freedom",
                "",
            )
        })),
    ));
    sheets.push((
        "flags.png".to_owned(),
        Sheetful::Png(Box::new(move || flags_picture(map, &sheet))),
    ));
    sheets.par_iter().try_for_each(|(name, content)| {
        drafts.file(name, cancel, |path| match content {
            Sheetful::Tiff(values) => write_tiff(path, values, layers.width, layers.height),
            Sheetful::Png(draw) => write_png(path, &draw()),
        })
    })?;
    drafts.file("flags.tif", cancel, |path| write_flags(path, map))?;
    drafts.file("defects.csv", cancel, |path| {
        write_defects(path, &map.defects)
    })
}

/// Measures the seconds that one thread takes to draw and compress a sheet of a series' size, on a smooth field with
/// noise. Used for a forecast. `None` if it cannot be encoded.
#[must_use]
pub fn seconds_of_a_sheet(manifest: &crate::series::Manifest) -> Option<f64> {
    let camera = &manifest.camera;
    let (width, height) = (camera.width_px as usize, camera.height_px as usize);
    let sheet = Sheet {
        width,
        height,
        column_mm: None,
        aspect: 1.0,
    };
    let values: Vec<f32> = (0..width * height)
        .map(|n| (n as f32 * 1.7).sin() + (n / width) as f32 / height as f32)
        .collect();
    let started = std::time::Instant::now();
    let picture = picture::layer(&sheet, &values, Scale::of(&values), "forecast", "");
    encode_png(io::sink(), &picture).ok()?;
    Some(started.elapsed().as_secs_f64())
}

fn failed(path: &Path) -> impl Fn(io::Error) -> WriteError + '_ {
    |source| WriteError::File {
        file: path.display().to_string(),
        source,
    }
}

fn unencodable(path: &Path, cause: &dyn std::fmt::Display) -> WriteError {
    WriteError::Encoding {
        file: path.display().to_string(),
        cause: cause.to_string(),
    }
}

/// Lets `encode` write into the file at `path`, and flushes the last bytes: a dropped buffer would discard the error
/// of the disk.
fn write_whole<W: Write, E: std::fmt::Display>(
    path: &Path,
    file: W,
    encode: impl FnOnce(&mut BufWriter<W>) -> Result<(), E>,
) -> Result<(), WriteError> {
    let mut buffer = BufWriter::new(file);
    encode(&mut buffer).map_err(|e| unencodable(path, &e))?;
    buffer.flush().map_err(failed(path))
}

fn create(path: &Path) -> Result<File, WriteError> {
    File::create(path).map_err(failed(path))
}

fn write_tiff(path: &Path, values: &[f32], width: usize, height: usize) -> Result<(), WriteError> {
    write_whole(path, create(path)?, |file| {
        encode_tiff::<colortype::Gray32Float>(file, values, width, height, None)
    })
}

fn write_flags(path: &Path, map: &Map) -> Result<(), WriteError> {
    let layers = &map.layers;
    let bits: Vec<String> = layers::flag_bits()
        .map(|(name, bit)| format!("{bit} {name}"))
        .collect();
    let meaning = format!("sum of: {}", bits.join(", "));
    write_whole(path, create(path)?, |file| {
        let (width, height) = (layers.width, layers.height);
        encode_tiff::<colortype::Gray8>(file, &layers.flags, width, height, Some(&meaning))
    })
}

fn encode_tiff<C: ColorType>(
    into: impl Write + io::Seek,
    values: &[C::Inner],
    width: usize,
    height: usize,
    description: Option<&str>,
) -> Result<(), TiffError>
where
    [C::Inner]: TiffValue,
{
    let mut encoder =
        TiffEncoder::new(into)?.with_compression(Compression::Deflate(Default::default()));
    let mut image = encoder.new_image::<C>(width as u32, height as u32)?;
    if let Some(text) = description {
        image.encoder().write_tag(Tag::ImageDescription, text)?;
    }
    image.write_data(values)
}

fn write_png(path: &Path, picture: &Picture) -> Result<(), WriteError> {
    write_whole(path, create(path)?, |file| encode_png(file, picture))
}

fn encode_png(into: impl Write, picture: &Picture) -> Result<(), png::EncodingError> {
    let mut encoder = png::Encoder::new(into, picture.width as u32, picture.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&picture.rgb)?;
    writer.finish()
}

/// The classes of `flags.png`; the first one that holds is drawn.
const CLASSES: [(&str, Rgb, u8); 8] = [
    (
        "too few observations",
        [150, 150, 150],
        layers::FEW_OBSERVATIONS,
    ),
    (
        "not identifiable",
        [222, 222, 222],
        layers::NOT_IDENTIFIABLE,
    ),
    ("not converged", [90, 60, 120], layers::NOT_CONVERGED),
    ("defect", [204, 51, 17], layers::DEFECT),
    ("border", [0, 119, 187], layers::BORDER),
    ("misfit", [238, 119, 51], layers::MISFIT),
    ("a parameter at its bound", [238, 51, 119], layers::AT_BOUND),
    (
        "some observations masked",
        [187, 204, 170],
        layers::PARTLY_MASKED,
    ),
];

fn flags_picture(map: &Map, sheet: &Sheet) -> Picture {
    let mut names: Vec<(&str, Rgb)> = vec![("good", [0, 153, 136])];
    names.extend(CLASSES.iter().map(|(name, colour, _)| (*name, *colour)));
    picture::classes(sheet, "flags", &names, &|pixel| {
        let flags = map.layers.flags[pixel];
        CLASSES
            .iter()
            .position(|(_, _, bit)| flags & bit != 0)
            .map_or(0, |k| k + 1)
    })
}

fn write_defects(path: &Path, defects: &[Defect]) -> Result<(), WriteError> {
    let mut text = String::from(
        "x_mm,y_mm,width_mm,height_mm,area_mm2,pixels,worst,lean_azimuth_deg,parameter,value,usual,sigmas\n",
    );
    let number = |x: Option<f64>| x.map_or_else(String::new, |x| format!("{x:.6}"));
    for d in defects {
        for deviation in &d.deviations {
            text.push_str(&format!(
                "{:.4},{:.4},{:.4},{:.4},{:.5},{},{},{},{},{},{:.6},{}\n",
                d.x_mm,
                d.y_mm,
                d.width_mm,
                d.height_mm,
                d.area_mm2,
                d.pixels,
                d.worst,
                number(d.lean_azimuth_deg),
                deviation.parameter,
                number(deviation.value),
                deviation.usual,
                number(deviation.sigmas),
            ));
        }
    }
    File::create(path)
        .and_then(|mut file| file.write_all(text.as_bytes()))
        .map_err(failed(path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    /// A file on a disk that is full after `writes_left` writes.
    struct Full<'a> {
        file: io::Cursor<Vec<u8>>,
        writes_left: u32,
        refused: &'a Cell<bool>,
    }

    impl Write for Full<'_> {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let Some(left) = self.writes_left.checked_sub(1) else {
                self.refused.set(true);
                return Err(io::ErrorKind::StorageFull.into());
            };
            self.writes_left = left;
            self.file.write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl io::Seek for Full<'_> {
        fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
            self.file.seek(to)
        }
    }

    #[test]
    fn a_file_that_lacks_any_of_its_writes_even_the_last_is_an_error() {
        let values: Vec<f32> = (0..64 * 64).map(|n| (n as f32).sin()).collect();
        let picture = || Picture {
            width: 64,
            height: 64,
            rgb: (0..3 * 64 * 64).map(|n| (n * n % 251) as u8).collect(),
        };
        let path = Path::new("full");
        for png in [false, true] {
            for writes_left in 0.. {
                let refused = Cell::new(false);
                let file = Full {
                    file: io::Cursor::default(),
                    writes_left,
                    refused: &refused,
                };
                let written = match png {
                    true => write_whole(path, file, |into| encode_png(into, &picture())),
                    false => write_whole(path, file, |into| {
                        encode_tiff::<colortype::Gray32Float>(into, &values, 64, 64, None)
                    }),
                };
                assert_eq!(written.is_err(), refused.get(), "{writes_left} writes");
                if written.is_ok() {
                    assert!(writes_left > 0);
                    break;
                }
            }
        }
    }

    fn names_in(folder: &Path) -> Vec<String> {
        let files = std::fs::read_dir(folder).unwrap();
        let name = |file: io::Result<std::fs::DirEntry>| file.unwrap().file_name();
        let mut names: Vec<String> = files.map(|f| name(f).into_string().unwrap()).collect();
        names.sort_unstable();
        names
    }

    #[test]
    fn a_map_cancelled_between_two_files_leaves_no_draft_and_an_older_map_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let older = folder.path().join("a.tif");
        std::fs::write(&older, "older").unwrap();
        let cancel = AtomicBool::new(false);
        let drafts = Drafts {
            folder: folder.path(),
            files: Mutex::default(),
        };
        let make = |path: &Path| std::fs::write(path, "whole").map_err(failed(path));
        drafts.file("a.tif", &cancel, make).unwrap();
        let raise = |path: &Path| {
            cancel.store(true, Ordering::Relaxed);
            make(path)
        };
        // The file during which the flag is raised is completed, and no other is started.
        drafts.file("b.tif", &cancel, raise).unwrap();
        let refused = drafts.file("c.tif", &cancel, |_| panic!("the map is cancelled"));
        assert!(matches!(refused, Err(WriteError::Cancelled)));
        drop(drafts);
        assert_eq!(names_in(folder.path()), ["a.tif"]);
        assert_eq!(std::fs::read_to_string(&older).unwrap(), "older");
    }

    #[test]
    fn kept_files_replace_those_of_an_older_map() {
        let folder = tempfile::tempdir().unwrap();
        let (a, last) = (folder.path().join("a.tif"), folder.path().join("last"));
        std::fs::write(&a, "older").unwrap();
        std::fs::write(&last, "older").unwrap();
        let drafts = Drafts {
            folder: folder.path(),
            files: Mutex::default(),
        };
        let never = AtomicBool::new(false);
        let make = |path: &Path| std::fs::write(path, "whole").map_err(failed(path));
        drafts.file("last", &never, make).unwrap();
        drafts.file("a.tif", &never, make).unwrap();
        assert_eq!(std::fs::read_to_string(&a).unwrap(), "older");
        drafts.keep("last").unwrap();
        assert_eq!(names_in(folder.path()), ["a.tif", "last"]);
        for file in [a, last] {
            assert_eq!(std::fs::read_to_string(file).unwrap(), "whole");
        }
    }

    #[test]
    fn a_tiff_states_the_meaning_of_its_values() {
        let mut file = io::Cursor::new(Vec::new());
        let meaning = Some("sum of: 1 not_converged");
        encode_tiff::<colortype::Gray8>(&mut file, &[1, 0, 4, 64], 2, 2, meaning).unwrap();
        file.set_position(0);
        let mut decoder = tiff::decoder::Decoder::new(file).unwrap();
        let said = decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap();
        assert_eq!(Some(said.as_str()), meaning);
        let tiff::decoder::DecodingResult::U8(values) = decoder.read_image().unwrap() else {
            panic!("expected u8 values");
        };
        assert_eq!(values, [1, 0, 4, 64]);
    }
}
