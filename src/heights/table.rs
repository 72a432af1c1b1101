//! Tables: rows of heights, two columns of a profile, or three columns of points x, y, z, with
//! their header.

use std::borrow::Cow;

use super::groupings::{GROUPED_COLUMNS, Groupings};
use super::header::Header;
use super::missing::{Kind, is_mark, mark};
use super::text::{GROUPING, number};
use super::{check_size, column_units, points};
use crate::trace::scene::HeightMap;
use crate::wording::encoding::{quoted, text_of};
use crate::wording::sheet::REMARKS;

/// The rows of numbers read so far.
#[derive(Default)]
struct Rows {
    columns: usize,
    numbers: Vec<f64>,
    /// Whether every row ended with a separator.
    all_trail: bool,
    groupings: [Groupings; GROUPED_COLUMNS],
}

/// A line's fields, and whether a separator followed the last one.
struct Fields<'l> {
    words: Vec<Cow<'l, str>>,
    trails: bool,
}

/// A line of text above the numbers.
struct OtherLine {
    /// From 1.
    line: usize,
    words: Vec<String>,
}

/// The state of the lines above the numbers.
struct Above {
    names_may_come: bool,
    units_may_come: bool,
    /// Units of two columns.
    units: Option<[f64; 2]>,
    names: Vec<String>,
    header: Header,
    /// Lines of other text: the last one with as many fields as the rows names the columns.
    other: Vec<OtherLine>,
}

/// Reads a table of at most `most` numbers.
pub(super) fn read(content: &[u8], most: usize) -> Result<HeightMap, String> {
    let text = text_of(content)?;
    let mut above = Above {
        names_may_come: true,
        units_may_come: true,
        units: None,
        names: Vec::new(),
        header: Header::default(),
        other: Vec::new(),
    };
    let mut rows = Rows {
        all_trail: true,
        ..Rows::default()
    };
    for (n, line) in text.lines().enumerate() {
        let at_line = |cause: String| format!("line {}: {cause}", n + 1);
        let begun = rows.columns > 0;
        // A tab at the end is a separator.
        let line = line.trim_matches(|c: char| c.is_whitespace() && c != '\t');
        let is_blank = line.trim().is_empty();
        if is_blank && !(begun && line.contains('\t')) {
            continue;
        }
        let remark = REMARKS
            .iter()
            .find(|mark| line.trim_start().starts_with(**mark));
        if let Some(mark) = remark.filter(|_| !(begun && rows.begin_with_mark(line))) {
            if !begun {
                let remark = line.trim().trim_start_matches(*mark).trim();
                above.take_remark(remark).map_err(at_line)?;
            }
            continue;
        }
        // Excel's line that names its separator.
        if !begun && line.to_lowercase().starts_with("sep=") {
            continue;
        }
        let fields = fields_of(line).map_err(|cause| at_line(cause.to_owned()))?;
        if !begun {
            if above.take(line, &fields.words, n + 1).map_err(at_line)? {
                continue;
            }
            above.name_columns(fields.words.len())?;
        }
        let height = |word: &Cow<'_, str>| match number(word) {
            Some(x) => Ok(x),
            None if is_mark(word) => Ok(f64::NAN),
            None => Err(at_line(not_a_number(word))),
        };
        for (n, word) in fields.words.iter().enumerate() {
            let place = if fields.words.len() > GROUPED_COLUMNS {
                0
            } else {
                n
            };
            rows.groupings[place].add(word);
        }
        let row = fields
            .words
            .iter()
            .map(height)
            .collect::<Result<Vec<_>, _>>()?;
        let own = row.len();
        rows.add(row, fields.trails).map_err(|columns| {
            format!(
                "line {}: expected {columns} heights as in the lines before it, got {own}",
                n + 1
            )
        })?;
        if rows.numbers.len() > most {
            let count = rows.numbers.len() / rows.columns;
            check_size(rows.columns, count, most)?;
        }
    }
    if let Some(word) = rows.groupings.iter().find_map(Groupings::doubtful) {
        return Err(format!(
            "numbers such as {word} may have three decimals, or group thousands, since others have no such mark: save the numbers \
             without separators between thousands"
        ));
    }
    above.map(rows, most)
}

fn not_a_number(word: &str) -> String {
    format!(
        "{} is not a number: write a missing point as blank, NaN, Bad or another usual word, and # before other text",
        quoted(word)
    )
}

impl Rows {
    /// Whether a line that begins like a remark is a row whose first point is missing (`#N/A`).
    fn begin_with_mark(&self, line: &str) -> bool {
        let is_row = |words: &[Cow<'_, str>]| {
            let is_point = |word: &Cow<'_, str>| number(word).is_some() || is_mark(word);
            words.len() == self.columns && self.columns > 1 && words.iter().all(is_point)
        };
        fields_of(line).is_ok_and(|fields| is_row(&fields.words))
    }

    /// Adds a row.
    ///
    /// # Errors
    /// The expected number of columns, if the row has another one.
    fn add(&mut self, mut row: Vec<f64>, trails: bool) -> Result<(), usize> {
        if self.columns == 0 {
            self.columns = row.len();
        }
        if row.len() + 1 == self.columns && trails {
            // The separator at its end precedes a blank field.
            row.push(f64::NAN);
        } else if row.len() == self.columns + 1 && self.all_trail {
            // So did all rows before.
            let rows = self.numbers.chunks_exact(self.columns);
            self.numbers = rows
                .flat_map(|row| row.iter().copied().chain([f64::NAN]))
                .collect();
            self.columns += 1;
        }
        if row.len() != self.columns {
            return Err(self.columns);
        }
        self.all_trail &= trails;
        self.numbers.extend(row);
        Ok(())
    }
}

impl Above {
    /// Reads sizes and units from a comment.
    fn take_remark(&mut self, remark: &str) -> Result<(), String> {
        if self.header.take(remark)? {
            return Ok(());
        }
        if let Ok(fields) = fields_of(remark) {
            let units = column_units::of_comment(&fields.words)?;
            self.units = units.or(self.units);
            let names = names_of(&fields.words);
            if units.is_some()
                || matches!(column_units::of_points(&names), Ok([Some(_), Some(_), _]))
            {
                self.names = names;
            }
        }
        Ok(())
    }

    /// Whether a line is not a row of numbers: blank, sizes and units, or other text.
    fn take(&mut self, line: &str, words: &[Cow<'_, str>], n: usize) -> Result<bool, String> {
        let is_number = |word: &Cow<'_, str>| number(word).is_some();
        let first = words.first();
        // A rule below the names.
        if let [rule] = words
            && rule.len() > 1
            && !rule.contains(char::is_alphanumeric)
        {
            return Ok(true);
        }
        if first.is_none_or(is_number) || words.iter().all(|w| w.is_empty()) {
            return Ok(first.is_none_or(|w| w.is_empty()));
        }
        // Rows may begin with a missing point; in a name and a value, the name may be such a word.
        let begins = first.is_some_and(|w| is_mark(w)) && words.len() > 2;
        if begins || words.iter().all(|w| is_mark(w)) {
            return Ok(false);
        }
        if !self.header.take(line)? {
            // More numbers than text are a damaged row of heights.
            let numbers = words.iter().filter(|word| is_number(word)).count();
            if words.len() > 2 && 2 * numbers > words.len() {
                return Ok(false);
            }
            // A key and its value do not name two columns.
            if !line.contains([':', '=']) {
                let words = words.iter().map(|word| word.as_ref().to_owned()).collect();
                self.other.push(OtherLine { line: n, words });
            }
        }
        Ok(true)
    }

    /// Takes the names of columns, and their units, from the lines above the first row of numbers that
    /// have as many fields. Others are titles and facts of the measurement.
    fn name_columns(&mut self, columns: usize) -> Result<(), String> {
        let mut lines = std::mem::take(&mut self.other);
        for other in &mut lines {
            let words: Vec<Cow<'_, str>> = other.words.iter().map(Cow::from).collect();
            let names = names_of(&words);
            if names.len() == columns {
                other.words = names;
            }
        }
        lines.retain(|other| other.words.len() == columns);
        let are_names = |words: &[String]| {
            let is_name = |word: &String| number(word).is_none();
            words.iter().all(is_name)
                && !words.iter().all(|w| column_units::unit_alone(w).is_some())
        };
        let last = lines.iter().rposition(|other| are_names(&other.words));
        for (n, OtherLine { line, words }) in lines.iter().enumerate() {
            // A title before the names may have as many words.
            if last.is_some_and(|last| n < last) && column_units::order_of(words).is_none() {
                continue;
            }
            let words: Vec<Cow<'_, str>> = words.iter().map(Cow::from).collect();
            let text = words.iter().find(|word| number(word).is_none());
            let text = text.map_or("", |word| word.as_ref());
            match self.describe(&words) {
                Ok(true) => {}
                Ok(false) => return Err(format!("line {line}: {}", not_a_number(text))),
                Err(why) => return Err(format!("line {line}: {why}")),
            }
        }
        Ok(())
    }

    /// Whether a line has the names of columns, or their units: one line of each may come.
    fn describe(&mut self, words: &[Cow<'_, str>]) -> Result<bool, String> {
        if words.iter().any(|word| number(word).is_some()) {
            return Ok(false);
        }
        if self.units_may_come
            && let Some(own) = column_units::of_units(words)?
        {
            (self.names_may_come, self.units_may_come) = (false, false);
            self.units = Some(own);
            return Ok(true);
        }
        if self.names_may_come {
            self.names_may_come = false;
            self.units = column_units::of_names(words)?.or(self.units);
            self.names = names_of(words);
            return Ok(true);
        }
        if self.units_may_come && words.len() == self.names.len() {
            let units: Option<Vec<&str>> =
                words.iter().map(|w| column_units::unit_alone(w)).collect();
            if let Some(units) = units {
                self.units_may_come = false;
                for (name, unit) in self.names.iter_mut().zip(units) {
                    *name = format!("{name} [{unit}]");
                }
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The map in the rows.
    fn map(mut self, rows: Rows, most: usize) -> Result<HeightMap, String> {
        let Rows {
            mut columns,
            mut numbers,
            ..
        } = rows;
        if columns == 0 {
            let unread = self.other.last().map_or(String::new(), |other| {
                let word = other.words.first().map_or("", String::as_str);
                format!(": line {}: {}", other.line, not_a_number(word))
            });
            return Err(format!("the file contains no heights{unread}"));
        }
        let is_named = self.names.len() == columns;
        if let Some(order) = column_units::order_of(&self.names).filter(|_| is_named) {
            let rows = numbers.chunks_exact(columns);
            numbers = rows
                .flat_map(|row| order.iter().map(move |n| row[*n]))
                .collect();
            let has_others = columns > order.len();
            columns = order.len();
            self.names = order.iter().map(|n| self.names[*n].clone()).collect();
            self.units = match order[..] {
                _ if has_others => {
                    let names: Vec<Cow<'_, str>> = self.names.iter().map(Cow::from).collect();
                    column_units::of_names(&names)?
                }
                [0, ..] => self.units,
                _ => self.units.map(|[a, b]| [b, a]),
            };
        }
        let marks = &self.header.marks;
        if columns == 2 || columns == 3 {
            // Positions are neither heights nor marks of missing points.
            let mut heights: Vec<f64> = numbers
                .iter()
                .copied()
                .skip(columns - 1)
                .step_by(columns)
                .collect();
            let notes = mark(&mut heights, marks, Kind::Heights);
            let mut marked = numbers.clone();
            for (row, z) in marked.chunks_exact_mut(columns).zip(heights) {
                row[columns - 1] = z;
            }
            if columns == 2 {
                // A table of two columns is a profile, in µm by default.
                let [v_um, z_um] = self.units.unwrap_or([1.0; 2]);
                let mut rows: Vec<[f64; 2]> = marked
                    .chunks_exact(2)
                    .map(|row| [row[0] * v_um, row[1] * z_um])
                    .collect();
                // A stage may run towards −v.
                if rows.is_sorted_by(|a, b| a[0] > b[0]) {
                    rows.reverse();
                }
                let marked = rows.concat();
                return Ok(HeightMap {
                    notes,
                    ..HeightMap::new(2, marked)
                });
            }
            if let Some(mut map) = points::gridded(&marked, &self.names, &self.header, most)? {
                map.notes.extend(notes);
                return Ok(map);
            }
        }
        if let Some(line) = coordinates(columns, &numbers) {
            return Err(format!(
                "the first {line} has evenly spaced increasing or decreasing numbers as positions are, and no other {line} has: remove \
                 it, and state the steps with --pitch-um or in the header"
            ));
        }
        let notes = mark(&mut numbers, marks, Kind::Heights);
        // A single column of heights is a profile, as a single row is.
        let mut of_column = None;
        if columns == 1 && numbers.len() > 2 {
            columns = numbers.len();
            of_column = column_units::of_single(&self.names)?;
        }
        let map = HeightMap::new(columns, numbers);
        Ok(HeightMap {
            pitch_um: self.header.pitch_um(columns, map.rows),
            height_unit_um: self.header.value_um().or(of_column),
            notes,
            ..map
        })
    }
}

/// Least number of positions that are distinguished from heights.
const POSITIONS_MIN: usize = 8;
/// Largest deviation of a position from even spacing, in steps: programs round positions.
const UNEVEN_MAX: f64 = 0.02;

/// Whether the first column or the first row contains positions, and the others heights.
fn coordinates(columns: usize, numbers: &[f64]) -> Option<&'static str> {
    let rows = numbers.len() / columns;
    // The corner of a table with positions on both sides may have any number.
    let column = |n: usize| {
        numbers[n..]
            .iter()
            .copied()
            .step_by(columns)
            .skip(1)
            .collect::<Vec<f64>>()
    };
    let row = |n: usize| numbers[n * columns + 1..(n + 1) * columns].to_vec();
    let only_first = |count: usize, line: &dyn Fn(usize) -> Vec<f64>| {
        count > 2 && is_even(&line(0)) && !(1..count).any(|n| is_even(&line(n)))
    };
    if only_first(columns, &column) {
        return Some("column");
    }
    only_first(rows, &row).then_some("row")
}

/// Whether numbers are evenly spaced and not all equal.
fn is_even(line: &[f64]) -> bool {
    let [first, .., last] = line else {
        return false;
    };
    let step = (last - first) / (line.len() - 1) as f64;
    let off = |(n, x): (usize, &f64)| (x - first - step * n as f64).abs();
    line.len() >= POSITIONS_MIN
        && step != 0.0
        && line
            .iter()
            .enumerate()
            .map(off)
            .all(|off| off <= UNEVEN_MAX * step.abs())
}

/// Names of columns; a unit in brackets belongs to the name before it.
fn names_of(words: &[Cow<'_, str>]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for word in words {
        match names.last_mut() {
            Some(name) if word.starts_with(['[', '(']) => *name = format!("{name} {word}"),
            _ => names.push(word.as_ref().to_owned()),
        }
    }
    names
}

/// The fields of a line. If semicolons or tabs separate them, a comma is a decimal mark, as in many
/// countries; an ambiguous line is refused.
fn fields_of(line: &str) -> Result<Fields<'_>, &'static str> {
    let separator = [';', '\t', ','].into_iter().find(|s| line.contains(*s));
    let mut words: Vec<Cow<'_, str>> = match separator {
        Some(mark) => {
            // A separator within quotes is part of a field.
            let mut is_quoted = false;
            let splits = |c: char| {
                is_quoted ^= c == '"';
                c == mark && !is_quoted
            };
            line.split(splits).map(|w| w.trim().into()).collect()
        }
        // A blank that does not break a line is within a number.
        None => line
            .split(|c: char| c.is_whitespace() && !GROUPING.contains(&c))
            .filter(|word| !word.is_empty())
            .map(Cow::from)
            .collect(),
    };
    // A separator at the end of a line separates nothing.
    let trails = words.len() > 1 && words.last().is_some_and(|last| last.is_empty());
    if trails {
        words.pop();
    }
    for word in &mut words {
        if let Some(inner) = word.strip_prefix('"').and_then(|w| w.strip_suffix('"')) {
            *word = inner.trim().to_owned().into();
        }
        if word.contains(' ') && word.split(' ').all(|w| number(w).is_some()) {
            return Err(
                "spaces and other marks both separate its numbers: use only one of comma, semicolon, tab \
                 and space (semicolon or tab if the comma is the decimal mark)",
            );
        }
    }
    Ok(Fields { words, trails })
}

#[cfg(test)]
mod tests {
    use super::super::read;

    #[test]
    fn missing_points_may_be_blank_or_a_word_anywhere_in_a_row() {
        for text in [
            "1,2,3,4\n5,,7,8\n9,10,11,\n",
            "1;2;3;4\n5;Bad;7;8\n9;10;11;NaN\n",
            "1\t2\t3\t4\n5\t\t7\t8\n9\t10\t11\t\n",
            "1 2 3 4\n5 NaN 7 8\n9 10 11 --\n",
            "1,2,3,4,\n5,#N/A,7,8,\n9,10,11,BAD,\n",
            "# Width: 3 px\n1,2,3,4\n5,-1.#IND,7,8\n9,10,11,inf\n",
        ] {
            let map = read("a.csv", text.as_bytes()).unwrap_or_else(|why| panic!("{text}: {why}"));
            assert_eq!((map.columns, map.rows, map.missing()), (4, 3, 2), "{text}");
            assert!(
                map.heights[5].is_nan() && map.heights[11].is_nan(),
                "{text}"
            );
        }
        // The first rows end in a missing point.
        let map = read("a.csv", b"1,2,\n3,4,\n5,6,7\n").unwrap();
        assert_eq!((map.columns, map.missing()), (3, 2));
        // A row without any measured point, and a gap in a profile.
        assert_eq!(read("a.csv", b"Bad,Bad,Bad\n1,2,3\n").unwrap().missing(), 3);
        let profile = read("a.csv", b"0,0\n4,-0.7\n9,Bad\n9.5,-1.7\n10,0\n").unwrap();
        assert_eq!(profile.profile().unwrap().pieces().len(), 3);
        let stated = read(
            "a.asc",
            b"ncols 4\nnrows 2\nNODATA_value -1\n5 6 7 8\n9 -1 7 6\n",
        )
        .unwrap();
        assert_eq!((stated.columns, stated.rows, stated.missing()), (4, 2, 1));
    }

    #[test]
    fn no_row_of_heights_is_taken_for_a_remark_or_a_title() {
        let map = read("a.txt", b"1\t2\t3\n#N/A\t5\t6\n# 7 of 9\n7\t8\t9\n").unwrap();
        assert_eq!((map.rows, map.missing(), map.heights[4]), (3, 1, 5.0));
        for (text, words) in [
            ("1.52.5,3,4\n1,2,3,4\n", "line 1"),
            ("1.5 um;2 um\n3 um;4 um\n", "line 2: \"3 um\""),
        ] {
            let why = read("a.csv", text.as_bytes()).unwrap_err();
            assert!(why.contains(words) && why.contains("not a number"), "{why}");
        }
    }

    #[test]
    fn text_above_the_numbers_is_read_past_and_the_last_fitting_line_names_the_columns() {
        let heights = "1,2,3,4\n5,6,7,8\n".replace(',', "\",\"");
        let heights: String = heights
            .lines()
            .map(|row| format!("\"{row}\"\r\n"))
            .collect();
        let head = "\"Measurement data\",\"VK\"\r\n\"XY Calibration\",\"500.0\",\"nm\"\r\n\"Output image data\",\"Height\"\r\n\
                    \"Horizontal\",\"4\"\r\n\"Unit\",\"um\"\r\n\r\n\"Height\"\r\n";
        let map = read("a.csv", format!("{head}{heights}").as_bytes()).unwrap();
        assert_eq!((map.columns, map.rows), (4, 2));
        assert_eq!(
            (map.pitch_um, map.height_unit_um),
            (Some([0.5; 2]), Some(1.0))
        );
        for head in [
            "Surftest SJ\r\nDate;2026-03-02\r\nSpeed;0.5mm/s\r\nX[mm];Z[nm]\r\n",
            "v [mm] z [nm]\n-------\n",
        ] {
            let map = read(
                "a.csv",
                format!("{head}2 3\n")
                    .replace("2 3", if head.contains(';') { "2;3" } else { "2 3" })
                    .as_bytes(),
            );
            assert_eq!(map.unwrap().heights, [2000.0, 3.0 * 1e-3], "{head}");
        }
    }

    #[test]
    fn further_columns_are_left_out_and_a_single_one_is_a_profile() {
        let points: String = (0..12)
            .map(|n| format!("{n},{},{},{},100\n", n % 4, n / 4, 10 * n))
            .collect();
        let map = read(
            "a.csv",
            format!("no,x_um,y_um,z_nm,intensity\n{points}").as_bytes(),
        )
        .unwrap();
        assert_eq!((map.columns, map.rows, map.heights[5]), (4, 3, 50.0));
        assert_eq!(
            (map.pitch_um, map.height_unit_um),
            (Some([1.0; 2]), Some(1e-3))
        );
        let profile = read("a.csv", b"no,v_mm,z_nm\n1,2,3\n2,4,5\n").unwrap();
        assert_eq!(profile.heights, [2000.0, 3.0 * 1e-3, 4000.0, 5.0 * 1e-3]);
        let column = read("a.csv", b"z [nm]\n1\n2\n3\n4\n").unwrap();
        assert_eq!(
            (column.columns, column.rows, column.height_unit_um),
            (4, 1, Some(1e-3))
        );
    }

    #[test]
    fn numbers_that_may_group_thousands_are_refused_and_decimals_are_not() {
        let table = |number: fn(usize) -> String, mark: &str| {
            let words: Vec<String> = (0..60).map(|n| number(n).replace('.', mark)).collect();
            let rows = words.chunks(12).map(|row| row.join(";") + "\n");
            read("a.csv", rows.collect::<String>().as_bytes())
        };
        for mark in [",", "."] {
            let heights = |n: usize| {
                if n.is_multiple_of(7) {
                    format!("{}", 100 + n)
                } else {
                    format!("{}.{:03}", n, 17 * n % 1000)
                }
            };
            let why = table(heights, mark).unwrap_err();
            assert!(why.contains("between thousands"), "{why}");
            assert!(table(|n| format!("{}.{:03}", n, 17 * n % 1000), mark).is_ok());
            assert!(table(|n| format!("{}", n as f64 / 8.0), mark).is_ok());
        }
        // Whole positions beside decimals are in another column.
        let points: String = (0..60)
            .map(|n| format!("{} {} 1{n}.125\n", n % 10, n / 10))
            .collect();
        assert_eq!(read("a.xyz", points.as_bytes()).unwrap().columns, 10);
        let quoted = read("a.csv", b"\"17,260.6\",\"1\"\n\"18,260.6\",\"2\"\n").unwrap();
        assert_eq!(quoted.heights, [17_260.6, 1.0, 18_260.6, 2.0]);
        let grouped = read("a.txt", "17\u{202f}260,6\t1\n18'260,6\t2\n".as_bytes()).unwrap();
        assert_eq!(grouped.heights, [17_260.6, 1.0, 18_260.6, 2.0]);
    }

    #[test]
    fn positions_beside_the_heights_are_refused_by_name_and_a_plane_is_a_map() {
        let table = |height: fn(usize, usize) -> f64, first: bool, above: bool| {
            let mut text = String::new();
            if above {
                let places: Vec<String> = (0..12).map(|n| format!("{}", 2 * n)).collect();
                text += &format!("{}{}\n", if first { "0," } else { "" }, places.join(","));
            }
            for n in 0..10 {
                let row: Vec<String> = (0..12).map(|i| format!("{}", height(i, n))).collect();
                let place = format!("{:.3},", n as f64 / 3.0);
                text += &format!("{}{}\n", if first { &place } else { "" }, row.join(","));
            }
            read("a.csv", text.as_bytes())
        };
        let ridges = |i: usize, n: usize| ((i + 2 * n) % 5) as f64;
        for (first, above, line) in [
            (true, false, "column"),
            (false, true, "row"),
            (true, true, "column"),
        ] {
            let why = table(ridges, first, above).unwrap_err();
            assert!(why.starts_with(&format!("the first {line} has")), "{why}");
        }
        assert!(table(ridges, false, false).is_ok());
        assert!(table(|i, n| (i + 2 * n) as f64, false, false).is_ok());
    }

    #[test]
    fn a_profile_measured_towards_smaller_v_is_reversed_and_an_unsorted_one_is_refused() {
        let profile = |text: &str| read("a.csv", text.as_bytes()).unwrap().profile();
        let forward = profile("0,0\n9.7,-1.7\n10,0\n").unwrap();
        assert_eq!(profile("10,0\n9.7,-1.7\n0,0\n").unwrap(), forward);
        let why = profile("0,0\n9.8,-1.5\n9.7,-1.7\n10,0\n")
            .unwrap_err()
            .to_string();
        assert!(why.contains("sort the rows by v"), "{why}");
    }

    #[test]
    fn a_header_states_the_units_of_a_map_in_any_language_and_encoding() {
        let rows = "1,5\t2,5\t3,5\t4,5\n5,5\t6,5\t7,5\t8,5\n";
        let head = "# Kanal: Höhe\n# Breite: 8,0 µm\n# Höhe: 6,00 µm\n# Werteeinheiten: nm\n";
        let text = format!("{head}{rows}");
        let latin: Vec<u8> = text.chars().map(|c| c as u8).collect();
        let bare = text.replace("# ", "");
        for content in [text.as_bytes(), &latin, bare.as_bytes()] {
            let map = read("export.txt", content).unwrap();
            assert_eq!((map.columns, map.rows), (4, 2));
            assert_eq!(map.pitch_um, Some([2.0, 3.0]));
            assert_eq!((map.height_unit_um, map.heights[1]), (Some(1e-3), 2.5));
        }
        let foreign = text.replace("nm", "V");
        assert!(
            read("a.txt", foreign.as_bytes())
                .unwrap_err()
                .contains("line 4")
        );
        let meta = "Date: 2026-03-02 09:00\nOperator = 7\nsep=;\nX Size: 4 um\nY Size: 2 um\n1 2 3 4\n5 6 7 8\n";
        assert_eq!(
            read("a.txt", meta.as_bytes()).unwrap().pitch_um,
            Some([1.0, 1.0])
        );
    }
}
