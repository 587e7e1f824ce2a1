//! Standard output and standard error. A reader that closes the pipe, as in `cotorra schema | head`, is no error.
//!
//! Names, reasons, logs and errors may be of others. What they could do to a terminal is escaped here, for all text that people
//! read.

use std::{
    borrow::Cow,
    fmt::Arguments,
    io::{self, Write},
};

use miette::{IntoDiagnostic, WrapErr};

/// Prints text for people to standard output, with control characters escaped. Succeeds if the reader has closed the pipe.
pub fn print(text: &str) -> miette::Result<()> {
    print_exact(&escaped(text, console::colors_enabled()))
}

/// Prints text for programs to standard output, such as JSON, byte by byte. Succeeds if the reader has closed the pipe.
pub fn print_exact(text: &str) -> miette::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        done => done.into_diagnostic().wrap_err("cannot write to standard output"),
    }
}

/// Prints JSON or CSV exactly, or text for people with control characters escaped.
pub fn print_either(is_exact: bool, text: &str) -> miette::Result<()> {
    if is_exact { print_exact(text) } else { print(text) }
}

/// Writes a line to standard error.
#[macro_export]
macro_rules! note {
    ($($text:tt)*) => {
        $crate::write_note(format_args!("{}\n", format_args!($($text)*)))
    };
}

/// Writes to standard error, with control characters escaped. Text that cannot be written is lost: a closed pipe or a full disk
/// must not end a run.
pub fn write_note(text: Arguments<'_>) {
    let text = text.to_string();
    let _ = io::stderr().lock().write_all(escaped(&text, console::colors_enabled_stderr()).as_bytes());
}

/// Returns a text with escapes, such as `\u{1b}`, in place of characters that control a terminal or turn the direction of text.
/// If `styled`, colours and weights stay: cotorra writes them, too, and they do nothing else.
pub fn escaped(text: &str, styled: bool) -> Cow<'_, str> {
    if !text.contains(controls) {
        return Cow::Borrowed(text);
    }
    let (mut shown, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(at) = rest.find(controls) {
        shown.push_str(&rest[..at]);
        rest = &rest[at..];
        let length = style(rest).filter(|_| styled);
        if let Some(length) = length {
            shown.push_str(&rest[..length]);
            rest = &rest[length..];
        } else {
            let control = rest.chars().next().expect("it was just found");
            shown.extend(control.escape_unicode());
            rest = &rest[control.len_utf8()..];
        }
    }
    shown.push_str(rest);
    Cow::Owned(shown)
}

/// Whether a character controls a terminal (C0 but line feeds and tabs, DEL, C1) or turns the direction of text.
fn controls(c: char) -> bool {
    (c.is_control() && c != '\n' && c != '\t')
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{61c}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Returns the length of the colour or weight at the beginning of a text, as in `ESC [ 1 ; 31 m`. Hidden text (8) is none.
fn style(text: &str) -> Option<usize> {
    let codes = text.strip_prefix("\u{1b}[")?;
    let end = codes.find('m').filter(|end| *end <= 32)?;
    let (codes, begin) = (&codes[..end], text.len() - codes.len());
    let is_plain = codes.bytes().all(|byte| byte.is_ascii_digit() || byte == b';');
    let hides = codes.split(';').any(|code| code.trim_start_matches('0') == "8");
    (is_plain && !hides).then_some(begin + end + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_controls_a_terminal_is_escaped() {
        for (text, expected) in [
            ("plain, añadido 日本\n\tnext", "plain, añadido 日本\n\tnext"),
            ("\u{1b}]0;title\u{7}", "\\u{1b}]0;title\\u{7}"),
            ("\u{1b}[2J\u{9b}2J\r\u{8}", "\\u{1b}[2J\\u{9b}2J\\r\\u{8}"),
            ("a\u{202e}b\u{2066}c\u{200f}", "a\\u{202e}b\\u{2066}c\\u{200f}"),
            ("\u{1b}[1;31mred\u{1b}[0m", "\\u{1b}[1;31mred\\u{1b}[0m"),
        ] {
            let expected = expected.replace("\\r", "\\u{d}");
            assert_eq!(escaped(text, false), expected);
        }
    }

    #[test]
    fn only_colours_and_weights_stay_in_styled_text() {
        assert_eq!(escaped("\u{1b}[1;31mred\u{1b}[0m", true), "\u{1b}[1;31mred\u{1b}[0m");
        for text in ["\u{1b}[8mhidden", "\u{1b}[2J", "\u{1b}[?25lm", "\u{1b}]0;x\u{7}", "\u{1b}[31", "\u{1b}"]
        {
            assert!(!escaped(text, true).contains('\u{1b}'), "{text:?}");
        }
    }
}
