//! Text for people, in one form for all tables and messages: counts with their noun, values with their significant
//! digits, names of quantities ([`names`]), lines as wide as a terminal ([`layout`]), differences between two settings
//! ([`differences`]); and readers that report errors in plain words: JSON ([`json`]), TOML ([`toml_text`]) and tables of
//! spreadsheets ([`sheet`], in the encodings of [`encoding`]).

pub mod differences;
pub mod encoding;
pub mod json;
pub mod layout;
pub mod names;
pub mod numbers;
mod refusal;
pub mod sheet;
pub mod toml_text;
mod values;

use std::ops::RangeInclusive;

/// Returns a count with its noun: `1 frame`, `0 frames`, `12 frames`.
#[must_use]
pub fn counted(count: usize, noun: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{plural}")
}

/// Returns bytes in hexadecimal, two digits each.
#[must_use]
pub fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write as _;
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").expect("a String takes everything");
        text
    })
}

/// Returns three significant digits: in decimals from a thousandth to a million, otherwise as a power of ten.
#[must_use]
pub fn significant(value: f64) -> String {
    rounded(value, 3, -3..=5)
}

/// Returns a share as a percentage with two significant digits: `0.62 %`, `12 %`, `5.0e-7 %`.
#[must_use]
pub fn percent(share: f64) -> String {
    format!("{} %", rounded(100.0 * share, 2, -4..=3))
}

/// Returns `digits` significant digits, in decimals where the power of ten is within `plain`.
fn rounded(value: f64, digits: usize, plain: RangeInclusive<i32>) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let last = digits - 1;
    let scientific = format!("{value:.last$e}");
    // The power after rounding: 0.9999 reads 1.00, not 1.000.
    let power = scientific.split_once('e').and_then(|(_, p)| p.parse().ok());
    match power {
        Some(power) if plain.contains(&power) => {
            let decimals = usize::try_from(last as i32 - power).unwrap_or(0);
            format!("{value:.decimals$}")
        }
        _ => scientific,
    }
}

/// Returns the number of decimals that show two digits of an uncertainty.
#[must_use]
pub fn decimals(uncertainty: f64) -> usize {
    if uncertainty > 0.0 && uncertainty.is_finite() {
        let digits = 1.0 - uncertainty.log10().floor();
        digits.clamp(0.0, 15.0) as usize
    } else {
        4
    }
}

/// Returns a value with this number of decimals, where zero has no sign: `0.000` for −0.0001.
#[must_use]
pub fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|b| matches!(b, b'0' | b'.')) => zero.to_owned(),
        _ => text,
    }
}

/// Returns the same with its sign, also of a positive value: `+0.012`; zero has none.
#[must_use]
pub fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    match text.bytes().any(|b| (b'1'..=b'9').contains(&b)) && value > 0.0 {
        true => format!("+{text}"),
        false => text,
    }
}

/// Returns a time in UTC as people read it: `2026-11-25 14:13:05 UTC`. Another text stays as it is.
#[must_use]
pub fn utc_words(rfc3339: &str) -> String {
    let parts = rfc3339.split_once('T').and_then(|(date, rest)| {
        let clock = rest.strip_suffix('Z')?;
        Some(format!("{date} {} UTC", clock.get(..8)?))
    });
    parts.unwrap_or_else(|| rfc3339.to_owned())
}

/// Returns a stated value with the digits that it was stated with, twelve at most, as a power of ten where these would be many
/// zeros. A value that was converted to another unit and back differs in the sixteenth.
#[must_use]
pub fn stated(value: f64) -> String {
    let value = format!("{value:.11e}").parse().unwrap_or(value);
    match value.abs() {
        0.0 | 1e-4..1e9 => format!("{value}"),
        _ => format!("{value:e}"),
    }
}

/// Returns a coverage factor with up to two decimals: `2`, `2.17`.
#[must_use]
pub fn factor(k: f64) -> String {
    format!("{}", (k * 100.0).round() / 100.0)
}

/// Returns the word of a list that was probably meant by another one: at most two letters or a third of them differ.
#[must_use]
pub fn meant<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    let distance = |k: &&&'a str| strsim::damerau_levenshtein(word, k);
    let nearest = known.iter().min_by_key(distance)?;
    let letters = word.chars().count();
    (distance(&nearest) <= (letters / 3).clamp(1, 2)).then_some(*nearest)
}

/// Returns whether a text shows nothing: every character is a blank, a control character, or one that Unicode shows as
/// nothing (its property Default_Ignorable_Code_Point).
#[must_use]
pub fn is_blank(text: &str) -> bool {
    let is_ignorable = |c| {
        matches!(c, '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{115f}'..='\u{1160}' | '\u{17b4}'..='\u{17b5}'
            | '\u{180b}'..='\u{180f}' | '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2060}'..='\u{206f}'
            | '\u{3164}' | '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{ffa0}' | '\u{fff0}'..='\u{fff8}'
            | '\u{1bca0}'..='\u{1bca3}' | '\u{1d173}'..='\u{1d17a}' | '\u{e0000}'..='\u{e0fff}')
    };
    text.chars()
        .all(|c| c.is_whitespace() || c.is_control() || is_ignorable(c))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_without_a_visible_character_is_blank() {
        for blank in ["", " \u{a0}", "\u{200b}", "\u{2060}\u{feff}", "\t\u{3000}"] {
            assert!(is_blank(blank), "{blank:?}");
        }
        for visible in ["a", "\u{200b}.", "木", "e\u{301}", "👩\u{200d}🔧"] {
            assert!(!is_blank(visible), "{visible:?}");
        }
    }

    #[test]
    fn counts_agree_with_their_nouns() {
        assert_eq!(counted(0, "frame"), "0 frames");
        assert_eq!(counted(1, "frame"), "1 frame");
        assert_eq!(counted(108, "observation"), "108 observations");
    }

    #[test]
    fn zero_has_no_sign_and_times_have_no_milliseconds() {
        assert_eq!(fixed(-0.0001, 3), "0.000");
        assert_eq!(fixed(-0.0011, 3), "-0.001");
        assert_eq!(fixed(-0.4, 0), "0");
        assert_eq!(signed(0.012, 3), "+0.012");
        assert_eq!(signed(-0.012, 3), "-0.012");
        assert_eq!(signed(0.0001, 3), "0.000");
        assert_eq!(
            utc_words("2026-11-25T14:13:05.123Z"),
            "2026-11-25 14:13:05 UTC"
        );
        assert_eq!(utc_words("yesterday"), "yesterday");
    }

    #[test]
    fn stated_values_keep_their_digits() {
        for (value, said) in [
            (0.0, "0"),
            (-12.5, "-12.5"),
            (1e300, "1e300"),
            (5e-18, "5e-18"),
            (12.000_000_000_000_002, "12"),
            (10.062_5, "10.0625"),
        ] {
            assert_eq!(stated(value), said);
        }
        assert_eq!([0.038, 0.1, 12.0, 0.0].map(decimals), [3, 2, 0, 4]);
    }

    #[test]
    fn a_coverage_factor_has_two_decimals_at_most() {
        assert_eq!(
            [2.0, 2.5, 2.168, 4.527].map(factor),
            ["2", "2.5", "2.17", "4.53"]
        );
    }

    #[test]
    fn values_have_the_digits_that_mean_something() {
        for (value, said) in [
            (0.0, "0"),
            (1.179, "1.18"),
            (0.9999, "1.00"),
            (9.996, "10.0"),
            (81_234.4, "81234"),
            (-0.012_34, "-0.0123"),
            (8.1e9, "8.10e9"),
            (1e300, "1.00e300"),
            (5e-18, "5.00e-18"),
            (f64::INFINITY, "inf"),
        ] {
            assert_eq!(significant(value), said);
        }
        for (share, said) in [
            (0.0, "0 %"),
            (0.0061, "0.61 %"),
            (0.125, "12 %"),
            (1e-6, "0.00010 %"),
            (5e-9, "5.0e-7 %"),
        ] {
            assert_eq!(percent(share), said);
        }
    }
}
