//! `frames.csv`: one line per frame, where it is and at which pose it was taken.

use std::collections::HashSet;
use std::path::{Component, Path};

use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use super::SeriesError;
use super::text::{meant, other_unit};
use crate::frame::{FrameKind, UnknownKind};
use crate::geometry::Pose;
use crate::limits::EXPOSURE_S;
use crate::wording::counted;
use crate::wording::sheet::Sheet;

/// One line of the list of frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRow {
    /// Path of the frame's file, relative to the series' folder, with `/`.
    pub file: String,
    /// What the frame shows.
    pub kind: FrameKind,
    /// Camera tilt as read back from its stage; 0 for dark frames.
    pub theta_c_deg: f64,
    /// Sample azimuth as read back from its stage; 0 for dark frames, anything for flats.
    pub phi_s_deg: f64,
    /// Exposure time.
    pub exposure_s: f64,
    /// Number of the repeat, from 0.
    pub repeat: u32,
    /// UTC at the start of the exposure, RFC 3339 (or as spreadsheets and loggers write it); may be empty.
    pub timestamp: String,
}

/// Largest angle: azimuths may exceed one turn, as those of stages do.
const TURNS_MAX_DEG: f64 = 3600.0;
const REQUIRED: [&str; 5] = ["file", "kind", "theta_c_deg", "phi_s_deg", "exposure_s"];
const OPTIONAL: [&str; 2] = ["repeat", "timestamp"];

impl FrameRow {
    /// Stage positions of the frame.
    #[must_use]
    pub fn pose(&self) -> Pose {
        Pose::from_deg(self.theta_c_deg, self.phi_s_deg)
    }

    /// Returns the time of the frame, s since 1970; `None` if the timestamp is no ISO date with a time. A blank may stand for
    /// the T, a comma for the point, and without an offset the time is UTC.
    #[must_use]
    pub fn taken_s(&self) -> Option<f64> {
        let (date, clock) = self.timestamp.trim().split_once(['T', 't', ' '])?;
        let clock = clock.trim_start().replace(',', ".");
        let offset = match clock.contains(['Z', 'z', '+', '-']) {
            true => "",
            false => "Z",
        };
        let time = OffsetDateTime::parse(&format!("{date}T{clock}{offset}"), &Rfc3339).ok()?;
        Some(time.unix_timestamp_nanos() as f64 * 1e-9)
    }

    /// Reads the text of a list of frames; `file` names it in errors. Columns are found by name;
    /// `repeat` and `timestamp` may be missing and further columns are ignored.
    ///
    /// # Errors
    /// [`SeriesError::Invalid`] with the line of the first thing that is wrong.
    pub fn read_all(text: &str, file: &str) -> Result<Vec<FrameRow>, SeriesError> {
        rows_of(text).map_err(|wrong| SeriesError::Invalid {
            file: file.to_owned(),
            line: wrong.line,
            key: match wrong.column {
                "" => String::new(),
                column => format!("column `{column}`: "),
            },
            cause: wrong.cause,
            remedy: wrong.remedy,
        })
    }

    /// The text of a list of frames, header included.
    #[must_use]
    pub fn write_all(rows: &[FrameRow]) -> String {
        let mut writer = csv::Writer::from_writer(Vec::new());
        for row in rows {
            writer
                .serialize(row)
                .expect("a row of numbers and text goes into memory");
        }
        if rows.is_empty() {
            writer
                .write_record(REQUIRED.iter().chain(&OPTIONAL))
                .expect("a header goes into memory");
        }
        String::from_utf8(writer.into_inner().expect("memory is flushed")).expect("rows are UTF-8")
    }
}

/// What is wrong with a list, where, and what to write instead; `column` is empty where it is the line.
struct Wrong {
    line: Option<usize>,
    column: &'static str,
    cause: String,
    remedy: String,
}

impl Wrong {
    fn new(column: &'static str, cause: impl Into<String>, remedy: impl Into<String>) -> Wrong {
        Wrong {
            line: None,
            column,
            cause: cause.into(),
            remedy: remedy.into(),
        }
    }

    fn at(self, line: Option<usize>) -> Wrong {
        Wrong { line, ..self }
    }

    fn no_csv(error: &csv::Error, sheet: &Sheet<'_>) -> Wrong {
        let cause = match error.kind() {
            csv::ErrorKind::UnequalLengths {
                expected_len, len, ..
            } => format!(
                "the line has {}, the header {expected_len}",
                counted(*len as usize, "field")
            ),
            _ => format!("the line cannot be read as CSV: {error}"),
        };
        let remedy = "repair the line: with commas between the columns, decimals follow a point and text with a comma is quoted";
        Wrong::new("", cause, remedy).at(sheet.line(error.position()))
    }
}

fn rows_of(text: &str) -> Result<Vec<FrameRow>, Wrong> {
    let mut sheet = Sheet::open(text);
    let headers = sheet.headers().map_err(|e| Wrong::no_csv(&e, &sheet))?;
    let columns = Columns::find(&headers).map_err(|wrong| wrong.at(Some(sheet.header_line())))?;
    let mut rows: Vec<FrameRow> = Vec::new();
    let mut seen = HashSet::new();
    while let Some(record) = sheet.read() {
        let record = record.map_err(|e| Wrong::no_csv(&e, &sheet))?;
        let line = sheet.line(record.position());
        let row = columns
            .row(&record, &sheet)
            .map_err(|wrong| wrong.at(line))?;
        if !seen.insert(row.file.clone()) {
            let cause = format!("`{}` is listed twice", row.file);
            return Err(Wrong::new("file", cause, "keep one of the two lines").at(line));
        }
        rows.push(row);
    }
    if rows.is_empty() {
        let remedy = "add one line per frame below the header";
        return Err(Wrong::new("", "it lists no frame", remedy));
    }
    Ok(rows)
}

/// Where the header has which column.
struct Columns {
    file: usize,
    kind: usize,
    theta_c_deg: usize,
    phi_s_deg: usize,
    exposure_s: usize,
    repeat: Option<usize>,
    timestamp: Option<usize>,
}

impl Columns {
    fn find(headers: &csv::StringRecord) -> Result<Columns, Wrong> {
        let names: Vec<String> = headers.iter().map(plain_name).collect();
        for name in REQUIRED.into_iter().chain(OPTIONAL) {
            if names.iter().filter(|h| *h == name).count() > 1 {
                let remedy = "remove the column that does not belong there";
                return Err(Wrong::new(name, "the header has it twice", remedy));
            }
        }
        let column = |name: &str| names.iter().position(|h| h == name);
        let required = |name: &'static str| {
            column(name).ok_or_else(|| {
                let remedy = remedy_for_missing(name, headers);
                Wrong::new(name, "the header does not have it", remedy)
            })
        };
        let [file, kind, theta_c_deg, phi_s_deg, exposure_s] = REQUIRED;
        let [repeat, timestamp] = OPTIONAL;
        Ok(Columns {
            file: required(file)?,
            kind: required(kind)?,
            theta_c_deg: required(theta_c_deg)?,
            phi_s_deg: required(phi_s_deg)?,
            exposure_s: required(exposure_s)?,
            repeat: column(repeat),
            timestamp: column(timestamp),
        })
    }

    fn row(&self, record: &csv::StringRecord, sheet: &Sheet<'_>) -> Result<FrameRow, Wrong> {
        let number = |column: &'static str, field: &str, remedy: &str| {
            let number = sheet.number(field);
            number.map_err(|cause| Wrong::new(column, cause, remedy))
        };
        // As Windows writes it.
        let file = record[self.file].replace('\\', "/");
        if let Some(cause) = path_problem(&file) {
            let remedy = "write the path of a file in the series' own folder, relative to it";
            return Err(Wrong::new("file", format!("`{file}` {cause}"), remedy));
        }
        let kind = &record[self.kind];
        let kind: FrameKind = kind.to_lowercase().parse().map_err(|UnknownKind(_)| {
            let remedy = "a frame is a sample, a dark or a flat";
            Wrong::new("kind", format!("`{kind}` is unknown"), remedy)
        })?;
        let position = "write the position that was read back, or drop the frame's line";
        let theta_c_deg = number("theta_c_deg", &record[self.theta_c_deg], position)?;
        if theta_c_deg.abs() >= 90.0 {
            return Err(Wrong::new(
                "theta_c_deg",
                format!("{theta_c_deg}° puts the camera behind the surface"),
                "tilts lie between −90° and 90°; are these degrees?",
            ));
        }
        let phi_s_deg = number("phi_s_deg", &record[self.phi_s_deg], position)?;
        if phi_s_deg.abs() > TURNS_MAX_DEG {
            return Err(Wrong::new(
                "phi_s_deg",
                format!("{phi_s_deg}° is more than ten turns"),
                "azimuths lie within a few turns; are these degrees?",
            ));
        }
        let seconds = EXPOSURE_S.remedy;
        let field = &record[self.exposure_s];
        let exposure_s = number("exposure_s", field, seconds)?;
        let is_bias = kind == FrameKind::Dark && exposure_s == 0.0;
        if !(is_bias || EXPOSURE_S.holds(exposure_s)) {
            let cause = format!("{field} s is outside {} s", EXPOSURE_S.allowed());
            return Err(Wrong::new("exposure_s", cause, seconds));
        }
        let repeat = match self.repeat.map(|i| &record[i]) {
            None | Some("") => 0,
            Some(field) => field.parse().map_err(|_| {
                let cause = format!("`{field}` is not a whole number from 0");
                Wrong::new("repeat", cause, "number the repeats 0, 1, 2, …")
            })?,
        };
        Ok(FrameRow {
            file,
            kind,
            theta_c_deg,
            phi_s_deg,
            exposure_s,
            repeat,
            timestamp: self.timestamp.map_or("", |i| &record[i]).to_owned(),
        })
    }
}

/// A column's name in small letters, with its unit at its end: `Theta_C [deg]` is `theta_c_deg`.
fn plain_name(header: &str) -> String {
    let lower = header.to_lowercase().replace('°', "deg");
    let words = lower.split(|c: char| !c.is_alphanumeric());
    words
        .filter(|w| !w.is_empty())
        .collect::<Vec<_>>()
        .join("_")
}

/// What to do about a column that the header does not have: rename a slip of the pen, or add it.
fn remedy_for_missing(name: &str, headers: &csv::StringRecord) -> String {
    let slip = headers.iter().find(|h| meant(h, &[name]).is_some());
    match slip {
        Some(slip) => match other_unit(slip, name) {
            Some(unit) => format!("convert the column `{slip}` to {unit} and name it `{name}`"),
            None => format!("rename the column `{slip}`"),
        },
        None => format!(
            "the header needs {}, and may have {}",
            REQUIRED.join(","),
            OPTIONAL.join(",")
        ),
    }
}

/// Why a path may not name a frame.
pub(super) fn path_problem(path: &str) -> Option<&'static str> {
    if path.is_empty() {
        return Some("is empty");
    }
    if path.contains('\\') {
        return Some("holds a backslash: `/` parts folders");
    }
    if path.get(1..2) == Some(":") {
        return Some("is an absolute path");
    }
    if path.contains(['\0', ':']) {
        return Some("holds a colon or a null character, which no frame's path has");
    }
    for part in Path::new(path).components() {
        match part {
            Component::Normal(_) | Component::CurDir => {}
            Component::ParentDir => return Some("leads out of the folder"),
            Component::RootDir | Component::Prefix(_) => return Some("is an absolute path"),
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "file,kind,theta_c_deg,phi_s_deg,exposure_s,repeat,timestamp\n";

    fn refusal(line: &str) -> String {
        FrameRow::read_all(
            &format!("{HEADER}a.png,dark,0,0,1,0,\n{line}\n"),
            "frames.csv",
        )
        .unwrap_err()
        .to_string()
    }

    #[test]
    fn a_list_survives_its_file() {
        let text = format!("{HEADER}frames/a.png,flat,-20.125,0.1,0.003,2,2026-03-02T09:00:00Z\n");
        let rows = FrameRow::read_all(&text, "frames.csv").unwrap();
        assert_eq!(rows[0].kind, FrameKind::Flat);
        assert_eq!(
            FrameRow::read_all(&FrameRow::write_all(&rows), "").unwrap(),
            rows
        );
    }

    #[test]
    fn a_time_is_read_as_loggers_and_spreadsheets_write_it() {
        let taken = |timestamp: &str| {
            let text = format!("{HEADER}a.png,sample,0,0,1,0,\"{timestamp}\"\n");
            FrameRow::read_all(&text, "frames.csv").unwrap()[0].taken_s()
        };
        let plain = taken("2026-03-02T09:00:07.25Z");
        assert!(plain.is_some());
        for other in [
            "2026-03-02 09:00:07.25",
            "2026-03-02T09:00:07.25",
            "2026-03-02 09:00:07,25",
            "2026-03-02 10:00:07.25+01:00",
            " 2026-03-02 09:00:07.25Z ",
        ] {
            assert_eq!(taken(other), plain, "{other}");
        }
        for none in ["", "09:00:07", "2026-03-02", "2026-03-02 noon", "yesterday"] {
            assert_eq!(taken(none), None, "{none}");
        }
    }

    #[test]
    fn a_bad_line_is_named_with_its_column() {
        for (line, column, word) in [
            ("b.png,bias,0,0,1,0,", "kind", "bias"),
            ("b.png,dark,NaN,0,1,0,", "theta_c_deg", "NaN"),
            ("b.png,dark,0,inf,1,0,", "phi_s_deg", "inf"),
            ("b.png,sample,0,1e9,1,0,", "phi_s_deg", "1000000000"),
            ("b.png,sample,95,0,1,0,", "theta_c_deg", "95"),
            ("b.png,sample,0,0,-1,0,", "exposure_s", "-1"),
            ("b.png,sample,0,0,0,0,", "exposure_s", "0 s is outside"),
            (
                "b.png,sample,0,0,1e308,0,",
                "exposure_s",
                "1e308 s is outside",
            ),
            ("b.png,sample,0,0,1,x,", "repeat", "x"),
            ("../b.png,sample,0,0,1,0,", "file", "out of the folder"),
            ("/etc/b.png,sample,0,0,1,0,", "file", "absolute"),
            ("C:\\b.png,sample,0,0,1,0,", "file", "absolute"),
            ("c:b.png,sample,0,0,1,0,", "file", "absolute"),
            ("ab:c.png,sample,0,0,1,0,", "file", "colon"),
            ("..\\b.png,sample,0,0,1,0,", "file", "out of the folder"),
            ("a.png,sample,0,0,1,0,", "file", "twice"),
        ] {
            let said = refusal(line);
            assert!(
                said.contains("frames.csv line 3") && said.contains(column) && said.contains(word),
                "{line}: {said}"
            );
        }
        assert!(refusal("b.png,dark").contains("2 fields"));
        assert!(refusal("b.png,sample,0,inf,1,0,").contains("read back"));
        assert!(refusal("b.png,sample,0,0,long,0,").contains("in seconds"));
    }

    #[test]
    fn a_column_that_is_there_twice_is_refused() {
        let text = "file,kind,theta_c_deg,phi_s_deg,exposure_s,phi_s_deg\na.png,sample,0,0,1,90\n";
        let refused = FrameRow::read_all(text, "frames.csv")
            .unwrap_err()
            .to_string();
        assert!(
            refused.contains("phi_s_deg") && refused.contains("twice"),
            "{refused}"
        );
    }

    #[test]
    fn a_misspelt_column_is_reported_its_right_name() {
        let said = FrameRow::read_all("file,kind,theta_deg,phi_s_deg,exposure_s\n", "frames.csv")
            .unwrap_err()
            .to_string();
        assert!(
            said.contains("`theta_c_deg`") && said.contains("`theta_deg`"),
            "{said}"
        );
    }

    #[test]
    fn a_list_is_the_same_whatever_spreadsheet_saved_it() {
        let plain =
            format!("{HEADER}frames/a.png,sample,-20.5,90,0.06,0,2026-03-02T09:00:07.080Z\n");
        let rows = FrameRow::read_all(&plain, "frames.csv").unwrap();
        let german = plain
            .replace(',', ";")
            .replace("-20.5", "-20,5")
            .replace("0.06", "0,06");
        for other in [
            plain.replace("-20.5", "\u{2212}20.5"),
            plain.replace("frames/", "frames\\"),
            format!("sep=,\r\n{}", plain.replace('\n', "\r\n")),
            format!("\u{feff}{german}"),
            format!("sep=;\n{german}"),
            german.replace(';', "\t"),
            format!("{plain},,,,,,\n\n,,,,,,\n"),
            format!("# by hand\n\n{plain}"),
            plain.replace(
                "theta_c_deg,phi_s_deg,exposure_s",
                "Theta_c [deg],PHI_S (°),Exposure [s]",
            ),
            plain.replace(",sample,", ",Sample,"),
        ] {
            assert_eq!(
                FrameRow::read_all(&other, "frames.csv").unwrap(),
                rows,
                "{other}"
            );
        }
        let said = FrameRow::read_all(&german.replace("0,06", "x"), "frames.csv").unwrap_err();
        assert!(
            said.to_string().contains("line 2: column `exposure_s`"),
            "{said}"
        );
        // A comma for both is ambiguous.
        let said = FrameRow::read_all(&german.replace(';', ","), "frames.csv").unwrap_err();
        assert!(
            said.to_string().contains("decimals follow a point"),
            "{said}"
        );
    }

    #[test]
    fn a_list_without_frames_is_refused() {
        assert!(FrameRow::read_all(HEADER, "frames.csv").is_err());
        assert!(FrameRow::read_all("", "frames.csv").is_err());
    }
}
