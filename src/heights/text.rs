//! Reads numbers in the notations that programs write.

use crate::wording::encoding::with_plain_minus;

/// Characters that group the digits of a number in thousands and are no decimal mark.
pub(super) const GROUPING: [char; 6] = [
    '\u{a0}', '\u{202f}', '\u{2009}', '\u{2007}', '\'', '\u{2019}',
];

/// A number with a decimal point or comma; if both occur, the later one is the decimal mark. Blanks
/// that do not break a line, and apostrophes, may group thousands.
pub(super) fn number(word: &str) -> Option<f64> {
    let word = word.trim();
    if word.contains(GROUPING) {
        return are_thousands(word, |c| GROUPING.contains(&c))
            .then(|| number(&word.replace(GROUPING, "")))?;
    }
    let plain = match (word.rfind(','), word.rfind('.')) {
        (Some(comma), Some(point)) if comma > point => word.replace('.', "").replace(',', "."),
        (Some(_), Some(_)) => word.replace(',', ""),
        (Some(_), None) => word.replace(',', "."),
        _ => return finite(word),
    };
    finite(&plain)
}

/// Whether marks part the digits before the decimals in groups of three, the first of which is
/// shorter or equal and does not begin with 0.
pub(super) fn are_thousands(word: &str, is_mark: impl Fn(char) -> bool) -> bool {
    let plain = with_plain_minus(word);
    let whole = plain.trim_start_matches(['+', '-']);
    let last = whole.rfind(&is_mark).unwrap_or_default();
    let end = whole[last..].find(['.', ',']).filter(|at| *at > 0);
    let whole = end.map_or(whole, |at| &whole[..last + at]);
    let mut groups = whole.split(is_mark);
    let digits = |group: &str| group.bytes().all(|b| b.is_ascii_digit());
    let first = groups.next().unwrap_or_default();
    let begins = (1..=3).contains(&first.len()) && digits(first) && !first.starts_with('0');
    begins && groups.all(|group| group.len() == 3 && digits(group))
}

fn finite(word: &str) -> Option<f64> {
    let plain = with_plain_minus(word);
    // Fortran writes the exponent of a double with D.
    let parsed = plain
        .parse()
        .or_else(|_| plain.replace(['D', 'd'], "e").parse());
    parsed.ok().filter(|x: &f64| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_in_the_notations_that_programs_write() {
        for (word, value) in [
            ("17'260.6", 17_260.6),
            ("17\u{202f}260,6", 17_260.6),
            ("\u{2212}1\u{a0}234\u{a0}567", -1_234_567.0),
            ("1.234,5", 1234.5),
            ("1,234.5", 1234.5),
            ("1.73D+01", 17.3),
        ] {
            assert_eq!(number(word), Some(value), "{word}");
        }
        for word in ["17'26", "1'2345", "0'123", "1 234", "12:30", "D", "e5"] {
            assert_eq!(number(word), None, "{word}");
        }
    }
}
