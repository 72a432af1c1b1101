//! Assigns pixels to parts of the sample: the whole field, or the patches of a board that turns with φs about the rotation axis
//! and foreshortens with θc.

use super::refusals::ReductionError;
use crate::geometry::{Imaging, Pose};
use crate::series::{LayoutFacts, Manifest};
use crate::units::Angle;

/// Label of a pixel in no segment.
pub(super) const NOWHERE: u16 = u16::MAX;

/// A region of a board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Region {
    Even,
    Odd,
    Patch { i: u32, j: u32 },
}

impl Region {
    /// Reads `even`, `odd` or `patch-I-J` of a board with the given layout.
    pub(super) fn parse(name: &str, layout: &LayoutFacts) -> Option<Region> {
        match name {
            "even" => Some(Region::Even),
            "odd" => Some(Region::Odd),
            _ => {
                let (i, j) = name.strip_prefix("patch-")?.split_once('-')?;
                let (i, j) = (i.parse().ok()?, j.parse().ok()?);
                (i < layout.patches_x && j < layout.patches_y).then_some(Region::Patch { i, j })
            }
        }
    }

    /// Every region's name.
    pub(super) fn names(layout: &LayoutFacts) -> Vec<String> {
        let mut names = vec!["even".to_owned(), "odd".to_owned()];
        for i in 0..layout.patches_x {
            for j in 0..layout.patches_y {
                names.push(format!("patch-{i}-{j}"));
            }
        }
        names
    }

    fn holds(self, i: u32, j: u32) -> bool {
        match self {
            Region::Even => (i + j).is_multiple_of(2),
            Region::Odd => !(i + j).is_multiple_of(2),
            Region::Patch { i: pi, j: pj } => (i, j) == (pi, pj),
        }
    }

    /// Whether its patches are odd ones.
    pub(super) fn is_odd(self) -> bool {
        match self {
            Region::Even => false,
            Region::Odd => true,
            Region::Patch { i, j } => !(i + j).is_multiple_of(2),
        }
    }
}

/// Placement of a board on the table relative to the manifest, found in the frames.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Placement {
    /// Added to the recorded azimuth.
    pub(super) turn: Angle,
    /// Added to the rotation axis, in pixels (column, row) at θc = 0.
    pub(super) axis_px: [f64; 2],
    /// Added to the board's centre.
    pub(super) centre_mm: [f64; 2],
}

impl Placement {
    /// Its numbers in full, to tell one from another.
    pub(super) fn words(&self) -> String {
        let [right, down] = self.axis_px;
        let [x, y] = self.centre_mm;
        format!("{} {right} {down} {x} {y}", self.turn.rad())
    }

    /// Whether patches drawn by either hold nearly the same pixels.
    pub(super) fn is_near(&self, other: &Placement, board: &Board) -> bool {
        const NEAR_PX: f64 = 0.3;
        const NEAR_DEG: f64 = 0.1;
        let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        (self.turn - other.turn).deg().abs() < NEAR_DEG
            && apart(self.axis_px, other.axis_px) < NEAR_PX
            && apart(self.centre_mm, other.centre_mm) < NEAR_PX * board.pixel_mm[0]
    }
}

/// Draws a board in the frame.
#[derive(Debug, Clone)]
pub(super) struct Board {
    pub(super) layout: LayoutFacts,
    pub(super) pixel_mm: [f64; 2],
    imaging: Imaging,
    azimuth_zero: Angle,
    width: usize,
    pub(super) placement: Placement,
}

/// Place of a pixel on a board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Spot {
    /// Patch (i, j), at least the margin away from its border.
    Patch(u32, u32),
    /// Within the margin of a border between patches or of the board's edge.
    Border,
    /// Beyond the board.
    Mount,
}

impl Board {
    pub(super) fn new(manifest: &Manifest, layout: &LayoutFacts) -> Board {
        let camera = &manifest.camera;
        let imaging = manifest
            .imaging()
            .expect("the manifest's checks refuse a layout without a field width");
        Board {
            layout: layout.clone(),
            pixel_mm: imaging.pixel_mm,
            imaging,
            azimuth_zero: Angle::from_deg(manifest.rig.azimuth_zero_deg),
            width: camera.width_px as usize,
            placement: Placement::default(),
        }
    }

    /// Returns the margin at borders: for the pixels' width, half a pixel of registration, and blur.
    pub(super) fn margin_mm(&self) -> f64 {
        2.5 * self.pixel_mm[0].max(self.pixel_mm[1]) + 0.04 * self.layout.patch_size_mm
    }

    /// Returns the rig's imaging with the rotation axis as found in the frames.
    pub(super) fn imaging(&self) -> Imaging {
        let [column, row] = self.imaging.rotation_axis_px;
        let [right, down] = self.placement.axis_px;
        Imaging {
            rotation_axis_px: [column + right, row + down],
            ..self.imaging
        }
    }

    /// Azimuth of the board's x axis at a recorded pose.
    pub(super) fn azimuth(&self, pose: Pose) -> Angle {
        pose.phi_s + self.azimuth_zero + self.placement.turn
    }

    /// Returns the board at a recorded pose, with a margin of `margin_mm` at every border.
    pub(super) fn at(&self, pose: Pose, margin_mm: f64) -> Drawing {
        let layout = &self.layout;
        let (sin, cos) = self.azimuth(pose).sin_cos();
        let size = layout.patch_size_mm;
        let imaging = self.imaging();
        Drawing {
            sin,
            cos,
            axis_mm: imaging.axis_mm(),
            imaging,
            theta_c: pose.theta_c,
            patch_mm: size,
            edge_mm: [
                size * f64::from(layout.patches_x),
                size * f64::from(layout.patches_y),
            ],
            centre_mm: [0, 1].map(|k| layout.centre_mm[k] + self.placement.centre_mm[k]),
            margin_mm,
        }
    }

    /// Draws the board at a recorded pose: calls `paint(pixel, spot)` for every pixel.
    pub(super) fn draw(&self, pose: Pose, pixels: usize, mut paint: impl FnMut(usize, Spot)) {
        let drawing = self.at(pose, self.margin_mm());
        for pixel in 0..pixels {
            let column = (pixel % self.width) as f64 + 0.5;
            let row = (pixel / self.width) as f64 + 0.5;
            paint(pixel, drawing.spot(column, row));
        }
    }
}

/// A board at one pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drawing {
    imaging: Imaging,
    axis_mm: [f64; 2],
    theta_c: Angle,
    sin: f64,
    cos: f64,
    patch_mm: f64,
    edge_mm: [f64; 2],
    centre_mm: [f64; 2],
    margin_mm: f64,
}

impl Drawing {
    /// Returns the place at a column and row; integers are the pixels' corners.
    pub(super) fn spot(&self, column: f64, row: f64) -> Spot {
        let place = self.imaging.place(column, row, self.theta_c);
        let [x, y] = [0, 1].map(|k| place[k] - self.axis_mm[k]);
        // Into the sample's axes, from the board's lower left corner.
        let along = [
            x * self.cos + y * self.sin - self.centre_mm[0] + 0.5 * self.edge_mm[0],
            y * self.cos - x * self.sin - self.centre_mm[1] + 0.5 * self.edge_mm[1],
        ];
        let beyond = |k: usize| (-along[k]).max(along[k] - self.edge_mm[k]);
        let outside = beyond(0).max(beyond(1));
        if outside > self.margin_mm {
            return Spot::Mount;
        }
        let (a, b) = (along[0] / self.patch_mm, along[1] / self.patch_mm);
        let near = |t: f64| (t - t.round()).abs() * self.patch_mm < self.margin_mm;
        if outside > -self.margin_mm || near(a) || near(b) {
            Spot::Border
        } else {
            Spot::Patch(a as u32, b as u32)
        }
    }
}

/// The segments of a frame, each of which is averaged.
#[derive(Debug, Clone)]
pub(super) enum Segments {
    /// The sample fills the field.
    Whole,
    /// Patches of a board; the label is the index in `patches`.
    Patches {
        board: Box<Board>,
        patches: Vec<(u32, u32)>,
    },
}

impl Segments {
    /// Returns the segments of the whole field, or of one region of a board with it.
    ///
    /// # Errors
    /// [`ReductionError::RegionNeeded`] and [`ReductionError::UnknownRegion`].
    pub(super) fn of(
        manifest: &Manifest,
        region: Option<&str>,
    ) -> Result<(Segments, Option<Region>), ReductionError> {
        match (&manifest.sample.layout, region) {
            (None, None) => Ok((Segments::Whole, None)),
            (None, Some(name)) => Err(ReductionError::UnknownRegion {
                name: name.to_owned(),
                available: Vec::new(),
            }),
            (Some(layout), None) => Err(ReductionError::RegionNeeded {
                available: Region::names(layout),
            }),
            (Some(layout), Some(name)) => match Region::parse(name, layout) {
                Some(chosen) => Ok((
                    Self::of_region(Board::new(manifest, layout), chosen),
                    Some(chosen),
                )),
                None => Err(ReductionError::UnknownRegion {
                    name: name.to_owned(),
                    available: Region::names(layout),
                }),
            },
        }
    }

    pub(super) fn of_region(board: Board, region: Region) -> Segments {
        let mut patches = Vec::new();
        for i in 0..board.layout.patches_x {
            for j in 0..board.layout.patches_y {
                if region.holds(i, j) {
                    patches.push((i, j));
                }
            }
        }
        Segments::Patches {
            board: Box::new(board),
            patches,
        }
    }

    /// Returns the placement of the board; the default without a board.
    pub(super) fn placement(&self) -> Placement {
        match self {
            Segments::Whole => Placement::default(),
            Segments::Patches { board, .. } => board.placement,
        }
    }

    /// Sets the placement of the board.
    pub(super) fn place(&mut self, placement: Placement) {
        if let Segments::Patches { board, .. } = self {
            board.placement = placement;
        }
    }

    pub(super) fn len(&self) -> usize {
        match self {
            Segments::Whole => 1,
            Segments::Patches { patches, .. } => patches.len(),
        }
    }

    /// Returns the label of every pixel at a recorded pose; [`NOWHERE`] for defects and pixels in no segment.
    pub(super) fn labels(&self, pose: Pose, good: &[bool]) -> Vec<u16> {
        let mut labels = vec![NOWHERE; good.len()];
        match self {
            Segments::Whole => {
                for (label, good) in labels.iter_mut().zip(good) {
                    if *good {
                        *label = 0;
                    }
                }
            }
            Segments::Patches { board, patches } => {
                let ny = board.layout.patches_y as usize;
                let mut lookup = vec![NOWHERE; board.layout.patches_x as usize * ny];
                for (label, (i, j)) in patches.iter().enumerate() {
                    lookup[*i as usize * ny + *j as usize] = label as u16;
                }
                board.draw(pose, good.len(), |pixel, spot| {
                    if let Spot::Patch(i, j) = spot
                        && good[pixel]
                    {
                        labels[pixel] = lookup[i as usize * ny + j as usize];
                    }
                });
            }
        }
        labels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn board() -> Board {
        let manifest = Manifest::from_toml(
            include_str!("../../tests/data/series/checker/manifest.toml"),
            "",
        )
        .unwrap();
        Board::new(&manifest, manifest.sample.layout.as_ref().unwrap())
    }

    fn spot_at(board: &Board, pose: Pose, column: usize, row: usize) -> Spot {
        let mut found = Spot::Mount;
        board.draw(pose, 256 * 256, |pixel, spot| {
            if pixel == row * 256 + column {
                found = spot;
            }
        });
        found
    }

    #[test]
    fn a_patch_goes_where_the_table_turns_it() {
        // Patch (3, 0) has its centre at x = +13.5 mm, y = −13.5 mm: 67.5 px right of and below the axis.
        let board = board();
        let at = |theta, phi, column, row| spot_at(&board, Pose::from_deg(theta, phi), column, row);
        assert_eq!(at(0.0, 0.0, 195, 195), Spot::Patch(3, 0));
        // A quarter turn counter-clockwise seen from +z carries it to the right and up.
        assert_eq!(at(0.0, 90.0, 195, 60), Spot::Patch(3, 0));
        // Tilted by 60° the columns shrink to half, the rows stay.
        assert_eq!(at(60.0, 0.0, 161, 195), Spot::Patch(3, 0));
        assert_eq!(at(0.0, 0.0, 128, 195), Spot::Border);
        assert_eq!(at(0.0, 0.0, 5, 128), Spot::Mount);
    }

    #[test]
    fn patches_turn_about_the_axis_and_shrink_about_the_centre_of_tilt() {
        let mut board = board();
        board.imaging.rotation_axis_px = [138.0, 120.0];
        let at = |theta, phi, column, row| spot_at(&board, Pose::from_deg(theta, phi), column, row);
        // The middle of patch (3, 0) lies 67.5 px right of and below the axis.
        assert_eq!(at(0.0, 0.0, 205, 187), Spot::Patch(3, 0));
        assert_eq!(at(0.0, 180.0, 70, 52), Spot::Patch(3, 0));
        // Half as far from the centre of tilt, column 128, and not from the axis.
        assert_eq!(at(60.0, 0.0, 166, 187), Spot::Patch(3, 0));
        assert_eq!(at(60.0, 0.0, 133, 187), Spot::Border);
    }

    #[test]
    fn every_patch_keeps_most_of_its_area_and_all_have_the_same() {
        let board = board();
        let mut counts = std::collections::BTreeMap::new();
        board.draw(Pose::from_deg(0.0, 0.0), 256 * 256, |_, spot| {
            if let Spot::Patch(i, j) = spot {
                *counts.entry((i, j)).or_insert(0) += 1;
            }
        });
        assert_eq!(counts.len(), 16);
        for count in counts.values() {
            assert!((1200..=45 * 45).contains(count), "{count}");
        }
    }

    #[test]
    fn names_are_read_back_and_others_are_refused() {
        let layout = board().layout;
        for name in Region::names(&layout) {
            assert!(Region::parse(&name, &layout).is_some(), "{name}");
        }
        assert_eq!(Region::names(&layout).len(), 18);
        for name in ["patch-4-0", "patch-0", "worn", "patch--1-0", ""] {
            assert_eq!(Region::parse(name, &layout), None, "{name}");
        }
        assert!(Region::Patch { i: 1, j: 2 }.is_odd());
    }
}
