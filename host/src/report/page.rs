//! HTML of the report: figures with their keys, escaping, the page around them.

use plotters::style::RGBColor;

/// A plot with its words.
pub(super) struct Figure {
    pub(super) title: String,
    pub(super) caption: String,
    pub(super) keys: Vec<Key>,
    pub(super) svg: String,
}

/// One entry of a legend. Drawn with borders, which browsers print while they leave out backgrounds.
pub(super) struct Key {
    shape: &'static str,
    text: &'static str,
    color: RGBColor,
}

impl Key {
    pub(super) fn line(text: &'static str, color: RGBColor) -> Self {
        Key { shape: "line", text, color }
    }

    pub(super) fn dashed(text: &'static str, color: RGBColor) -> Self {
        Key { shape: "dashed", text, color }
    }

    pub(super) fn band(text: &'static str, color: RGBColor) -> Self {
        Key { shape: "band", text, color }
    }

    pub(super) fn faint(text: &'static str, color: RGBColor) -> Self {
        Key { shape: "faint", text, color }
    }

    pub(super) fn dot(text: &'static str, color: RGBColor) -> Self {
        Key { shape: "dot", text, color }
    }

    fn html(&self) -> String {
        let RGBColor(r, g, b) = self.color;
        let (shape, text) = (self.shape, escape(self.text));
        format!("<li><i class=\"{shape}\" style=\"border-color:rgb({r},{g},{b})\"></i>{text}</li>")
    }
}

impl Figure {
    pub(super) fn html(&self) -> String {
        let keys: String = self.keys.iter().map(Key::html).collect();
        format!(
            "<figure>\n<h3>{}</h3>\n<ul class=\"keys\">{keys}</ul>\n<div class=\"plot\">{}</div>\n\
             <figcaption>{}</figcaption>\n</figure>\n",
            escape(&self.title),
            self.svg,
            escape(&self.caption)
        )
    }
}

/// The whole document: nothing is loaded from anywhere.
pub(super) fn document(title: &str, body: &str) -> String {
    let title = escape(title);
    let style = include_str!("style.css");
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n{body}</main>\n</body>\n</html>\n"
    )
}

/// Characters that turn the direction of the text that follows.
const DIRECTIONS: [char; 9] = [
    '\u{202A}', '\u{202B}', '\u{202C}', '\u{202D}', '\u{202E}', '\u{2066}', '\u{2067}', '\u{2068}',
    '\u{2069}',
];

/// Text that a site or a file may contain, safe inside HTML and attributes.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() && c != '\n' || DIRECTIONS.contains(&c) => out.push('\u{FFFD}'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regress_site_names_cannot_carry_markup() {
        assert_eq!(escape("<script>'&\"\u{1}\u{202E}"), "&lt;script&gt;&#39;&amp;&quot;\u{FFFD}\u{FFFD}");
    }
}
