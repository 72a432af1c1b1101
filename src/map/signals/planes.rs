//! Signals and uncertainties of every pose and map pixel, tile by tile, in memory or, above a limit, in a scratch
//! file that is deleted after the map.
//!
//! A tile is a run of [`TILE`] consecutive pixels. Planes are written pose by pose and read tile by tile.

use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Mutex;

use tempfile::NamedTempFile;

/// Pixels per tile.
pub(in crate::map) const TILE: usize = 4096;
/// Bytes per pixel and pose: signal and σ as f32.
const BYTES: usize = 8;

/// All poses of all pixels.
pub(in crate::map) struct Planes {
    poses: usize,
    pixels: usize,
    keep: Keep,
}

enum Keep {
    /// One vector per tile, `[pose][pixel][signal, σ]`.
    Memory(Vec<Mutex<Vec<f32>>>),
    File(NamedTempFile),
}

impl Planes {
    /// Allocates `poses` × `pixels`; above `memory_bytes_max`, in a file in `scratch`.
    ///
    /// # Errors
    /// The error of the operating system, if the file cannot be created.
    pub(in crate::map) fn new(
        poses: usize,
        pixels: usize,
        memory_bytes_max: usize,
        scratch: &Path,
    ) -> io::Result<Self> {
        let keep = if poses * pixels * BYTES <= memory_bytes_max {
            let tiles = pixels.div_ceil(TILE);
            Keep::Memory(
                (0..tiles)
                    .map(|tile| Mutex::new(vec![0.0; poses * length(pixels, tile) * 2]))
                    .collect(),
            )
        } else {
            std::fs::create_dir_all(scratch)?;
            let mut named = tempfile::Builder::new();
            named.prefix(".ridged-map-").suffix(".scratch");
            Keep::File(named.tempfile_in(scratch)?)
        };
        Ok(Planes {
            poses,
            pixels,
            keep,
        })
    }

    pub(in crate::map) fn poses(&self) -> usize {
        self.poses
    }

    pub(in crate::map) fn tiles(&self) -> usize {
        self.pixels.div_ceil(TILE)
    }

    /// Pixels of a tile.
    pub(in crate::map) fn range(&self, tile: usize) -> std::ops::Range<usize> {
        tile * TILE..tile * TILE + length(self.pixels, tile)
    }

    /// Stores one pose of one tile: signal and σ alternating, σ = 0 if there is no signal.
    ///
    /// # Errors
    /// The error of the operating system, for example if the disk is full.
    pub(in crate::map) fn put(&self, pose: usize, tile: usize, plane: &[f32]) -> io::Result<()> {
        let length = length(self.pixels, tile) * 2;
        assert_eq!(plane.len(), length, "a plane covers its tile");
        match &self.keep {
            Keep::Memory(tiles) => {
                let mut kept = tiles[tile].lock().expect("no holder of this lock panics");
                kept[pose * length..(pose + 1) * length].copy_from_slice(plane);
                Ok(())
            }
            Keep::File(file) => {
                let bytes: Vec<u8> = plane.iter().flat_map(|x| x.to_le_bytes()).collect();
                let at = (tile * TILE * self.poses) * BYTES + pose * length * 4;
                file.as_file().write_all_at(&bytes, at as u64)
            }
        }
    }

    /// Returns all poses of one tile, `[pose][pixel][signal, σ]`.
    ///
    /// # Errors
    /// The error of the operating system.
    pub(in crate::map) fn get(&self, tile: usize) -> io::Result<Vec<f32>> {
        match &self.keep {
            Keep::Memory(tiles) => Ok(tiles[tile]
                .lock()
                .expect("no holder of this lock panics")
                .clone()),
            Keep::File(file) => {
                let mut bytes = vec![0; self.poses * length(self.pixels, tile) * BYTES];
                let at = (tile * TILE * self.poses * BYTES) as u64;
                file.as_file().read_exact_at(&mut bytes, at)?;
                Ok(bytes
                    .as_chunks::<4>()
                    .0
                    .iter()
                    .map(|b| f32::from_le_bytes(*b))
                    .collect())
            }
        }
    }
}

fn length(pixels: usize, tile: usize) -> usize {
    TILE.min(pixels - tile * TILE)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    #[test]
    fn two_maps_at_once_in_one_folder_use_files_of_their_own() {
        let place = tempfile::tempdir().unwrap();
        let planes: Vec<Planes> = (0..2)
            .map(|_| Planes::new(1, 8, 0, place.path()).unwrap())
            .collect();
        let names = || -> Vec<PathBuf> {
            let files = std::fs::read_dir(place.path()).unwrap();
            files.map(|f| f.unwrap().path()).collect()
        };
        assert_eq!(names().len(), 2);
        for (signal, planes) in [1.0, 2.0].into_iter().zip(&planes) {
            planes.put(0, 0, &[signal; 16]).unwrap();
        }
        for (signal, planes) in [1.0, 2.0].into_iter().zip(&planes) {
            assert_eq!(planes.get(0).unwrap(), [signal; 16]);
        }
        drop(planes);
        assert_eq!(names(), Vec::<PathBuf>::new());
    }

    #[test]
    fn memory_and_file_return_the_same_and_the_file_is_deleted() {
        let place = tempfile::tempdir().unwrap();
        let pixels = TILE + 100;
        let memory = Planes::new(3, pixels, usize::MAX, place.path()).unwrap();
        let file = Planes::new(3, pixels, 0, place.path()).unwrap();
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 1);
        for planes in [&memory, &file] {
            for pose in [2, 0, 1] {
                for tile in 0..planes.tiles() {
                    let plane: Vec<f32> = planes
                        .range(tile)
                        .flat_map(|p| [(pose * pixels + p) as f32, 0.5])
                        .collect();
                    planes.put(pose, tile, &plane).unwrap();
                }
            }
        }
        for tile in 0..2 {
            let kept = memory.get(tile).unwrap();
            assert_eq!(kept, file.get(tile).unwrap());
            let range = memory.range(tile);
            assert_eq!(
                kept[2 * range.len() * 2 + 6],
                (2 * pixels + range.start + 3) as f32
            );
        }
        drop(file);
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0);
    }
}
