//! Units stated in the names of a table's columns.
//!
//! Call [`of_names`] for a row of column names, [`of_points`] for the names of points x, y, z, and
//! [`of_units`] for a row that contains only units.

use std::borrow::Cow;

/// Micrometres per unit. The third and fourth are two characters that look alike; the fifth is one
/// of them read in a wrong encoding.
const KNOWN: [(&str, f64); 21] = [
    ("nm", 1e-3),
    ("nanometer", 1e-3),
    ("µm", 1.0),
    ("μm", 1.0),
    ("âµm", 1.0),
    ("um", 1.0),
    ("micron", 1.0),
    ("microns", 1.0),
    ("micrometer", 1.0),
    ("micrometers", 1.0),
    ("micrometre", 1.0),
    ("micrometres", 1.0),
    ("mikrometer", 1.0),
    ("mm", 1e3),
    ("millimeter", 1e3),
    ("millimetre", 1e3),
    ("m", 1e6),
    ("meter", 1e6),
    ("metre", 1e6),
    ("meters", 1e6),
    ("metres", 1e6),
];
/// Unsupported units that occur at the end of a name.
const FOREIGN: [&str; 18] = [
    "pm", "å", "angstrom", "cm", "dm", "km", "in", "inch", "inches", "mil", "mils", "thou", "ft",
    "px", "pixel", "pixels", "deg", "rad",
];

/// The unit stated in a column's name, µm: `v_mm`, `z [nm]`, `height (µm)`, `z / nm`, `z in nm`.
fn of_name(name: &str) -> Result<Option<f64>, String> {
    let name = name.trim();
    let marked = [("[", "]"), ("(", ")"), ("/", ""), (" in ", "")];
    for (before, after) in marked {
        let Some(inner) = name.strip_suffix(after).and_then(|n| n.rsplit_once(before)) else {
            continue;
        };
        return known(inner.1).map(Some).ok_or_else(|| unknown(inner.1));
    }
    let mut words = name.split(|c: char| !c.is_alphanumeric());
    let last = words.next_back().unwrap_or_default();
    // A name of a single word is not a unit.
    if words.next().is_none() {
        return Ok(None);
    }
    if is_foreign(last) {
        return Err(unknown(last));
    }
    Ok(known(last))
}

/// Micrometres per supported unit.
pub(super) fn known(word: &str) -> Option<f64> {
    let word = word.trim().to_lowercase();
    KNOWN.iter().find(|k| k.0 == word).map(|k| k.1)
}

/// Whether a word is an unsupported unit.
pub(super) fn is_foreign(word: &str) -> bool {
    FOREIGN.contains(&word.trim().to_lowercase().as_str())
}

/// The message about an unsupported unit.
pub(super) fn unknown(word: &str) -> String {
    format!(
        "unknown unit {:?}: give lengths and heights in nm, µm (um), mm or m",
        word.trim()
    )
}

/// The units, µm, in a row of two column names; `None` if no column states one, and for other rows:
/// the units of a map are stated elsewhere.
///
/// # Errors
/// A unit is unsupported, or only one column states a unit.
pub(super) fn of_names(names: &[Cow<'_, str>]) -> Result<Option<[f64; 2]>, String> {
    let [a, b] = names else {
        return Ok(None);
    };
    match (of_name(a)?, of_name(b)?) {
        (None, None) => Ok(None),
        (Some(a), Some(b)) => Ok(Some([a, b])),
        _ => Err(
            "only one of two columns states its unit: state both, for example v_mm, z_um"
                .to_owned(),
        ),
    }
}

/// The units, µm, in the column names of points x, y, z; `None` for a column that states none.
///
/// # Errors
/// A unit is unsupported, or only one of the columns x and y states a unit.
pub(super) fn of_points(names: &[String]) -> Result<[Option<f64>; 3], String> {
    let [x, y, z] = names else {
        return Ok([None; 3]);
    };
    let units = [of_name(x)?, of_name(y)?, of_name(z)?];
    match units {
        [Some(_), None, _] | [None, Some(_), _] => Err(
            "only one of the columns x and y states its unit: state both, for example x_um, y_um, z_nm"
                .to_owned(),
        ),
        units => Ok(units),
    }
}

/// The unit, µm, in the name of a single column.
///
/// # Errors
/// The unit is unsupported.
pub(super) fn of_single(names: &[String]) -> Result<Option<f64>, String> {
    match names {
        [name] => of_name(name),
        _ => Ok(None),
    }
}

/// The places of the columns of points (x, y, z) or of a profile (v, z) in a row of names, which may
/// have further columns; `None` if the names do not state each of them once.
pub(super) fn order_of(names: &[String]) -> Option<Vec<usize>> {
    const POINTS: [&[&str]; 3] = [&["x"], &["y"], &["z", "height"]];
    const PROFILE: [&[&str]; 2] = [&["v", "x", "y", "position"], &["z", "height"]];
    let bare = |name: &String| {
        let lower = name.trim().to_lowercase();
        let end = lower.find(|c: char| !c.is_alphanumeric());
        lower[..end.unwrap_or(lower.len())].to_owned()
    };
    let bare: Vec<String> = names.iter().map(bare).collect();
    let place = |known: &&[&str]| {
        let mut places = (0..bare.len()).filter(|n| known.contains(&bare[*n].as_str()));
        places.next().filter(|_| places.next().is_none())
    };
    let all = |wanted: &[&[&str]]| -> Option<Vec<usize>> { wanted.iter().map(place).collect() };
    all(&POINTS).or_else(|| all(&PROFILE))
}

/// The unit in a word that contains only a unit, bare or in brackets.
pub(super) fn unit_alone(word: &str) -> Option<&str> {
    let inner = |a, b| word.strip_prefix(a).and_then(|w| w.strip_suffix(b));
    let is_unit = |w: &str| known(w).is_some() || is_foreign(w);
    let inner = inner('[', ']').or_else(|| inner('(', ')'));
    inner.or_else(|| is_unit(word).then_some(word))
}

/// The units, µm, in a row of two that contains only units, bare or in brackets; `None` for other
/// rows.
///
/// # Errors
/// A unit is unsupported.
pub(super) fn of_units(words: &[Cow<'_, str>]) -> Result<Option<[f64; 2]>, String> {
    let [a, b] = words else {
        return Ok(None);
    };
    let (Some(a), Some(b)) = (unit_alone(a), unit_alone(b)) else {
        return Ok(None);
    };
    let known = |word: &str| known(word).ok_or_else(|| unknown(word));
    Ok(Some([known(a)?, known(b)?]))
}

/// The units in a comment above the numbers that consists of two column names.
///
/// # Errors
/// Both columns state a unit, and at least one is unsupported.
pub(super) fn of_comment(names: &[Cow<'_, str>]) -> Result<Option<[f64; 2]>, String> {
    let short = |n: &Cow<'_, str>| n.split(|c: char| !c.is_alphanumeric()).count() <= 4;
    let [a, b] = names else {
        return Ok(None);
    };
    if !(short(a) && short(b)) {
        return Ok(None);
    }
    match (of_name(a), of_name(b)) {
        // A remark that happens to end in such a word.
        (Ok(None), _) | (_, Ok(None)) => Ok(None),
        (Ok(Some(a)), Ok(Some(b))) => Ok(Some([a, b])),
        (Err(why), _) | (_, Err(why)) => Err(why),
    }
}

#[cfg(test)]
mod tests {
    use super::super::read;

    fn heights(text: &str) -> Result<Vec<f64>, String> {
        read("profile.csv", text.as_bytes()).map(|map| map.heights)
    }

    #[test]
    fn a_profile_is_converted_to_micrometres_from_the_units_in_its_names() {
        for head in [
            "v_mm,z_nm",
            "v [mm],z [nm]",
            "v (mm); height (nm)",
            "v / mm\tz/nm",
            "position in mm,height in nm",
            "v,z\nmm,nm",
            "\"v\",\"z\"\n[mm],[nm]",
            "mm,nm",
            "# v_mm, z_nm",
        ] {
            let found = heights(&format!("{head}\n2,3\n"));
            let found = found.unwrap_or_else(|why| panic!("{head}: {why}"));
            assert_eq!(found, [2000.0, 3.0 * 1e-3], "{head}");
        }
        for head in [
            "v_um,z_um",
            "v_µm,z_μm",
            "v,z",
            "m,z",
            "# taken at 5 mm, by hand",
        ] {
            assert_eq!(
                heights(&format!("{head}\n2,3\n")).unwrap(),
                [2.0, 3.0],
                "{head}"
            );
        }
        // The units of a map are stated elsewhere, whatever its column names.
        for head in ["a_nm,b_nm,c_nm", "x_px,y_px,z_px", "px,px,px"] {
            assert_eq!(
                heights(&format!("{head}\n1,2,3\n")).unwrap(),
                [1.0, 2.0, 3.0],
                "{head}"
            );
        }
    }

    #[test]
    fn columns_are_ordered_by_their_names() {
        for text in [
            "z_nm,v_mm\n3,2\n",
            "# z_nm, v_mm\n3,2\n",
            "z,v\nnm,mm\n3,2\n",
        ] {
            assert_eq!(heights(text).unwrap(), [2000.0, 3.0 * 1e-3], "{text}");
        }
        assert_eq!(heights("a,b\n3,2\n").unwrap(), [3.0, 2.0]);
        let points: String = (0..12)
            .map(|n| format!("{},{},{}\n", 10 * n, n / 4, 2 * (n % 4)))
            .collect();
        let map = read("points.csv", format!("z_nm,y_mm,x_um\n{points}").as_bytes()).unwrap();
        assert_eq!((map.columns, map.rows), (4, 3));
        assert_eq!(map.pitch_um, Some([2.0, 1000.0]));
        assert_eq!((map.height_unit_um, map.heights[5]), (Some(1e-3), 50.0));
    }

    #[test]
    fn unknown_units_and_units_of_one_column_are_refused() {
        for (head, word) in [
            ("v_inch,z_inch", "inch"),
            ("v [furlong],z [mm]", "furlong"),
            ("v,z\nmm,mil", "mil"),
            ("v_mm,z", "state both"),
            ("v,z\nv,z", "line 2"),
        ] {
            let why = heights(&format!("{head}\n2,3\n")).unwrap_err();
            assert!(why.contains(word), "{head}: {why}");
        }
    }

    #[test]
    fn tables_are_read_in_the_encodings_that_programs_write() {
        let text = "v_mm;z_µm\n1,5;2\n";
        let latin: Vec<u8> = text.chars().map(|c| c as u8).collect();
        let units: Vec<u16> = text.encode_utf16().collect();
        let little = units.iter().flat_map(|u| u.to_le_bytes());
        let big = units.iter().flat_map(|u| u.to_be_bytes());
        let little: Vec<u8> = [0xff, 0xfe].into_iter().chain(little).collect();
        let big: Vec<u8> = [0xfe, 0xff].into_iter().chain(big).collect();
        for content in [
            text.as_bytes(),
            &latin,
            &little,
            &big,
            &little[2..],
            &big[2..],
        ] {
            assert_eq!(read("a.csv", content).unwrap().heights, [1500.0, 2.0]);
        }
        for (content, word) in [
            (&b"\x01\x02\0\0\n"[..], "zero bytes"),
            (&little[..little.len() - 1], "UTF-16"),
            (&b"\x01\x02\xff\n"[..], "not text"),
        ] {
            let why = read("a.csv", content).unwrap_err();
            assert!(why.contains(word), "{why}");
        }
    }
}
