//! Missing points and readings, in all forms in which programs write them: words, and numbers that
//! are neither heights nor readings.

use crate::wording::{counted, significant};

/// Words for a missing point, in lower case.
const WORDS: [&str; 19] = [
    "bad",
    "na",
    "n/a",
    "null",
    "nul",
    "none",
    "nil",
    "invalid",
    "missing",
    "void",
    "masked",
    "nodata",
    "no data",
    "undef",
    "undefined",
    "over",
    "ovr",
    "out of range",
    "not measured",
];
/// Numbers that programs write for a missing point.
const NUMBERS: [f64; 16] = [
    -999.0,
    -9999.0,
    -99_999.0,
    -999_999.0,
    999.0,
    9999.0,
    99_999.0,
    999_999.0,
    -32_768.0,
    32_767.0,
    65_535.0,
    -2_147_483_648.0,
    2_147_483_647.0,
    4_294_967_295.0,
    16_777_215.0,
    -1e10,
];
/// Larger values are not heights, whatever the unit.
const BEYOND: f64 = 1e30;
/// Least distance of such a number from all others, as a fraction of their range.
const OFF: f64 = 0.3;
/// The same for any other number, which must also occur more than once.
const FAR_OFF: f64 = 10.0;
/// Largest fraction of missing points: a value of more points is a height.
const SHARE_MAX: f64 = 1.0 / 3.0;
/// The same for zeros, which a plane between towers also has.
const ZEROS_MAX: f64 = 0.1;

/// What the numbers are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Heights of a surface.
    Heights,
    /// Readings of scattered light: zeros, and a peak that occurs twice, are measured.
    Readings,
}

/// Whether a word marks a missing point.
pub(crate) fn is_mark(word: &str) -> bool {
    let word = word.trim().to_lowercase();
    // Blank, or only marks, as in `--`, `***` and `?`.
    if !word.contains(char::is_alphanumeric) {
        return true;
    }
    let unsigned = word.trim_start_matches(['-', '+']);
    // What C prints for numbers that are not finite: `nan(ind)`, `1.#QNAN0`; and the errors of
    // spreadsheets in any language: `#N/A`, `#NV`, `#DIV/0!`.
    let is_error = |start: &str| unsigned.starts_with(start) && !unsigned.contains(' ');
    WORDS.contains(&word.as_str())
        || ["nan(", "1.#", "#"].into_iter().any(is_error)
        || unsigned.parse().is_ok_and(|x: f64| !x.is_finite())
}

/// The lowest or the highest number.
struct End {
    value: f64,
    count: usize,
    /// The nearest other number.
    next: f64,
}

/// Replaces numbers that mark missing points by NaN: `marks` (stated in the file), numbers larger
/// than any height, and lowest or highest numbers far from all others. Returns notes that name
/// them.
pub(crate) fn mark(heights: &mut [f64], marks: &[f64], kind: Kind) -> Vec<String> {
    let mut notes = Vec::new();
    let noun = match kind {
        Kind::Heights => "height",
        Kind::Readings => "reading",
    };
    for h in heights.iter_mut() {
        let stated = marks.iter().any(|m| (*h - m).abs() <= 1e-6 * m.abs());
        if stated || h.abs() >= BEYOND {
            *h = f64::NAN;
        }
    }
    // Both ends may have one mark, and another one behind it.
    for _ in 0..4 {
        let count = heights.len();
        let (low, high) = (end(heights, 1.0), end(heights, -1.0));
        let is_mark = |end: &End, other: &End| {
            let (off, range) = ((end.value - end.next).abs(), (end.next - other.value).abs());
            let share = end.count as f64 / count as f64;
            let times = match end.value {
                v if NUMBERS.contains(&v) && share <= SHARE_MAX => OFF,
                _ if kind == Kind::Readings => return false,
                0.0 if share <= ZEROS_MAX => 1.0,
                v if v != 0.0 && end.count > 1 && share <= SHARE_MAX => FAR_OFF,
                _ => return false,
            };
            range > 0.0 && off > times * range
        };
        let (Some(low), Some(high)) = (low, high) else {
            break;
        };
        let (end, others) = match (is_mark(&low, &high), is_mark(&high, &low)) {
            (true, _) => (&low, [low.next, high.value]),
            (_, true) => (&high, [low.value, high.next]),
            _ => break,
        };
        notes.push(format!(
            "{} of {} {} taken as missing: all others range from {} to {} in the file's unit",
            counted(end.count, noun),
            end.value,
            if end.count == 1 { "is" } else { "are" },
            significant(others[0]),
            significant(others[1])
        ));
        let value = end.value;
        for h in heights.iter_mut().filter(|h| **h == value) {
            *h = f64::NAN;
        }
    }
    notes
}

/// The lowest number (`sign` 1) or the highest (−1), if there are two different ones.
fn end(heights: &[f64], sign: f64) -> Option<End> {
    let (mut value, mut next, mut count) = (f64::INFINITY, f64::INFINITY, 0);
    for h in heights.iter().filter(|h| !h.is_nan()).map(|h| sign * h) {
        if h < value {
            (next, value, count) = (value, h, 1);
        } else if h == value {
            count += 1;
        } else {
            next = next.min(h);
        }
    }
    next.is_finite().then_some(End {
        value: sign * value,
        count,
        next: sign * next,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sawtooth from 0 to 17 with some of these numbers.
    fn with(numbers: &[f64], scale: f64, offset: f64) -> Vec<f64> {
        let mut heights: Vec<f64> = (0..3000)
            .map(|n| offset + scale * f64::from(n % 101))
            .collect();
        for (n, h) in heights.iter_mut().step_by(97).enumerate() {
            if !numbers.is_empty() {
                *h = numbers[n % numbers.len()];
            }
        }
        heights
    }

    #[test]
    fn numbers_that_mark_missing_points_are_missing_and_heights_are_not() {
        for numbers in [
            &[-9999.0][..],
            &[1e38],
            &[f64::from(f32::MAX), -f64::from(f32::MAX)],
            &[-32768.0],
            &[1.701_41e38],
            &[-9999.0, 1e38],
            &[-1e5],
            &[f64::INFINITY],
        ] {
            let mut heights = with(numbers, 0.17, 0.0);
            mark(&mut heights, &[], Kind::Heights);
            let missing = heights.iter().filter(|h| h.is_nan()).count();
            assert_eq!(missing, 31, "{numbers:?}");
        }
        // In nanometres a mark is among numbers of its size; zeros are away from an offset.
        for (number, scale, offset) in [
            (-9999.0, 170.0, 0.0),
            (65535.0, 170.0, 100.0),
            (0.0, 10.0, 30_000.0),
        ] {
            let mut heights = with(&[number], scale, offset);
            let notes = mark(&mut heights, &[], Kind::Heights);
            assert_eq!(
                heights.iter().filter(|h| h.is_nan()).count(),
                31,
                "{number}"
            );
            assert!(
                notes.len() == 1 && notes[0].contains("31 heights of"),
                "{notes:?}"
            );
        }
        // A mark stated in the file applies at any value.
        let mut heights = with(&[], 1.0, 0.0);
        assert!(mark(&mut heights, &[50.0], Kind::Heights).is_empty());
        assert!(heights[50].is_nan() && heights[51] == 51.0);
        // Isolated spikes, a step between two heights, and towers on a plane are heights.
        let mut spike = with(&[], 0.17, 0.0);
        spike[7] = 300.0;
        let steps: Vec<f64> = (0..100)
            .map(|n| if n % 5 == 0 { 65535.0 } else { 0.0 })
            .collect();
        let towers: Vec<f64> = (0..100)
            .map(|n| {
                if n % 5 == 0 {
                    9.0 + 0.01 * f64::from(n)
                } else {
                    0.0
                }
            })
            .collect();
        for heights in [with(&[], 0.17, -3.0), spike, steps, towers] {
            let mut marked = heights.clone();
            assert!(mark(&mut marked, &[], Kind::Heights).is_empty());
            assert_eq!(marked, heights);
        }
    }

    #[test]
    fn words_for_missing_points_are_distinguished_from_numbers_and_names() {
        for word in [
            "",
            "NaN",
            "Bad",
            "BAD",
            "#N/A",
            "-1.#IND",
            "inf",
            "-",
            "***",
            "No Data",
            "*****",
            "?",
            "#####",
            "#DIV/0!",
            "#WERT!",
            "-nan(0x8000000000000)",
            "1.#QNAN0",
            "-Infinity",
            "OVER",
        ] {
            assert!(is_mark(word), "{word}");
        }
        for word in [
            "x", "1.5", "height", "0", "name", "nano", "info", "# height", "3*4",
        ] {
            assert!(!is_mark(word), "{word}");
        }
    }
}
