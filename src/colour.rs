//! Perceptually uniform colour scales: equal steps in value are equal steps in lightness.
//!
//! They are built in OKLCh (B. Ottosson, "A perceptual color space for image processing", 2020), whose distances are
//! close to perceived ones. [`sequential`] increases in lightness from dark violet over green to light yellow, so it
//! stays readable in grey and with deficient colour vision. [`diverging`] darkens symmetrically from white at zero to
//! blue and red. [`cyclic`] runs once round the hues at one lightness, for directions.

use std::sync::LazyLock;

/// An sRGB colour.
pub type Rgb = [u8; 3];

/// Steps of a scale; neighbours differ by two of 255 in a channel at most.
const STEPS: usize = 4096;

/// A scale over [0, 1], by steps: a picture asks for the colour of each of its pixels.
type Steps = LazyLock<Vec<Rgb>>;

/// The steps of a scale.
fn steps(colour: impl Fn(f64) -> Rgb) -> Vec<Rgb> {
    (0..=STEPS)
        .map(|step| colour(step as f64 / STEPS as f64))
        .collect()
}

/// The colour of a fraction in [0, 1].
fn at(steps: &Steps, fraction: f64) -> Rgb {
    steps[(fraction * STEPS as f64).round() as usize]
}

/// Returns the colour of a fraction in [0, 1]; values outside are clipped.
pub fn sequential(fraction: f64) -> Rgb {
    static SCALE: Steps = Steps::new(|| {
        steps(|t| {
            let lightness = 0.24 + (0.93 - 0.24) * t;
            let hue_deg = 295.0 - (295.0 - 105.0) * t;
            in_gamut(lightness, 0.17, hue_deg)
        })
    });
    at(&SCALE, fraction.clamp(0.0, 1.0))
}

/// Returns the colour of a signed fraction in [−1, 1]: blue below zero, white at zero, red above. Values outside are
/// clipped. Opposite values are equally dark.
pub fn diverging(fraction: f64) -> Rgb {
    static BLUE: Steps = Steps::new(|| steps(|strength| darkened(strength, 255.0)));
    static RED: Steps = Steps::new(|| steps(|strength| darkened(strength, 28.0)));
    let t = fraction.clamp(-1.0, 1.0);
    at(if t < 0.0 { &BLUE } else { &RED }, t.abs())
}

/// Returns one side of the diverging scale.
fn darkened(strength: f64, hue_deg: f64) -> Rgb {
    let lightness = 0.98 - (0.98 - 0.42) * strength;
    in_gamut(lightness, 0.19 * strength, hue_deg)
}

/// Returns the colour of a direction; `turn` and `turn + 1` have the same.
pub fn cyclic(turn: f64) -> Rgb {
    // The largest chroma that all hues have at this lightness.
    static SCALE: Steps = Steps::new(|| steps(|turn| in_gamut(0.72, 0.115, 360.0 * turn + 25.0)));
    at(&SCALE, turn.rem_euclid(1.0))
}

/// Returns the colour of a lightness and hue with the largest displayable chroma up to the given one.
fn in_gamut(lightness: f64, chroma: f64, hue_deg: f64) -> Rgb {
    let (mut low, mut high) = (0.0, chroma);
    let fits = |c: f64| {
        linear_rgb(lightness, c, hue_deg)
            .iter()
            .all(|x| (-1e-4..=1.0001).contains(x))
    };
    if fits(chroma) {
        low = chroma;
    } else {
        for _ in 0..30 {
            let middle = 0.5 * (low + high);
            if fits(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
    }
    linear_rgb(lightness, low, hue_deg).map(|x| (srgb(x.clamp(0.0, 1.0)) * 255.0).round() as u8)
}

/// Converts OKLCh to linear sRGB.
fn linear_rgb(lightness: f64, chroma: f64, hue_deg: f64) -> [f64; 3] {
    let (sin, cos) = hue_deg.to_radians().sin_cos();
    let (a, b) = (chroma * cos, chroma * sin);
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ]
}

/// Applies the transfer function of sRGB (IEC 61966-2-1).
#[must_use]
pub fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CIE 1976 lightness L* of an sRGB colour; independent of the scale in which the maps are built.
    fn cie_lightness(rgb: Rgb) -> f64 {
        let linear = rgb.map(|c| {
            let x = f64::from(c) / 255.0;
            if x <= 0.040_45 {
                x / 12.92
            } else {
                ((x + 0.055) / 1.055).powf(2.4)
            }
        });
        let y = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
        116.0 * y.cbrt() - 16.0
    }

    #[test]
    fn lightness_of_the_sequential_map_increases_evenly() {
        let steps: Vec<f64> = (0..=32)
            .map(|i| cie_lightness(sequential(f64::from(i) / 32.0)))
            .collect();
        let mean = (steps[32] - steps[0]) / 32.0;
        assert!(steps[0] < 20.0 && steps[32] > 88.0, "{steps:?}");
        for pair in steps.windows(2) {
            // The two lightness scales and eight-bit rounding agree to a third of a step.
            assert!(
                (pair[1] - pair[0] - mean).abs() < 0.4 * mean,
                "{pair:?} {mean}"
            );
        }
    }

    #[test]
    fn neighbouring_steps_differ_by_two_levels_at_most() {
        for scale in [sequential, diverging, cyclic] {
            for step in 0..STEPS {
                let [a, b] = [step, step + 1].map(|n| scale(n as f64 / STEPS as f64));
                let close = a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 2);
                assert!(close, "{step}: {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn opposite_values_are_equally_dark_and_zero_is_the_lightest() {
        for step in 1..=16 {
            let t = f64::from(step) / 16.0;
            let (low, high) = (cie_lightness(diverging(-t)), cie_lightness(diverging(t)));
            // The scales of CIE and OKLab differ most in saturated blue and red.
            assert!((low - high).abs() < 9.0, "{t}: {low} {high}");
            let before = cie_lightness(diverging(t - 1.0 / 16.0));
            assert!(high < before && low < cie_lightness(diverging(1.0 / 16.0 - t)));
        }
        assert_eq!(diverging(0.0), diverging(-0.0));
        // A test of the page (web/tests/unit/perceptual.test.ts) asserts the same numbers.
        assert_eq!(
            [-1.0, 0.0, 1.0].map(diverging),
            [[0, 75, 150], [248, 248, 248], [149, 0, 7]]
        );
    }

    #[test]
    fn directions_have_one_lightness_and_close_the_circle() {
        let around: Vec<f64> = (0..36)
            .map(|i| cie_lightness(cyclic(f64::from(i) / 36.0)))
            .collect();
        let (low, high) = around
            .iter()
            .fold((f64::INFINITY, 0.0_f64), |(l, h), x| (l.min(*x), h.max(*x)));
        assert!(high - low < 8.0, "{low} {high}");
        assert_eq!(cyclic(0.25), cyclic(1.25));
        assert_eq!(cyclic(0.25), cyclic(-0.75));
    }

    #[test]
    fn white_and_black_are_exact() {
        assert_eq!(in_gamut(1.0, 0.0, 0.0), [255, 255, 255]);
        assert_eq!(in_gamut(0.0, 0.0, 0.0), [0, 0, 0]);
    }
}
