//! The canonical form of a JSON document and the hash over it.
//!
//! The form is that of RFC 8785 (JSON Canonicalization Scheme): no blanks, the keys of objects sorted by their UTF-16 code
//! units, numbers as ECMAScript writes them. So any program with a library for it can check a report.

use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::wording::hex;

/// Key of the hash.
const SEAL: &str = "sha256";

/// The result of a check.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Check {
    /// The document has the hash that it states.
    Unchanged {
        /// The hash.
        sha256: String,
    },
    /// The document was changed after it was made.
    Changed {
        /// The hash that it states.
        stated: String,
        /// The hash that it has.
        actual: String,
    },
    /// The document states no hash.
    NoHash,
}

/// Adds the hash over the canonical form of an object to it.
pub(super) fn sealed(mut document: Value) -> Value {
    let sha256 = hash_of(&document);
    document[SEAL] = Value::String(sha256);
    document
}

/// Compares the hash that a document states with the one that it has.
#[must_use]
pub fn check(document: &Value) -> Check {
    let Some(stated) = document.get(SEAL).and_then(Value::as_str) else {
        return Check::NoHash;
    };
    let stated = stated.to_owned();
    let mut rest = document.clone();
    if let Some(fields) = rest.as_object_mut() {
        fields.remove(SEAL);
    }
    let actual = hash_of(&rest);
    match actual == stated {
        true => Check::Unchanged { sha256: stated },
        false => Check::Changed { stated, actual },
    }
}

fn hash_of(document: &Value) -> String {
    hex(&Sha256::digest(canonical(document)))
}

/// Returns the canonical form.
///
/// # Panics
/// Never: the keys of a JSON document are texts, and its numbers are finite.
#[must_use]
pub fn canonical(document: &Value) -> String {
    serde_json_canonicalizer::to_string(document).expect("a JSON document has a canonical form")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_are_those_of_rfc_8785() {
        // Appendix B of the RFC: bits of the double, and its text.
        for (bits, text) in [
            (0x0000_0000_0000_0000, "0"),
            (0x8000_0000_0000_0000, "0"),
            (0x0000_0000_0000_0001, "5e-324"),
            (0x8000_0000_0000_0001, "-5e-324"),
            (0x7fef_ffff_ffff_ffff, "1.7976931348623157e+308"),
            (0xffef_ffff_ffff_ffff, "-1.7976931348623157e+308"),
            (0x4340_0000_0000_0000, "9007199254740992"),
            (0xc340_0000_0000_0000, "-9007199254740992"),
            (0x4430_0000_0000_0000, "295147905179352830000"),
            (0x44b5_2d02_c7e1_4af5, "9.999999999999997e+22"),
            (0x44b5_2d02_c7e1_4af6, "1e+23"),
            (0x44b5_2d02_c7e1_4af7, "1.0000000000000001e+23"),
            (0x444b_1ae4_d6e2_ef4e, "999999999999999700000"),
            (0x444b_1ae4_d6e2_ef4f, "999999999999999900000"),
            (0x444b_1ae4_d6e2_ef50, "1e+21"),
            (0x3eb0_c6f7_a0b5_ed8c, "9.999999999999997e-7"),
            (0x3eb0_c6f7_a0b5_ed8d, "0.000001"),
            (0x41b3_de43_5555_5553, "333333333.3333332"),
            (0x41b3_de43_5555_5557, "333333333.33333343"),
            (0xbecb_f647_612f_3696, "-0.0000033333333333333333"),
            (0x4314_3ff3_c1cb_0959, "1424953923781206.2"),
        ] {
            assert_eq!(canonical(&json!(f64::from_bits(bits))), text);
        }
    }

    #[test]
    fn keys_are_sorted_by_their_utf_16_units_and_texts_escaped() {
        // Section 3.2.3 of the RFC.
        let document = json!({
            "\u{20ac}": "Euro Sign",
            "\r": "Carriage Return",
            "\u{fb33}": "Hebrew Letter Dalet With Dagesh",
            "1": [1.0, true, null],
            "\u{1f600}": "Emoji: Grinning Face",
            "\u{80}": "Control",
            "\u{f6}": "Latin Small Letter O With Diaeresis",
        });
        assert_eq!(
            canonical(&document),
            "{\"\\r\":\"Carriage Return\",\"1\":[1,true,null],\"\u{80}\":\"Control\",\
             \"ö\":\"Latin Small Letter O With Diaeresis\",\"€\":\"Euro Sign\",\
             \"😀\":\"Emoji: Grinning Face\",\"\u{fb33}\":\"Hebrew Letter Dalet With Dagesh\"}"
        );
    }

    #[test]
    fn a_changed_document_does_not_have_its_hash() {
        let made = sealed(json!({"theta_r_deg": 10.013_4, "note": "ä"}));
        assert!(matches!(check(&made), Check::Unchanged { .. }));
        // Another layout and order of the same content has the same hash.
        let text = serde_json::to_string_pretty(&made).unwrap();
        let read: Value = serde_json::from_str(&text).unwrap();
        assert!(matches!(check(&read), Check::Unchanged { .. }));
        let mut changed = made.clone();
        changed["theta_r_deg"] = json!(10.013_5);
        assert!(matches!(check(&changed), Check::Changed { .. }));
        assert_eq!(check(&json!({"theta_r_deg": 10.0})), Check::NoHash);
        assert_eq!(check(&json!([1])), Check::NoHash);
    }
}
