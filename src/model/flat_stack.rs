//! Stacked flat layers, exactly: all orders of reflection between them, without interference (layers thicker than the
//! lamp's coherence length) and without absorption inside.
//!
//! Call [`FlatStack::reflect`]. The recursion runs per channel x ∈ {s, p, z} from the bottom, R ← r + t↓ t↑ R / (1 −
//! r↑ R), with z = r_s r_p* and q t_s t_p* as in [`super::polarisation`]. The ray tracer must agree with it on flat
//! shapes.
//!
//! *Conditioning.* Powers are sums of positive terms only: the reflected share and the remainder are carried together
//! ([`Below`]), and every boundary between layers is computed from nᵢ cos θᵢ on both sides, each from the angle
//! above: (nᵢ cos θᵢ)² = (nᵢ − n₀)(nᵢ + n₀) + n₀² cos² θ. So grazing light keeps the digits of its cosine also in
//! inner layers of an index near the outer one. A layer adds a few roundings. The terms of z may cancel: its error is
//! relative to 1, not to itself.

use nalgebra::Complex;

use super::polarisation::{Boundary, Channel};
use crate::material::tables::FIXED_METALS;

/// Indices from the medium above down to the substrate, n + ik each.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatStack {
    indices: Vec<Complex<f64>>,
}

/// The reason why a stack cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FlatStackError {
    /// Fewer than two media.
    #[error("a stack needs at least one layer below the medium above")]
    Empty,
    /// A layer's text is neither a number nor a known name.
    #[error("layer {text:?} is neither an index greater than 0 nor one of Au550, Al550, Cu550")]
    UnknownLayer {
        /// What was written.
        text: String,
    },
    /// An inner layer absorbs.
    #[error("layer {position} absorbs; only the last layer may absorb")]
    AbsorbingLayer {
        /// 1 for the topmost layer.
        position: usize,
    },
    /// The angle is outside [0°, 90°).
    #[error("the angle of incidence must be in [0°, 90°)")]
    Angle,
}

/// The reflectance of a flat stack at one angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StackReflectance {
    /// Powers of s and p and the complex factor z of U and V.
    pub channel: Channel,
    /// The reflectance by unpolarised computation at every boundary.
    pub scalar: f64,
}

impl FlatStack {
    /// Takes the indices from the medium above (first) down to the substrate (last).
    ///
    /// # Errors
    /// There are fewer than two media, an index is not positive, or a layer above the substrate absorbs.
    pub fn new(indices: Vec<Complex<f64>>) -> Result<Self, FlatStackError> {
        if indices.len() < 2 {
            return Err(FlatStackError::Empty);
        }
        for (position, index) in indices.iter().enumerate() {
            let usable = index.re > 0.0 && index.im >= 0.0 && index.is_finite();
            if !usable {
                return Err(FlatStackError::UnknownLayer {
                    text: index.to_string(),
                });
            }
            if index.im > 0.0 && position + 1 < indices.len() {
                return Err(FlatStackError::AbsorbingLayer { position });
            }
        }
        Ok(FlatStack { indices })
    }

    /// Parses the form `1.3/1.5/Au550`: layers from the top, under air.
    ///
    /// # Errors
    /// As [`FlatStack::new`], and for a name other than the three fixed metals.
    pub fn parse(text: &str) -> Result<Self, FlatStackError> {
        let mut indices = vec![Complex::new(1.0, 0.0)];
        for layer in text.split('/') {
            let layer = layer.trim();
            let index = match (FIXED_METALS.iter().find(|m| m.0 == layer), layer.parse()) {
                (Some(metal), _) => Complex::new(metal.1, metal.2),
                (None, Ok(n)) if n > 0.0 && f64::is_finite(n) => Complex::new(n, 0.0),
                _ => {
                    return Err(FlatStackError::UnknownLayer {
                        text: layer.to_owned(),
                    });
                }
            };
            indices.push(index);
        }
        FlatStack::new(indices)
    }

    /// Returns the reflectance at the angle of incidence `theta_rad` in the medium above. Near grazing, an angle in
    /// radians has lost digits of its cosine; [`FlatStack::reflect_deg`] keeps them.
    ///
    /// # Errors
    /// The angle is not in [0°, 90°).
    pub fn reflect(&self, theta_rad: f64) -> Result<StackReflectance, FlatStackError> {
        if !(0.0..std::f64::consts::FRAC_PI_2).contains(&theta_rad) {
            return Err(FlatStackError::Angle);
        }
        let (sin, cos) = theta_rad.sin_cos();
        self.reflect_at(sin, cos)
    }

    /// As [`FlatStack::reflect`], at an angle in degrees.
    ///
    /// # Errors
    /// The angle is not in [0°, 90°).
    pub fn reflect_deg(&self, theta_deg: f64) -> Result<StackReflectance, FlatStackError> {
        if !(0.0..90.0).contains(&theta_deg) {
            return Err(FlatStackError::Angle);
        }
        // The distance to 90° is exact.
        let (sin, cos) = if theta_deg > 45.0 {
            let (sin, cos) = (90.0 - theta_deg).to_radians().sin_cos();
            (cos, sin)
        } else {
            theta_deg.to_radians().sin_cos()
        };
        self.reflect_at(sin, cos)
    }

    fn reflect_at(&self, sin: f64, cos: f64) -> Result<StackReflectance, FlatStackError> {
        let above = self.indices[0].re;
        let mut layers = Vec::new();
        // Transparent layers, up to the first that total reflection excludes light from.
        for index in self.indices.iter().take_while(|index| index.im == 0.0) {
            let layer = Layer::new(index.re, above, sin, cos);
            layers.push(layer);
            if layer.square <= 0.0 {
                break;
            }
        }
        let reached = layers.len();
        let mut z = Complex::new(0.0, 0.0);
        let (mut s, mut p, mut scalar) = (Below::NOTHING, Below::NOTHING, Below::NOTHING);
        let total = layers[reached - 1].square <= 0.0;
        if !total && let Some(metal) = self.indices.get(reached) {
            let here = &layers[reached - 1];
            let boundary = Boundary::new(here.n, metal.re, metal.im);
            let r = boundary.at(here.cos()).reflected;
            let kept = boundary.kept(here.cos());
            s = s.under(r.s, 0.0, kept.0);
            p = p.under(r.p, 0.0, kept.1);
            scalar = scalar.under(r.unpolarised(), 0.0, 0.5 * (kept.0 + kept.1));
            z = Complex::new(r.re, r.im);
        }
        for (here, beyond) in layers.windows(2).rev().map(|pair| (&pair[0], &pair[1])) {
            let Meeting { r, t } = here.meets(beyond);
            s = s.under(r.s, t.s, t.s);
            p = p.under(r.p, t.p, t.p);
            scalar = scalar.under(r.unpolarised(), t.unpolarised(), t.unpolarised());
            let complex = |c: Channel| Complex::new(c.re, c.im);
            z = complex(r) + complex(t) * complex(t) * z / (1.0 - complex(r) * z);
        }
        Ok(StackReflectance {
            channel: Channel {
                s: s.reflected,
                p: p.reflected,
                re: z.re,
                im: z.im,
            },
            scalar: scalar.reflected,
        })
    }
}

/// A transparent layer and the light in it.
#[derive(Debug, Clone, Copy)]
struct Layer {
    n: f64,
    /// (n cos θ)² of this layer; not positive if light does not enter.
    square: f64,
    /// n |cos θ|.
    across: f64,
    /// sin² θ of this layer.
    sin_squared: f64,
}

/// Reflection and transmission of a boundary between two layers. Powers are equal from both sides.
struct Meeting {
    r: Channel,
    t: Channel,
}

impl Layer {
    fn new(n: f64, above: f64, sin: f64, cos: f64) -> Self {
        let square = (n - above) * (n + above) + (above * cos).powi(2);
        Layer {
            n,
            square,
            across: square.abs().sqrt(),
            sin_squared: (above * sin / n).powi(2),
        }
    }

    fn cos(&self) -> f64 {
        (self.across / self.n).min(1.0)
    }

    fn meets(&self, beyond: &Layer) -> Meeting {
        let (a, b) = (self, beyond);
        if b.square <= 0.0 {
            // Total reflection: amplitudes of modulus 1, (a − ib)/(a + ib) and the equivalent for p.
            let s = Complex::new(a.across, -b.across);
            let p = Complex::new(b.n * b.n * a.across, -a.n * a.n * b.across);
            let unit = |x: Complex<f64>| x / x.norm();
            let (s, p) = (unit(s), unit(p));
            let z = (s * s) * (p * p).conj();
            return Meeting {
                r: Channel {
                    s: 1.0,
                    p: 1.0,
                    re: z.re,
                    im: z.im,
                },
                t: Channel::NONE,
            };
        }
        let sum_s = a.across + b.across;
        // For p, divided by both indices.
        let sum_p = b.n / a.n * a.across + a.n / b.n * b.across;
        let lift = (b.n - a.n) * (b.n + a.n);
        // 1 − R and the amplitudes without cancellation: cos² − sin² across the boundary is 0 at Brewster's angle,
        // and it keeps its digits at grazing if formed with the smaller cosine.
        let (grazing, steep) = if a.cos() < b.cos() { (a, b) } else { (b, a) };
        let brewster = grazing.square / (grazing.n * grazing.n) - steep.sin_squared;
        let r_s = -lift / (sum_s * sum_s);
        let r_p = lift * brewster / (sum_p * sum_p);
        let flux = 4.0 * a.across * b.across;
        Meeting {
            r: Channel {
                s: r_s * r_s,
                p: r_p * r_p,
                re: r_s * r_p,
                im: 0.0,
            },
            t: Channel {
                s: flux / (sum_s * sum_s),
                p: flux / (sum_p * sum_p),
                re: flux / (sum_s * sum_p),
                im: 0.0,
            },
        }
    }
}

/// The part of the stack below a boundary: the reflected share and the kept share, whose sum is 1.
///
/// Both are carried, because 1 − R loses its digits if R is near 1 (grazing light, layers over a metal), and
/// 1 − r↑ R = t↑ + r↑ (1 − R) needs them.
#[derive(Debug, Clone, Copy)]
struct Below {
    reflected: f64,
    kept: f64,
}

impl Below {
    /// Nothing is reflected.
    const NOTHING: Below = Below {
        reflected: 0.0,
        kept: 1.0,
    };

    /// Returns the shares with a boundary on top that reflects `r`, transmits `t` (0 under total reflection and over a
    /// metal) and reflects all but `kept`.
    fn under(self, r: f64, t: f64, kept: f64) -> Below {
        if t == 0.0 {
            return Below { reflected: r, kept }.settled();
        }
        let all_orders = t / (t + r * self.kept);
        Below {
            reflected: r + all_orders * t * self.reflected,
            kept: all_orders * self.kept,
        }
        .settled()
    }

    /// Computes the greater share from the smaller: the roundings of twenty layers add up in both, and are relatively
    /// small in the smaller one.
    fn settled(self) -> Below {
        if self.kept < 0.5 {
            Below {
                reflected: 1.0 - self.kept,
                ..self
            }
        } else {
            self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_recursion_agrees_with_the_exact_table() {
        let mut reader = csv::Reader::from_path("tests/data/polarised/flat_stack.csv").unwrap();
        let mut rows = 0;
        for record in reader.records() {
            let record = record.unwrap();
            let number = |i: usize| record[i].parse::<f64>().unwrap();
            let r = FlatStack::parse(&record[0])
                .unwrap()
                .reflect(number(1).to_radians())
                .unwrap();
            let expected = [2, 3, 4, 5, 6, 7].map(number);
            let found = [
                r.channel.s,
                r.channel.p,
                r.channel.re,
                r.channel.im,
                r.channel.unpolarised(),
                r.scalar,
            ];
            for (a, b) in found.iter().zip(expected) {
                assert!((a - b).abs() < 1e-10, "{record:?}: {found:?}");
            }
            rows += 1;
        }
        assert_eq!(rows, 102);
    }

    #[test]
    fn layers_of_an_index_near_the_outer_one_are_exact_at_grazing() {
        // From the same recursion with 40 digits, for the doubles nearest to these numbers (mpmath 1.3).
        #[rustfmt::skip]
        let cases: [(&str, f64, [f64; 6]); 7] = [
            ("2.4/1.0", 89.9999, [0.999_998_400_059_297_8, 0.999_990_784_341_555_7, 0.999_991_910_956_019_8, 0.0, 0.999_994_592_200_426_7, 0.999_994_592_214_926_5]),
            ("2.4/1.0/1.5", 89.9999, [0.999_998_726_389_224_5, 0.999_994_434_758_460_8, 0.999_992_318_607_068_6, 0.0, 0.999_996_580_573_842_7, 0.999_996_472_288_622_6]),
            ("1.5/1.0000001", 89.9, [0.996_828_242_945_191_5, 0.992_863_620_261_616_9, 0.994_114_909_412_057_5, 0.0, 0.994_845_931_603_404_2, 0.994_849_841_007_942_5]),
            ("1.8/1.0/Au550", 89.9999, [0.999_999_756_765_180_7, 0.999_998_082_812_540_2, 0.999_994_283_890_579_5, 7.924_167_408_753_923e-7, 0.999_998_919_788_860_4, 0.999_998_896_668_808_7]),
            ("1.000001/1.5/Al550", 89.99999, [0.999_552_399_909_841_4, 0.999_528_146_447_404_1, 0.999_534_220_266_535_2, 1.196_391_797_088_105_6e-8, 0.999_540_273_178_622_7, 0.999_535_961_801_513_5]),
            ("2.4/1.5", 30.0, [0.251_175_734_556_533_7, 0.164_292_169_641_755_1, -0.202_556_220_737_384_8, 0.0, 0.207_733_952_099_144_4, 0.208_177_538_651_538_3]),
            ("1.5/0.9999/1.5", 89.0, [0.985_753_393_934_945, 0.967_668_074_427_975_6, 0.963_813_059_579_705_8, 0.0, 0.976_710_734_181_460_3, 0.976_866_766_865_980_1]),
        ];
        for (layers, theta_deg, expected) in cases {
            let r = FlatStack::parse(layers)
                .unwrap()
                .reflect_deg(theta_deg)
                .unwrap();
            let c = r.channel;
            let found = [c.s, c.p, c.re, c.im, c.unpolarised(), r.scalar];
            for (a, b) in found.iter().zip(expected) {
                // z is a sum of terms that cancel.
                assert!((a - b).abs() < 4e-15, "{layers}: {found:?}");
            }
        }
    }

    #[test]
    fn invalid_layers_are_refused() {
        assert!(FlatStack::parse("1.5/Xx").is_err());
        assert!(FlatStack::parse("0").is_err());
        assert!(FlatStack::parse("NaN").is_err());
        assert!(FlatStack::parse("Au550/1.5").is_err());
        assert!(FlatStack::parse("").is_err());
        let stack = FlatStack::parse("1.5").unwrap();
        assert_eq!(stack.reflect(2.0), Err(FlatStackError::Angle));
    }

    #[test]
    fn a_rarer_layer_reflects_totally_whatever_is_below() {
        let glass = Complex::new(1.8, 0.0);
        let stack = FlatStack::new(vec![glass, Complex::new(1.0, 0.0), glass]).unwrap();
        let r = stack.reflect(1.2).unwrap();
        assert!((r.channel.s - 1.0).abs() < 1e-15 && (r.channel.p - 1.0).abs() < 1e-15);
    }
}
