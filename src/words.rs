//! Enumerations of words: each word is written once, for files, requests, answers, the database and messages.

/// Defines an enumeration whose variants are words: with its list, the word of a variant and the variant of a word.
macro_rules! words {
    // A word is a token: utoipa does not find a literal that a macro has matched as one.
    ($(#[$meta:meta])* pub enum $name:ident { $($(#[$of:meta])* $variant:ident = $word:tt,)+ }) => {
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
        $(#[$meta])*
        pub enum $name { $($(#[$of])* #[serde(rename = $word)] $variant,)+ }

        impl $name {
            /// All of them, in the order of their definition.
            pub const ALL: [$name; [$($word),+].len()] = [$($name::$variant),+];

            /// The word used in files, requests, messages and the database.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self { $($name::$variant => $word),+ }
            }

            /// What a word names, if it is one of the words.
            #[must_use]
            pub fn from_word(word: &str) -> Option<Self> {
                Self::ALL.into_iter().find(|one| one.as_str() == word)
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(self.as_str())
            }
        }
    };
}
pub(crate) use words;

#[cfg(test)]
mod tests {
    words! {
        /// Two words.
        #[derive(utoipa::ToSchema)]
        pub enum Place {
            /// One word.
            Here = "here",
            /// Two parts.
            FarAway = "far-away",
        }
    }

    #[test]
    fn words_and_variants_agree_with_serde_and_the_schema() {
        for place in Place::ALL {
            assert_eq!(Place::from_word(place.as_str()), Some(place));
            assert_eq!(serde_json::to_value(place).unwrap(), place.to_string());
        }
        assert_eq!(Place::from_word("FarAway"), None);
        let schema = <Place as utoipa::PartialSchema>::schema();
        let schema = serde_json::to_value(schema).unwrap();
        assert_eq!(schema["enum"], serde_json::json!(["here", "far-away"]));
    }
}
