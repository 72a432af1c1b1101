//! Sums in fixed point, whose order does not matter, and their text in files.
//!
//! What goes in is rounded once ([`to_fixed`]); adding is exact from there on, so threads, shards and stops
//! give the same bits.

/// 2^-82 as the unit: sums below 2^43 fit and rounding is far below an f64's.
const UNIT_BITS: (i32, i32) = (20, 62);

/// Rounded towards zero.
#[inline]
pub(super) fn to_fixed(x: f64) -> i128 {
    let scaled = x * f64::from(1u32 << UNIT_BITS.0);
    let whole = scaled as i64;
    let rest = ((scaled - whole as f64) * (1u64 << UNIT_BITS.1) as f64) as i64;
    (i128::from(whole) << UNIT_BITS.1) + i128::from(rest)
}

/// The nearest f64.
#[inline]
pub(super) fn from_fixed(x: i128) -> f64 {
    x as f64 * 2f64.powi(-(UNIT_BITS.0 + UNIT_BITS.1))
}

/// A count and exact sums in words: the count decimal, the sums hexadecimal.
pub(super) fn text_of<'a>(count: u64, numbers: impl Iterator<Item = &'a i128>) -> String {
    use std::fmt::Write;
    let mut text = count.to_string();
    for x in numbers {
        let sign = if *x < 0 { "-" } else { "" };
        write!(text, " {sign}{:x}", x.unsigned_abs()).expect("a String takes everything");
    }
    text
}

/// Reads back what [`text_of`] wrote; `None` where it did not.
pub(super) fn numbers_of(text: &str) -> Option<(u64, Vec<i128>)> {
    let mut words = text.split(' ');
    let count = words.next()?.parse().ok()?;
    let numbers = words
        .map(|w| i128::from_str_radix(w, 16).ok())
        .collect::<Option<Vec<_>>>()?;
    Some((count, numbers))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fixed_point_keeps_what_an_f64_has() {
        for x in [0.0, 1.0, -1.0, 1e-9, 0.1, -123_456.789, 3e10] {
            assert!((from_fixed(to_fixed(x)) - x).abs() <= 2f64.powi(-80) + x.abs() * 1e-15);
        }
    }
}
