//! Order-independent sums in fixed point, and their text in files.
//!
//! Each summand is rounded once ([`to_fixed`]); additions are exact after that, so threads, shards
//! and stops give the same bits.

use std::fmt::Write;

/// The unit is 2^-82: sums below 2^43 fit, and rounding is far below that of an f64.
const UNIT_BITS: (i32, i32) = (20, 62);

/// Rounds towards zero.
#[inline]
pub(in crate::trace) fn to_fixed(x: f64) -> i128 {
    let scaled = x * f64::from(1u32 << UNIT_BITS.0);
    let whole = scaled as i64;
    let rest = ((scaled - whole as f64) * (1u64 << UNIT_BITS.1) as f64) as i64;
    (i128::from(whole) << UNIT_BITS.1) + i128::from(rest)
}

/// The nearest f64.
#[inline]
pub(in crate::trace) fn from_fixed(x: i128) -> f64 {
    x as f64 * 2f64.powi(-(UNIT_BITS.0 + UNIT_BITS.1))
}

/// A sum in the same unit, below 2^108, in two's complement: squares and products of a batch's
/// million photons over any number of batches exceed an `i128`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(in crate::trace) struct Wide([u64; 3]);

/// A stored [`Wide`]: zeroed memory needs neither time nor memory pages until it is used.
pub(in crate::trace) type Resting = [u64; 3];

impl Wide {
    /// Converts from the stored form.
    #[inline]
    pub fn of(words: Resting) -> Self {
        Wide(words)
    }

    /// Converts to the stored form.
    #[inline]
    pub fn resting(self) -> Resting {
        self.0
    }

    /// Adds a number, rounded towards zero.
    #[inline]
    pub fn add(&mut self, x: f64) {
        let x = to_fixed(x);
        let sign = (x >> 127) as u64;
        self.join(&Wide([x as u64, (x >> 64) as u64, sign]));
    }

    /// Adds another sum.
    #[inline]
    pub fn join(&mut self, other: &Wide) {
        let mut carry = false;
        for (a, b) in self.0.iter_mut().zip(other.0) {
            let (sum, first) = a.overflowing_add(b);
            let (sum, second) = sum.overflowing_add(u64::from(carry));
            (*a, carry) = (sum, first | second);
        }
    }

    /// The nearest f64 or its neighbour.
    #[inline]
    pub fn value(&self) -> f64 {
        let (negative, Wide([low, middle, high])) = self.magnitude();
        let below = (u128::from(middle) << 64 | u128::from(low)) as f64;
        let size = (below + high as f64 * 2f64.powi(128)) * 2f64.powi(-(UNIT_BITS.0 + UNIT_BITS.1));
        if negative { -size } else { size }
    }

    /// Whether it is negative, and its magnitude.
    #[inline]
    fn magnitude(self) -> (bool, Wide) {
        let negative = self.0[2] >> 63 == 1;
        (negative, if negative { self.negated() } else { self })
    }

    fn negated(self) -> Wide {
        let mut sum = Wide(self.0.map(|word| !word));
        sum.join(&Wide([1, 0, 0]));
        sum
    }
}

/// A count and exact sums as words: the count in decimal, the sums in hexadecimal.
pub(in crate::trace) struct Text(String);

impl Text {
    /// Begins with the count.
    pub fn of(count: u64) -> Self {
        Text(count.to_string())
    }

    /// Appends signed sums.
    pub fn sums<'a>(mut self, numbers: impl Iterator<Item = &'a i128>) -> Self {
        for x in numbers {
            let sign = if *x < 0 { "-" } else { "" };
            write!(self.0, " {sign}{:x}", x.unsigned_abs()).expect(ANY);
        }
        self
    }

    /// Appends wide sums.
    pub fn wide<'a>(mut self, numbers: impl IntoIterator<Item = &'a Wide>) -> Self {
        for sum in numbers {
            let (negative, Wide([low, middle, high])) = sum.magnitude();
            let sign = if negative { "-" } else { "" };
            let below = u128::from(middle) << 64 | u128::from(low);
            match high {
                0 => write!(self.0, " {sign}{below:x}"),
                _ => write!(self.0, " {sign}{high:x}{below:032x}"),
            }
            .expect(ANY);
        }
        self
    }

    /// Returns the text.
    pub fn finish(self) -> String {
        self.0
    }
}

const ANY: &str = "writing to a String cannot fail";

/// Reads the words that [`Text`] wrote, in order; `None` if they are invalid.
pub(in crate::trace) struct Words<'a>(std::str::Split<'a, char>);

impl<'a> Words<'a> {
    /// Reads the count and returns the remaining words.
    pub fn of(text: &'a str) -> Option<(u64, Self)> {
        let mut words = text.split(' ');
        let count = words.next()?.parse().ok()?;
        Some((count, Words(words)))
    }

    /// Reads `count` sums.
    pub fn sums(&mut self, count: usize) -> Option<Vec<i128>> {
        (0..count)
            .map(|_| i128::from_str_radix(self.0.next()?, 16).ok())
            .collect()
    }

    /// Reads `count` wide sums.
    pub fn wide(&mut self, count: usize) -> Option<Vec<Wide>> {
        (0..count)
            .map(|_| {
                let word = self.0.next()?;
                let (negative, word) = match word.strip_prefix('-') {
                    Some(size) => (true, size),
                    None => (false, word),
                };
                let (high, below) = match word.len().checked_sub(32) {
                    Some(at) if at > 0 => word.split_at_checked(at)?,
                    _ => ("0", word),
                };
                let below = u128::from_str_radix(below, 16).ok()?;
                let high = u64::from_str_radix(high, 16).ok()?;
                let size = Wide([below as u64, (below >> 64) as u64, high]);
                Some(if negative { size.negated() } else { size })
            })
            .collect()
    }

    /// Checks that no word is left.
    pub fn end(mut self) -> Option<()> {
        self.0.next().is_none().then_some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fixed_point_keeps_the_digits_of_an_f64() {
        for x in [0.0, 1.0, -1.0, 1e-9, 0.1, -123_456.789, 3e10] {
            assert!((from_fixed(to_fixed(x)) - x).abs() <= 2f64.powi(-80) + x.abs() * 1e-15);
        }
    }

    #[test]
    fn wide_sums_hold_squares_of_any_run_and_round_trip_as_text() {
        // A hundred million million photons in batches of a million, all their light in one bin.
        let (batch, batches) = (2f64.powi(20), 10_000_000u64);
        let mut one = Wide::default();
        one.add(batch * batch);
        let (mut all, mut power, mut left) = (Wide::default(), one, batches);
        while left > 0 {
            if left & 1 == 1 {
                all.join(&power);
            }
            let twice = power;
            power.join(&twice);
            left >>= 1;
        }
        assert_eq!(all.value(), batch * batch * batches as f64);
        let mut few = Wide::default();
        for x in [0.25, 1e-9, 3.0] {
            few.add(x);
        }
        assert!((few.value() - 3.250_000_001).abs() < 1e-15);
        // Products may be negative, and their sum far below the range of 128 bits.
        let mut below = all.negated();
        below.add(-2.5);
        assert_eq!(below.value(), -all.value());
        let mut back = below;
        back.join(&all);
        assert_eq!(back.value(), -2.5);
        let mut shifting = Wide::default();
        for x in [1.5, -4.0, 1.0] {
            shifting.add(x);
        }
        assert_eq!(shifting.value(), -1.5);
        let sums = [0, -5, i128::MAX];
        let text = Text::of(7)
            .sums(sums.iter())
            .wide([all, few, below, shifting].iter())
            .finish();
        let (count, mut words) = Words::of(&text).unwrap();
        assert_eq!(
            (count, words.sums(3), words.wide(4)),
            (
                7,
                Some(sums.to_vec()),
                Some(vec![all, few, below, shifting])
            )
        );
        assert!(words.end().is_some());
        for damaged in [
            "",
            "x",
            "7 g",
            "7 --5",
            "7 ä000000000000000000000000000000000",
        ] {
            let read = Words::of(damaged).and_then(|(_, mut words)| words.wide(1));
            assert_eq!(read, None, "{damaged}");
        }
    }
}
