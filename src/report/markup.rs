//! HTML under construction. Only text of the program itself is written as it is; everything else is escaped.

use std::fmt::Write as _;

use crate::figures::with_true_minus;
use crate::wording::{decimals, significant, stated};

/// A part of a page.
#[derive(Debug, Default)]
pub(super) struct Markup(String);

impl Markup {
    /// Writes tags of the program.
    pub fn tags(&mut self, tags: &'static str) -> &mut Self {
        self.0.push_str(tags);
        self
    }

    /// Writes a figure of [`crate::figures`].
    pub fn figure(&mut self, svg: &str) -> &mut Self {
        self.0.push_str(svg);
        self
    }

    /// Writes text of the program.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.0.push_str(&escaped(text));
        self
    }

    /// Writes text of a user, kept apart from what is around it, in whatever direction it is written.
    pub fn foreign(&mut self, text: &str) -> &mut Self {
        self.tags("<bdi>").text(text).tags("</bdi>")
    }

    /// Writes a message of the program: what it quotes between backticks is code.
    pub fn message(&mut self, text: &str) -> &mut Self {
        self.tags("<bdi>");
        let mut parts = text.split('`').peekable();
        let mut is_code = false;
        while let Some(part) = parts.next() {
            match is_code && parts.peek().is_some() {
                true => self.tags("<code>").text(part).tags("</code>"),
                // A backtick without a partner is a character.
                false if is_code => self.text("`").text(part),
                false => self.text(part),
            };
            is_code = !is_code;
        }
        self.tags("</bdi>")
    }

    /// Writes a number as `shown`, with all its digits as the element's value.
    pub fn number(&mut self, value: f64, shown: &str) -> &mut Self {
        let full = serde_json::to_string(&value).unwrap_or_default();
        let shown = escaped(&with_true_minus(shown));
        let _ = write!(self.0, "<data value=\"{full}\">{shown}</data>");
        self
    }

    /// Writes a measured number with two digits of its uncertainty.
    pub fn measured(&mut self, value: f64, expanded: f64) -> &mut Self {
        self.number(value, &in_digits_of(value, expanded))
    }

    /// Writes a number with three significant digits.
    pub fn rounded(&mut self, value: f64) -> &mut Self {
        self.number(value, &significant(value))
    }

    /// Writes a number that was stated, with its digits.
    pub fn stated(&mut self, value: f64) -> &mut Self {
        self.number(value, &stated(value))
    }

    /// Writes a list of stated numbers; of one that is longer than `most`, the first and the last.
    pub fn list(&mut self, values: &[f64], most: usize) -> &mut Self {
        let apart = values.len() > most;
        let shown = if apart { &values[..1] } else { values };
        for (n, value) in shown.iter().enumerate() {
            if n > 0 {
                self.text(", ");
            }
            self.stated(*value);
        }
        if let (true, Some(last)) = (apart, values.last()) {
            self.text(" … ").stated(*last);
            self.text(&format!(" ({} values)", values.len()));
        }
        self
    }

    /// Writes a cell of a table.
    pub fn cell(&mut self, of: impl FnOnce(&mut Self) -> &mut Self) -> &mut Self {
        self.tags("<td>");
        of(self);
        self.tags("</td>")
    }

    /// Writes a cell with numbers, aligned to the right.
    pub fn figures(&mut self, of: impl FnOnce(&mut Self) -> &mut Self) -> &mut Self {
        self.tags("<td class=\"n\">");
        of(self);
        self.tags("</td>")
    }

    /// Writes a term with its description.
    pub fn entry(&mut self, term: &str, of: impl FnOnce(&mut Self) -> &mut Self) -> &mut Self {
        self.tags("<div><dt>").text(term).tags("</dt><dd>");
        of(self);
        self.tags("</dd></div>\n")
    }

    /// Writes the head of a table.
    pub fn header(&mut self, names: &[&str]) -> &mut Self {
        self.tags("<thead><tr>");
        for name in names {
            self.tags("<th scope=\"col\">").text(name).tags("</th>");
        }
        self.tags("</tr></thead>\n")
    }

    /// Writes a bar of a share of the width of its cell.
    pub fn bar(&mut self, share: f64) -> &mut Self {
        let width = 100.0 * share.clamp(0.0, 1.0);
        let _ = write!(
            self.0,
            "<span class=\"bar\"><i style=\"width:{width:.1}%\"></i></span>"
        );
        self
    }

    /// Returns the text.
    pub fn finish(self) -> String {
        self.0
    }
}

/// Returns a number with the decimals of an uncertainty's two digits, unless it is too large for a table.
pub(super) fn in_digits_of(value: f64, expanded: f64) -> String {
    let decimals = decimals(expanded);
    if value.abs() >= 1e7 {
        return significant(value);
    }
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        // Rounded to zero.
        Some(size) if !size.contains(|c| matches!(c, '1'..='9')) => size.to_owned(),
        _ => text,
    }
}

/// Escapes a text for HTML. Control characters have no place in a page.
pub(super) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(c),
            c if c.is_control() => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_leave_its_place() {
        let evil = "<script>alert('1')</script>&\"\u{0}\u{1b}";
        let mut page = Markup::default();
        page.foreign(evil);
        let text = page.finish();
        assert_eq!(
            text,
            "<bdi>&lt;script&gt;alert(&#39;1&#39;)&lt;/script&gt;&amp;&quot;\u{fffd}\u{fffd}</bdi>"
        );
    }

    #[test]
    fn a_message_shows_what_it_quotes_as_code() {
        let mut page = Markup::default();
        page.message("set `rig.<zero>` or `--shape`; 5` is an angle");
        assert_eq!(
            page.finish(),
            "<bdi>set <code>rig.&lt;zero&gt;</code> or <code>--shape</code>; 5` is an angle</bdi>"
        );
    }

    #[test]
    fn a_number_keeps_all_its_digits_beside_those_it_shows() {
        let mut page = Markup::default();
        page.measured(-10.012_345_678_9, 0.025);
        assert_eq!(
            page.finish(),
            "<data value=\"-10.0123456789\">\u{2212}10.012</data>"
        );
    }

    #[test]
    fn a_long_list_is_shown_by_its_ends() {
        let mut page = Markup::default();
        page.list(&[1.0, 2.5], 4).text("; ");
        page.list(&[0.0, 1.0, 2.0], 2);
        let text = page.finish();
        assert!(
            text.contains(">1</data>, <data value=\"2.5\">2.5</data>"),
            "{text}"
        );
        assert!(text.ends_with("(3 values)"), "{text}");
        assert_eq!(text.matches("<data").count(), 4);
    }
}
