//! Images that the camera returned before: a camera or a program that hangs, or a buffer that is not emptied.

use std::collections::HashSet;

use super::frame_rules::FrameRules;
use crate::frame::Frame;

/// Largest share of defects among the pixels of an image.
const DEFECTS: f64 = 0.02;
/// Pixels with noise, beyond that share, that two images cannot have in common by chance.
const IN_NOISE: f64 = 64.0;

/// Fingerprints of the images that the camera returned, also of those that no point kept: a stale image of a rejected visit may
/// come again at its retake.
#[derive(Debug, Default)]
pub(super) struct SeenImages(HashSet<u64>);

impl SeenImages {
    /// Returns the images of earlier runs of a scan.
    pub fn of(frames: &[Frame], rules: &FrameRules) -> SeenImages {
        SeenImages(
            frames
                .iter()
                .filter_map(|frame| print(frame, rules))
                .collect(),
        )
    }

    /// Adds an image; returns whether the camera returned it before. Images of a camera without noise may be equal.
    pub fn shows_again(&mut self, frame: &Frame, rules: &FrameRules) -> bool {
        rules.read_noise_dn > 0.0 && print(frame, rules).is_some_and(|print| !self.0.insert(print))
    }
}

/// Returns the fingerprint of an image; `None` where too few pixels have noise. Full pixels, pixels clipped at 0 and defects are
/// equal in all images, and so are all pixels where the counts are coarser than the noise.
fn print(frame: &Frame, rules: &FrameRules) -> Option<u64> {
    use std::hash::{DefaultHasher, Hash, Hasher};
    let pixels = frame.pixels_dn();
    let mut often = vec![0_u32; usize::from(u16::MAX) + 1];
    for dn in pixels {
        often[usize::from(*dn)] += 1;
    }
    let between = &often[1..usize::from(rules.saturation_dn).clamp(1, often.len())];
    let most = between.iter().copied().max().unwrap_or(0);
    let in_noise: u32 = between.iter().sum::<u32>() - most;
    if f64::from(in_noise) < IN_NOISE + DEFECTS * pixels.len() as f64 {
        return None;
    }
    let mut hasher = DefaultHasher::new();
    pixels.hash(&mut hasher);
    Some(hasher.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::frame_rules::tests::{rules, shown, taken};

    fn image(dn: u16) -> Frame {
        taken(dn, 0.1).captured.frame
    }

    #[test]
    fn an_image_that_repeats_is_found_however_many_came_between() {
        let mut seen = SeenImages::default();
        for dn in [900, 901, 902] {
            assert!(!seen.shows_again(&image(dn), &rules()), "{dn}");
        }
        assert!(seen.shows_again(&image(900), &rules()));
        // Also after a restart of the program.
        let mut resumed = SeenImages::of(&[image(900)], &rules());
        assert!(resumed.shows_again(&image(900), &rules()));
        assert!(!resumed.shows_again(&image(901), &rules()));
        // Images of a camera without noise are rightly equal.
        let mut silent = rules();
        silent.read_noise_dn = 0.0;
        assert!(!seen.shows_again(&image(900), &silent));
    }

    #[test]
    fn a_dark_image_that_repeats_is_found() {
        let mut seen = SeenImages::default();
        let noise = |i: u16| 198 + i.wrapping_mul(7919) % 5;
        let dark = shown(&(0..256).map(noise).collect::<Vec<u16>>(), 0.1);
        assert!(!seen.shows_again(&dark.captured.frame, &rules()));
        assert!(seen.shows_again(&dark.captured.frame, &rules()));
    }

    #[test]
    fn defects_and_clipped_pixels_do_not_make_images_equal() {
        // Black, full, a dead pixel among full ones, hot pixels over clipped black, both, and one count everywhere.
        let pictures = [
            vec![200; 256],
            vec![4095; 256],
            [vec![3; 1], vec![4095; 255]].concat(),
            [vec![3000; 3], vec![0; 253]].concat(),
            [vec![3; 1], vec![3000; 3], vec![4095; 200], vec![0; 52]].concat(),
            [vec![2; 250], vec![3; 6]].concat(),
        ];
        for dn in pictures {
            let frame = shown(&dn, 0.01).captured.frame;
            let mut seen = SeenImages::default();
            assert!(!seen.shows_again(&frame, &rules()), "{dn:?}");
            assert!(!seen.shows_again(&frame, &rules()), "{dn:?}");
        }
    }
}
