//! The recorded board where it lies turned, displaced or moved.

use super::super::region::{self, Board};
use super::*;
use crate::units::Angle;

/// Turns, moves and shrinks pictures of the recorded board: each frame is drawn again from the levels
/// of its patches and mount as the board lies at `azimuth_offset`, `axis_px` away.
fn displaced_board(azimuth_offset: f64, axis_px: [f64; 2], moved: Option<&str>) -> Memory {
    let mut series = checker().clone();
    let layout = series.manifest.sample.layout.clone().unwrap();
    let board = Board::new(&series.manifest, &layout);
    let mut there = board.clone();
    there.placement.turn = Angle::from_deg(azimuth_offset);
    there.placement.axis_px = axis_px;
    for at in 0..series.rows.len() {
        if series.rows[at].kind != FrameKind::Sample {
            continue;
        }
        let frame = series.frames[at].clone().unwrap();
        let pose = series.rows[at].pose();
        let mut levels: HashMap<(u32, u32), Vec<u16>> = HashMap::new();
        let mut mount = Vec::new();
        board.draw(pose, 256 * 256, |pixel, spot| match spot {
            region::Spot::Patch(i, j) => {
                levels
                    .entry((i, j))
                    .or_default()
                    .push(frame.pixels_dn()[pixel]);
            }
            region::Spot::Mount => mount.push(frame.pixels_dn()[pixel]),
            region::Spot::Border => {}
        });
        let mut own = there.clone();
        if moved.is_some_and(|file| series.rows[at].file.contains(file)) {
            own.placement.axis_px = [axis_px[0] + 6.0, axis_px[1] - 4.0];
        }
        let drawing = own.at(pose, 0.0);
        let dn = (0..256 * 256)
            .map(|pixel| {
                let (c, r) = ((pixel % 256) as f64 + 0.5, (pixel / 256) as f64 + 0.5);
                let pool = match drawing.spot(c, r) {
                    region::Spot::Patch(i, j) => &levels[&(i, j)],
                    _ => &mount,
                };
                pool[pixel * 7919 % pool.len()]
            })
            .collect();
        series.frames[at] = Some(Frame::new(256, 256, dn).unwrap());
    }
    // Pixels were redistributed, so the sensor's pattern is gone: uniform flats say there is none.
    for at in 0..series.rows.len() {
        if series.rows[at].kind == FrameKind::Flat {
            let file = series.rows[at].file.clone();
            series.edit(&file, |p| {
                let mean = p.iter().map(|d| f64::from(*d)).sum::<f64>() / p.len() as f64;
                p.iter_mut()
                    .enumerate()
                    .for_each(|(i, d)| *d = (mean + f64::from((i % 5) as u8) - 2.0) as u16);
            });
        }
    }
    series
}

#[test]
fn a_turned_and_displaced_board_is_found_and_its_patches_followed() {
    let truth = truth("checker", "even");
    for (turn, axis) in [(7.0, [0.0, 0.0]), (-4.0, [5.0, -3.0]), (0.0, [0.0, 0.0])] {
        let series = displaced_board(turn, axis, None);
        let set = reduced(&series, Some("even"));
        assert_eq!(set.observations.len(), 24, "{:?}", set.rejected_frames);
        // Vignetting of 3 % rms stays in the redistributed pixels; a patch's neighbours or
        // the mount in it would be 10 % and more.
        for o in &set.observations {
            assert!(
                (o.signal / truth[&key(o)] - 1.0).abs() < 0.05,
                "{turn} {o:?}"
            );
        }
        let said = set.warnings.iter().any(|w| w.contains("turned"));
        assert_eq!(said, turn != 0.0, "{:?}", set.warnings);
    }
}

#[test]
fn a_frame_in_which_the_board_moved_is_shifted() {
    let series = displaced_board(0.0, [0.0, 0.0], Some("sample_tc+10_ps090"));
    let set = reduced(&series, Some("odd"));
    assert_eq!(set.rejected_frames.len(), 1, "{:?}", set.rejected_frames);
    assert_eq!(set.rejected_frames[0].reason, "shifted");
    assert!(set.rejected_frames[0].file.contains("tc+10_ps090"));
    // A frame rolled as a whole has the sensor's pattern elsewhere too.
    let mut rolled = checker().clone();
    rolled.edit("sample_tc+00_ps045", |p| roll(p, 4, 1));
    let set = reduced(&rolled, Some("even"));
    assert_eq!(set.rejected_frames.len(), 1, "{:?}", set.rejected_frames);
    assert_eq!(set.rejected_frames[0].reason, "shifted");
}
