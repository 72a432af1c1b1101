//! Numbers in messages, shortened.

/// Shortens very large and very small numbers in a text: 1e300 written out has 301 digits. Whole numbers of up to 19
/// digits are counts and ids and stay as they are.
#[must_use]
pub fn readable(text: &str) -> String {
    let mut out = String::with_capacity(text.len().min(1 << 12));
    let mut rest = text;
    while let Some(start) = rest.find(|c: char| c.is_ascii_digit()) {
        let (before, from) = rest.split_at(start);
        let whole = from.bytes().take_while(u8::is_ascii_digit).count();
        let decimals = match from[whole..].strip_prefix('.') {
            Some(more) => more.bytes().take_while(u8::is_ascii_digit).count(),
            None => 0,
        };
        let length = match decimals {
            0 => whole,
            _ => whole + 1 + decimals,
        };
        let (number, after) = from.split_at(length);
        // Digits that are part of a word, a hash or a version stay.
        let alone = !before.ends_with(|c: char| c.is_alphanumeric() || "._".contains(c))
            && !after.starts_with(|c: char| c.is_alphanumeric() || c == '_');
        let long = |value: f64| match decimals {
            0 => whole > 19,
            _ => whole > 6 || (value > 0.0 && value < 1e-6),
        };
        out.push_str(before);
        match number.parse::<f64>() {
            Ok(value) if alone && long(value) => out.push_str(&format!("{value:e}")),
            _ => out.push_str(number),
        }
        rest = after;
    }
    out.push_str(rest);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_numbers_with_many_digits_are_shortened() {
        let huge = format!("theta_c = {:.3}° is outside {} … 80", 1e300, -1e20);
        for (text, shortened) in [
            (huge.as_str(), "theta_c = 1e300° is outside -1e20 … 80"),
            ("1234567.5 is wanted", "1.2345675e6 is wanted"),
            (
                "at most 8388608 bytes, 20.5 MB",
                "at most 8388608 bytes, 20.5 MB",
            ),
            (
                "frame 12345678901234567890abc",
                "frame 12345678901234567890abc",
            ),
            ("scan 9007199254740993: no", "scan 9007199254740993: no"),
            ("scan 100000000000000000000: no", "scan 1e20: no"),
            (
                "0.000000000000025 s and 0.000025 s",
                "2.5e-14 s and 0.000025 s",
            ),
            ("0.000000000 µm", "0.000000000 µm"),
            (
                "127.0.0.1:8787 and 2026-03-02T09:00:00.123Z",
                "127.0.0.1:8787 and 2026-03-02T09:00:00.123Z",
            ),
            ("none", "none"),
        ] {
            assert_eq!(readable(text), shortened);
        }
    }
}
