//! What the subcommands print.

use std::io::{ErrorKind, Write};

use crate::recording::Skipped;

/// Prints to standard output. A reader that has gone away (`cpcm … | head`) is no failure.
pub(super) fn print(text: &str) -> anyhow::Result<()> {
    let (text, mut out) = (harmless(text), std::io::stdout().lock());
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

/// Prints a value as JSON.
pub(super) fn print_json(value: &serde_json::Value) -> anyhow::Result<()> {
    print(&format!("{value:#}\n"))
}

/// Lists the passages that were left out, on standard error.
pub(super) fn warn_skipped(skipped: &[Skipped]) {
    for s in skipped {
        let which = match s.passage_id {
            Some(id) => format!("passage {id}"),
            None => format!("the passage in row {} (counted from 0)", s.row),
        };
        complain(&format!("warning: {which} is left out: {}\n", s.reason));
    }
}

/// One warning on standard error.
pub(super) fn warn(what: &str) {
    complain(&format!("warning: {what}\n"));
}

/// An error and its causes, outermost first; none that the one before has said already.
pub(super) fn print_error(error: &anyhow::Error) {
    let mut said = error.to_string();
    let mut text = format!("error: {said}\n");
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !said.ends_with(&cause) {
            text.push_str(&format!("  because: {cause}\n"));
        }
        said = cause;
    }
    complain(&text);
}

/// Standard error may be closed too; there is nowhere left to say so.
pub(super) fn complain(text: &str) {
    let _ = std::io::stderr().lock().write_all(harmless(text).as_bytes());
}

/// Without what would command a terminal: names come from files.
fn harmless(text: &str) -> String {
    text.replace(|c: char| c.is_control() && c != '\n' && c != '\t', "\u{fffd}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_nothing_printed_commands_a_terminal() {
        assert_eq!(harmless("GN\u{1b}[31m 648\u{9b}2J\r\n\tµ"), "GN\u{fffd}[31m 648\u{fffd}2J\u{fffd}\n\tµ");
    }
}
