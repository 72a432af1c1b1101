//! Whether the numbers of a table have decimals, or thousands in groups.

use super::text::{are_thousands, number};

/// Columns whose notation is judged for itself; all columns of a wider table are heights and have one
/// notation.
pub(super) const GROUPED_COLUMNS: usize = 8;
/// Least number of words such as 17,261 that may group thousands: by chance, few decimals have three
/// digits, the last of them not 0.
const GROUPED_MIN: usize = 20;

/// Evidence that a comma or point in the numbers groups thousands and is not a decimal mark.
#[derive(Default)]
pub(super) struct Groupings {
    /// Words with thousands in groups, at a comma and at a point, and the first of them.
    grouped: [(usize, String); 2],
    /// Whether other words have the mark.
    is_decimal: [bool; 2],
    /// Whether whole numbers other than 0 have neither mark.
    has_whole: bool,
}

impl Groupings {
    pub(super) fn add(&mut self, word: &str) {
        let mut is_whole = true;
        for (n, mark) in [',', '.'].into_iter().enumerate() {
            if !word.contains(mark) {
                continue;
            }
            is_whole = false;
            if self.is_decimal[n] {
                continue;
            }
            match are_thousands(word, |c| c == mark) {
                true => {
                    let (count, first) = &mut self.grouped[n];
                    if *count == 0 {
                        *first = word.to_owned();
                    }
                    *count += 1;
                }
                false => self.is_decimal[n] = true,
            }
        }
        self.has_whole |= is_whole && number(word).is_some_and(|x| x != 0.0 && x.fract() == 0.0);
    }

    /// A word that may be a number of thousands.
    pub(super) fn doubtful(&self) -> Option<&str> {
        let both = self.grouped.iter().zip(self.is_decimal);
        both.filter(|((count, _), is_decimal)| *count >= GROUPED_MIN && !is_decimal)
            .map(|((_, first), _)| first.as_str())
            .next()
            .filter(|_| self.has_whole)
    }
}
