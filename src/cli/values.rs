//! Values of options: whole numbers in a range, and why a value is refused.

use std::error::Error as _;
use std::ffi::OsString;
use std::num::{IntErrorKind, ParseFloatError, ParseIntError};
use std::ops::RangeInclusive;
use std::str::ParseBoolError;

use clap::error::{ContextKind, ContextValue, ErrorKind};

/// A parser of whole numbers in `range`.
pub fn whole<T: TryFrom<i64> + Clone + Send + Sync + 'static>(
    range: RangeInclusive<i64>,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let number = text.trim().parse().ok().filter(|n| range.contains(n));
        number.and_then(|n| T::try_from(n).ok()).ok_or_else(|| {
            format!(
                "expected a whole number from {} to {}",
                range.start(),
                range.end()
            )
        })
    }
}

/// Returns the words of a command line, with a list of numbers that begins with a minus sign as several words: `-20,-10` would
/// else be an option.
pub fn words(line: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut words = Vec::new();
    for word in line {
        let parts: Vec<&str> = word.to_str().unwrap_or_default().split(',').collect();
        let is_list = parts.len() > 1 && parts[0].starts_with('-');
        match is_list && parts.iter().all(|part| part.parse::<f64>().is_ok()) {
            true => words.extend(parts.into_iter().map(OsString::from)),
            false => words.push(word),
        }
    }
    words
}

/// Returns the unit that the name of an option states, as words after *expected a number*.
fn unit_of(option: &str) -> &'static str {
    let name = option.split(' ').next().unwrap_or_default();
    let units = [
        ("-deg", " in degrees"),
        ("-deg-s", " in degrees per second"),
        ("-nm", " in nm"),
        ("-um", " in µm"),
        ("-mm", " in mm"),
        ("-seconds", " in seconds"),
        ("-s", " in seconds"),
    ];
    let ends = units.into_iter().filter(|(end, _)| name.ends_with(end));
    // The longest end: `-deg-s` before `-s`.
    ends.max_by_key(|(end, _)| end.len())
        .map_or("", |(_, unit)| unit)
}

/// Returns the message for an error of the command line: a value that is not a number is refused by what the option
/// expects, everything else in clap's words. `ansi` adds colours.
pub fn message(error: &clap::Error, ansi: bool) -> String {
    let context = |kind: ContextKind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text.as_str()),
        _ => None,
    };
    let refused = (error.kind() == ErrorKind::ValueValidation)
        .then(|| expected(error))
        .flatten()
        .zip(context(ContextKind::InvalidValue))
        .zip(context(ContextKind::InvalidArg));
    match refused {
        Some(((expected, value), option)) => {
            let label = if ansi {
                "\u{1b}[1m\u{1b}[31merror:\u{1b}[0m"
            } else {
                "error:"
            };
            let unit = match expected {
                A_NUMBER => unit_of(option),
                _ => "",
            };
            format!(
                "{label} invalid value '{value}' for '{option}': {expected}{unit}\n\nFor more information, try '--help'.\n"
            )
        }
        None if ansi => error.render().ansi().to_string(),
        None => error.render().to_string(),
    }
}

const A_NUMBER: &str = "expected a number";

/// What an option expects whose value is not a number, a number too large for it, or not true or false.
fn expected(error: &clap::Error) -> Option<&'static str> {
    let source = error.source()?;
    if source.is::<ParseFloatError>() {
        return Some(A_NUMBER);
    }
    if source.is::<ParseBoolError>() {
        return Some("expected true or false");
    }
    match source.downcast_ref::<ParseIntError>()?.kind() {
        IntErrorKind::PosOverflow => Some("the number is too large"),
        IntErrorKind::NegOverflow => Some("the number is too small"),
        _ => Some("expected a whole number from 0"),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::super::{Cli, with_negative_numbers};
    use super::*;

    #[test]
    fn lists_may_have_commas_or_blanks_and_begin_with_a_minus_sign() {
        let line = |text: &str| words(text.split(' ').map(OsString::from));
        let read = |text: &str| {
            let command = with_negative_numbers(Cli::command());
            let matches = command.try_get_matches_from(line(text)).unwrap();
            let (_, contrast) = matches.subcommand().unwrap();
            let values = contrast.get_many::<f64>("theta_c_deg").unwrap();
            values.copied().collect::<Vec<_>>()
        };
        let wanted = [-20.0, -10.5, 0.0];
        for text in ["-20,-10.5,0", "-20 -10.5 0"] {
            assert_eq!(
                read(&format!("ridged contrast --theta-c-deg {text}")),
                wanted
            );
        }
        let plain = ["-v,x", "a,b", "5,10", "-o"];
        assert_eq!(line(&plain.join(" ")), plain);
    }

    #[test]
    fn a_value_that_is_not_a_number_is_refused_by_what_is_expected() {
        let said = |words: &[&str]| {
            let line = with_negative_numbers(Cli::command());
            let refused = line.try_get_matches_from([&["ridged"], words].concat());
            message(&refused.unwrap_err(), false)
        };
        for (words, wanted) in [
            (
                &["scan", "--preset", "full", "--sample", "s", "--eta", "x"][..],
                "invalid value 'x' for '--eta <N>': expected a number\n",
            ),
            (
                &["scan", "--preset", "full", "--sample", "s", "--eta", ""],
                "expected a number\n",
            ),
            (
                &["fit", "series", "--bootstrap", "-5"],
                "invalid value '-5' for '--bootstrap <N>': expected a whole number from 20 to 100000\n",
            ),
            (
                &["serve", "--seed", "1.5"],
                "expected a whole number from 0\n",
            ),
            (
                &["serve", "--seed", "99999999999999999999"],
                "the number is too large\n",
            ),
            (&["serve", "--sed", "1"], "--seed"),
            (
                &["contrast", "--theta-r-deg", "0.17rad"],
                "expected a number in degrees\n",
            ),
            (
                &["rig", "jog", "phi_s", "--speed-deg-s", "slow"],
                "expected a number in degrees per second\n",
            ),
        ] {
            let said = said(words);
            assert!(said.contains(wanted), "{wanted} is not in: {said}");
        }
    }
}
