//! Double reflections by integration in place of the closed approximation.
//!
//! On metal much of the light is reflected by both walls of a valley, and the closed form approximates this light
//! only to some percent. The quadrature costs a thousand closed forms, so it is computed on the few surfaces that
//! represent most pixels. Its difference from the closed form, which changes slowly, is added as a fixed offset to
//! every pixel near one of these surfaces. A pixel far from all of them is fitted with the closed form only.

use super::solve::kernel::{FREE, Parameters, difference};

/// Distance up to which such a surface's offset is used: rad, rad, logarithms.
const REACH: [f64; FREE - 1] = [0.06, 0.12, 0.4, 0.4];

/// Offsets on representative surfaces.
#[derive(Debug, Clone, Default)]
pub(super) struct Integrated {
    centres: Vec<(Parameters, Vec<f64>)>,
    /// Whether the fifth parameter is the amplitude: light reflected twice is proportional to its square.
    amplitude: bool,
}

impl Integrated {
    /// Computes `difference` at each centre; centres without a finite offset are dropped.
    pub(super) fn at(
        centres: Vec<Parameters>,
        amplitude: bool,
        difference: impl Fn(&Parameters) -> Vec<f64>,
    ) -> Integrated {
        let with_offset = |centre: Parameters| {
            let offset = difference(&centre);
            let finite = offset.iter().all(|x| x.is_finite());
            finite.then_some((centre, offset))
        };
        Integrated {
            centres: centres.into_iter().filter_map(with_offset).collect(),
            amplitude,
        }
    }

    /// Returns the correction of the closed form at `p`: a factor, and one offset per observation; `None` far from
    /// every centre.
    pub(super) fn near(&self, p: &Parameters) -> Option<(f64, &[f64])> {
        let (distance, centre, offset) = self
            .centres
            .iter()
            .map(|(centre, offset)| (distance(centre, p), centre, offset))
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        let share = if self.amplitude && centre[4] > 0.0 {
            (p[4] / centre[4]).powi(2)
        } else {
            1.0
        };
        (distance < 1.0).then_some((share, offset.as_slice()))
    }
}

/// Returns the largest distance of a parameter in units of its reach, without the fifth.
pub(super) fn distance(a: &Parameters, b: &Parameters) -> f64 {
    let apart = difference(a, b);
    let shares = apart.iter().zip(REACH).map(|(d, reach)| d.abs() / reach);
    shares.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_centre_gives_its_offset_and_azimuth_wraps() {
        let centres = vec![[0.1, 0.01, -2.0, -2.0, 2.0], [0.1, 1.57, -2.0, -2.0, 1.0]];
        let integrated = Integrated::at(centres, true, |p| vec![p[1]]);
        let (share, offset) = integrated.near(&[0.1, 6.27, -2.0, -2.0, 1.0]).unwrap();
        assert_eq!((share, offset), (0.25, &[0.01][..]));
        assert!(integrated.near(&[0.3, 0.01, -2.0, -2.0, 1.0]).is_none());
        let broken = Integrated::at(vec![[0.1; FREE]], false, |_| vec![f64::NAN]);
        assert!(broken.near(&[0.1; FREE]).is_none());
    }
}
