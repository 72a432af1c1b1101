//! Text in the width of a terminal.

/// Wraps the lines of a text that are longer than `columns` between words. The rest of a line is indented by two columns
/// more than its beginning. Blanks within a line stay, so that columns of a table stay columns.
#[must_use]
pub fn wrapped(text: &str, columns: usize) -> String {
    let mut out = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        let (line, end) = match line.strip_suffix('\n') {
            Some(line) => (line, "\n"),
            None => (line, ""),
        };
        wrap_line(line, columns, &mut out);
        out.push_str(end);
    }
    out
}

fn wrap_line(line: &str, columns: usize, out: &mut String) {
    if width(line) <= columns {
        out.push_str(line);
        return;
    }
    let indent = line.chars().take_while(|c| *c == ' ').count();
    let hanging = (indent + 2).min(columns / 2);
    let mut used = 0;
    let mut rest = line;
    while !rest.is_empty() {
        let blanks = rest.len() - rest.trim_start_matches(' ').len();
        let (gap, after) = rest.split_at(blanks);
        let (word, after) = after.split_at(after.find(' ').unwrap_or(after.len()));
        let wide = width(word);
        let begins = out.ends_with('\n') || out.is_empty() || out.ends_with(' ');
        if !begins && used + blanks + wide > columns {
            out.push('\n');
            out.push_str(&" ".repeat(hanging));
            used = hanging;
        } else {
            out.push_str(gap);
            used += blanks;
        }
        out.push_str(word);
        used += wide;
        rest = after;
    }
}

/// Lays out the Markdown tables of a text for a terminal: in aligned columns where these fit, otherwise each row as a list of
/// its cells.
#[must_use]
pub fn tables(text: &str, columns: usize) -> String {
    let mut out = String::with_capacity(text.len());
    let mut table: Vec<Vec<&str>> = Vec::new();
    for line in text.split_inclusive('\n') {
        match cells(line.trim_end()) {
            Some(row) => table.push(row),
            None => {
                out.push_str(&laid_out(&std::mem::take(&mut table), columns));
                out.push_str(line);
            }
        }
    }
    out.push_str(&laid_out(&table, columns));
    out
}

/// The cells of a row of a Markdown table.
fn cells(line: &str) -> Option<Vec<&str>> {
    let inner = line.strip_prefix('|')?.strip_suffix('|')?;
    Some(inner.split('|').map(str::trim).collect())
}

fn laid_out(table: &[Vec<&str>], columns: usize) -> String {
    let is_content = |row: &&Vec<&str>| {
        !row.iter()
            .all(|c| !c.is_empty() && c.chars().all(|c| "-:".contains(c)))
    };
    let rows: Vec<&Vec<&str>> = table.iter().filter(is_content).collect();
    let Some(heads) = rows.first() else {
        return String::new();
    };
    let widest = |k: usize| {
        rows.iter()
            .filter_map(|row| row.get(k))
            .map(|c| width(c))
            .max()
    };
    let widths: Vec<usize> = (0..heads.len()).map(|k| widest(k).unwrap_or(0)).collect();
    let all: usize = widths.iter().map(|w| w + 2).sum();
    let mut out = String::new();
    if all <= columns + 2 {
        for row in rows {
            let mut line = String::new();
            for (cell, wide) in row.iter().zip(&widths) {
                line.push_str(cell);
                line.push_str(&" ".repeat(wide - width(cell) + 2));
            }
            out.push_str(line.trim_end());
            out.push('\n');
        }
        return out;
    }
    for row in &rows[1..] {
        let mut named = heads.iter().zip(row.iter());
        if let Some((head, cell)) = named.next() {
            out.push_str(&format!("{head}: {cell}\n"));
        }
        for (head, cell) in named.filter(|(_, cell)| !cell.is_empty()) {
            match head.is_empty() {
                true => out.push_str(&format!("  {cell}\n")),
                false => out.push_str(&format!("  {head}: {cell}\n")),
            }
        }
    }
    out
}

/// Returns the columns that a text takes, without colours (ANSI sequences).
#[must_use]
pub fn width(text: &str) -> usize {
    let mut columns = 0;
    let mut in_sequence = false;
    for c in text.chars() {
        match (in_sequence, c) {
            (false, '\u{1b}') => in_sequence = true,
            (true, c) if c.is_ascii_alphabetic() => in_sequence = false,
            (true, _) => {}
            // Combining marks take no column of their own.
            (false, '\u{300}'..='\u{36f}') => {}
            (false, _) => columns += 1,
        }
    }
    columns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lines_break_between_words_and_short_ones_stay() {
        let text = "short\n  · one two three four five\n";
        assert_eq!(
            wrapped(text, 17),
            "short\n  · one two three\n    four five\n"
        );
        assert_eq!(wrapped(text, 80), text);
    }

    #[test]
    fn a_word_that_is_too_long_stays_whole() {
        let path = "/a/path/that/is/longer";
        assert_eq!(wrapped(path, 10), path);
        assert_eq!(
            wrapped(&format!("in {path} now"), 10),
            format!("in\n  {path}\n  now")
        );
    }

    #[test]
    fn a_markdown_table_becomes_columns_or_lists() {
        let text =
            "before\n| wear | at 5° |\n| --- | --- |\n| none | 0.1 |\n| round | – |\nafter\n";
        assert_eq!(
            tables(text, 80),
            "before\nwear   at 5°\nnone   0.1\nround  –\nafter\n"
        );
        assert_eq!(
            tables(text, 10),
            "before\nwear: none\n  at 5°: 0.1\nwear: round\n  at 5°: –\nafter\n"
        );
    }

    #[test]
    fn a_cell_without_a_heading_has_no_colon_in_a_list() {
        let text = "| name | E_n | |\n|---|---|---|\n| ridge angle | 0.12 | agree |\n| roughness | 0.1 | |\n";
        assert_eq!(
            tables(text, 20),
            "name: ridge angle\n  E_n: 0.12\n  agree\nname: roughness\n  E_n: 0.1\n"
        );
    }

    #[test]
    fn columns_keep_their_blanks_and_colours_take_none() {
        assert_eq!(wrapped("a    b    c", 10), "a    b\n  c");
        assert_eq!(width("\u{1b}[1mθr\u{1b}[0m ± 2"), 6);
    }
}
