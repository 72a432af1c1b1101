//! Flat layers over each other, exactly: all orders of reflection between them, without
//! interference (layers thicker than the lamp's coherence length) and without absorption inside.
//!
//! Call [`FlatStack::reflect`]. The recursion runs per channel x ∈ {s, p, z} from the bottom,
//! R ← r + t↓ t↑ R / (1 − r↑ R), with z = r_s r_p* and q t_s t_p* as in
//! [`super::polarisation`]. It is what the ray tracer must give on flat shapes.
//!
//! *Conditioning.* Powers are sums of positive terms only: the share that comes back and the share that does not are
//! carried side by side ([`Below`]), cosines within are roots of (1 − s)(1 + s), and every boundary is taken from
//! above, where grazing light keeps its cosine's digits. A layer costs a few roundings. The terms of z may cancel:
//! its error is relative to 1, not to itself.

use nalgebra::Complex;

use super::polarisation::{Boundary, Channel};
use crate::material::tables::FIXED_METALS;

/// Indices from the medium above down to the substrate, n + ik each.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatStack {
    indices: Vec<Complex<f64>>,
}

/// Why a stack cannot be computed.
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
    /// Only the substrate may absorb here.
    #[error("layer {position} absorbs: in this table only the last layer may")]
    AbsorbingLayer {
        /// 1 for the topmost layer.
        position: usize,
    },
    /// The angle is outside [0°, 90°).
    #[error("the angle of incidence must be in [0°, 90°)")]
    Angle,
}

/// What a flat stack reflects at one angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StackReflectance {
    /// Powers of s and p and the complex factor z of U and V.
    pub channel: Channel,
    /// The answer of a computation that knows only unpolarised reflectances.
    pub scalar: f64,
}

impl FlatStack {
    /// From the medium above (first) down to the substrate (last).
    ///
    /// # Errors
    /// Fewer than two media, an index that is not positive, or absorption above the substrate.
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

    /// From the form `1.3/1.5/Au550`: layers top first, under air.
    ///
    /// # Errors
    /// As [`FlatStack::new`], and for a name that is not one of the three fixed metals.
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

    /// Reflectance at the angle of incidence `theta_rad` in the medium above.
    ///
    /// # Errors
    /// An angle that is not in [0°, 90°).
    pub fn reflect(&self, theta_rad: f64) -> Result<StackReflectance, FlatStackError> {
        if !(0.0..std::f64::consts::FRAC_PI_2).contains(&theta_rad) {
            return Err(FlatStackError::Angle);
        }
        let (sin, cos) = theta_rad.sin_cos();
        let above = self.indices[0].re;
        // Cosine in each transparent layer; None from where total reflection keeps light out.
        let mut cosines = vec![cos];
        for index in &self.indices[1..] {
            let s = above * sin / index.re;
            if index.im > 0.0 || s >= 1.0 {
                break;
            }
            cosines.push(((1.0 - s) * (1.0 + s)).sqrt());
        }
        let last = (self.indices.len() - 1).min(cosines.len());
        let mut z = Complex::new(0.0, 0.0);
        let (mut s, mut p, mut scalar) = (Below::NOTHING, Below::NOTHING, Below::NOTHING);
        for i in (0..last).rev() {
            let (here, beyond) = (self.indices[i], self.indices[i + 1]);
            let boundary = Boundary::new(here.re, beyond.re, beyond.im);
            // Powers are the same from below: the boundary is the one and the paths are reversed. Taken
            // from below they would lose digits at grazing, where cos θ above is all that counts.
            let (r, t) = (
                boundary.at(cosines[i]).reflected,
                boundary.at(cosines[i]).refracted,
            );
            let kept = boundary.kept(cosines[i]);
            s = s.under(r.s, t.s, kept.0);
            p = p.under(r.p, t.p, kept.1);
            let kept = 0.5 * (kept.0 + kept.1);
            scalar = scalar.under(r.unpolarised(), t.unpolarised(), kept);
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

/// What lies below a boundary: the share it sends back and the share it keeps, which together are 1.
///
/// Both are carried, because 1 − R loses its digits where R is near 1 (grazing light, layers over a
/// metal) and 1 − r↑ R = t↑ + r↑ (1 − R) needs them.
#[derive(Debug, Clone, Copy)]
struct Below {
    reflected: f64,
    kept: f64,
}

impl Below {
    /// Nothing comes back.
    const NOTHING: Below = Below {
        reflected: 0.0,
        kept: 1.0,
    };

    /// The same under a boundary that reflects `r`, lets `t` through (0 under total reflection and
    /// over a metal) and sends back all but `kept`.
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

    /// The greater of the two shares from the smaller: the roundings of twenty layers add up in both,
    /// and count for less in the smaller.
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
    fn layers_that_make_no_sense_are_refused() {
        assert!(FlatStack::parse("1.5/Xx").is_err());
        assert!(FlatStack::parse("0").is_err());
        assert!(FlatStack::parse("NaN").is_err());
        assert!(FlatStack::parse("Au550/1.5").is_err());
        assert!(FlatStack::parse("").is_err());
        let stack = FlatStack::parse("1.5").unwrap();
        assert_eq!(stack.reflect(2.0), Err(FlatStackError::Angle));
    }

    #[test]
    fn a_rare_layer_reflects_totally_and_what_lies_below_does_not_matter() {
        let glass = Complex::new(1.8, 0.0);
        let stack = FlatStack::new(vec![glass, Complex::new(1.0, 0.0), glass]).unwrap();
        let r = stack.reflect(1.2).unwrap();
        assert!((r.channel.s - 1.0).abs() < 1e-15 && (r.channel.p - 1.0).abs() < 1e-15);
    }
}
