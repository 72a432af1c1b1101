//! Parts of a run that machines compute apart: which pieces of the work belong to which part.

use std::fmt;
use std::str::FromStr;

/// Part of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// 1 to `of`.
    pub number: u64,
    /// Number of parts.
    pub of: u64,
}

impl Shard {
    /// The whole run.
    pub const WHOLE: Shard = Shard { number: 1, of: 1 };

    /// Whether the piece of work with this index, from 0, belongs to it. Neighbours belong to different shards, since they
    /// often cost alike.
    #[must_use]
    pub const fn has(self, index: u64) -> bool {
        index % self.of == self.number - 1
    }
}

/// A text that is not a shard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected K/N with K from 1 to N, for example 2/4")]
pub struct NotAShard;

impl FromStr for Shard {
    type Err = NotAShard;

    fn from_str(text: &str) -> Result<Self, NotAShard> {
        let parts = text
            .split_once('/')
            .and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
        match parts {
            Some((number, of)) if 1 <= number && number <= of => Ok(Shard { number, of }),
            _ => Err(NotAShard),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shard_is_read_as_it_is_written_and_others_are_refused() {
        for text in ["1/1", "2/4", "18446744073709551615/18446744073709551615"] {
            assert_eq!(text.parse::<Shard>().unwrap().to_string(), text);
        }
        for text in ["", "1", "0/2", "3/2", "1/0", "-1/2", "1/2/3", "a/b", "1 /2"] {
            assert_eq!(text.parse::<Shard>(), Err(NotAShard), "{text}");
        }
    }

    #[test]
    fn every_piece_of_the_work_belongs_to_one_shard() {
        for of in 1..6 {
            for index in 0..20 {
                let owners = (1..=of).filter(|number| {
                    Shard {
                        number: *number,
                        of,
                    }
                    .has(index)
                });
                assert_eq!(owners.count(), 1, "{index} of {of}");
            }
        }
    }
}
