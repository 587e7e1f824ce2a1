//! Mistakes in a file, as plain data that a terminal, an editor or a test renders.

use std::{collections::BTreeSet, fmt, ops::Range};

/// A range of bytes in the source.
pub(crate) type Span = Range<usize>;

/// One mistake or warning.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// Description of it.
    pub message: String,
    /// Note at the place itself; may be empty.
    pub label: String,
    /// A correct alternative.
    pub help: Option<String>,
    /// Place in bytes of the source, on character boundaries.
    pub span: Range<usize>,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
}

/// Bytes of a line that is shown with a mistake in it. The place is lost in a longer one.
const MAX_LINE: usize = 1000;

/// All mistakes of a file, or all its warnings, in the file's order; never empty.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub struct Diagnostics {
    /// The file's name, as it was asked for.
    pub source_name: String,
    /// Text of the file; empty if it could not be read.
    pub source_text: String,
    /// The mistakes or warnings.
    pub list: Vec<Diagnostic>,
}

impl Diagnostics {
    /// Whether the source's lines are short enough to show mistakes in them.
    pub fn can_be_shown_in_place(&self) -> bool {
        self.source_text.lines().all(|line| line.len() <= MAX_LINE)
    }

    /// A mistake of a file as a whole, such as that it cannot be read.
    pub(crate) fn of_file(source_name: &str, message: String, help: &str) -> Self {
        let mut sink = Sink::default();
        sink.error(&(0..0), message).help(help);
        sink.finish(source_name, "")
    }
}

impl fmt::Display for Diagnostics {
    /// Each mistake with its place, its line and what would be right, as plain text.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, d) in self.list.iter().enumerate() {
            if i > 0 {
                writeln!(f)?;
            }
            writeln!(f, "{}:{}:{}: {}", self.source_name, d.line, d.column, d.message)?;
            if let Some(line) = self.source_text.lines().nth(d.line - 1).filter(|line| line.len() <= MAX_LINE)
            {
                let marked = self.source_text[d.span.clone()].lines().next().unwrap_or("").chars().count();
                writeln!(f, "  | {line}")?;
                let mark = format!("{}{}", " ".repeat(d.column - 1), "^".repeat(marked.max(1)));
                writeln!(f, "  | {}", format!("{mark} {}", d.label).trim_end())?;
            }
            if let Some(help) = &d.help {
                writeln!(f, "  help: {help}")?;
            }
        }
        Ok(())
    }
}

/// Collects mistakes and warnings from decoders and checks.
#[derive(Debug, Default)]
pub(crate) struct Sink {
    found: Vec<Diagnostic>,
    /// Valid settings to check before results are trusted.
    warnings: Vec<Diagnostic>,
    /// The last of those that were too many to keep.
    excess: Option<Diagnostic>,
}

impl Sink {
    /// More are not read at once; the rest shows when these are mended.
    pub const AT_MOST: usize = 100;
    /// Mistakes, and warnings, that are kept until they are sorted. A file can have millions.
    const KEPT: usize = 10_000;

    /// Something is wrong there. What would be right follows: see [`Diagnostic::help`].
    pub fn error(&mut self, span: &Span, message: impl Into<String>) -> &mut Diagnostic {
        let error = Diagnostic::new(span, message.into());
        if self.found.len() < Self::KEPT { self.found.push_mut(error) } else { self.excess.insert(error) }
    }

    /// Something there is valid, but may not be meant.
    pub fn warning(&mut self, span: &Span, message: impl Into<String>) -> &mut Diagnostic {
        let warning = Diagnostic::new(span, message.into());
        if self.warnings.len() < Self::KEPT {
            self.warnings.push_mut(warning)
        } else {
            self.excess.insert(warning)
        }
    }

    /// Whether nothing is wrong so far.
    pub fn is_empty(&self) -> bool {
        self.found.is_empty()
    }

    /// Returns all mistakes in the file's order, each once: an alias shows the same place several times.
    ///
    /// # Panics
    ///
    /// Panics if there are none.
    pub fn finish(self, source_name: &str, source_text: &str) -> Diagnostics {
        assert!(!self.found.is_empty(), "diagnostics are of something");
        Self::placed(self.found, source_name, source_text)
    }

    /// Returns all warnings as [`finish`](Self::finish) does mistakes; `None` if there are none.
    pub fn finish_warnings(self, source_name: &str, source_text: &str) -> Option<Diagnostics> {
        let list = self.warnings;
        (!list.is_empty()).then(|| Self::placed(list, source_name, source_text))
    }

    fn placed(mut list: Vec<Diagnostic>, source_name: &str, source_text: &str) -> Diagnostics {
        let lines: Vec<usize> =
            std::iter::once(0).chain(source_text.match_indices('\n').map(|(i, _)| i + 1)).collect();
        list.sort_by_key(|d| d.span.start);
        let mut seen = BTreeSet::new();
        list.retain(|d| seen.insert((d.span.start, d.message.clone())));
        list.truncate(Self::AT_MOST);
        for d in &mut list {
            d.line = lines.partition_point(|&start| start <= d.span.start);
            d.column = source_text[lines[d.line - 1]..d.span.start].chars().count() + 1;
        }
        Diagnostics { source_name: source_name.to_owned(), source_text: source_text.to_owned(), list }
    }
}

impl Diagnostic {
    fn new(span: &Span, message: String) -> Self {
        Self { message, label: String::new(), help: None, span: span.clone(), line: 0, column: 0 }
    }

    /// Says something at the place itself.
    pub(crate) fn label(&mut self, label: impl Into<String>) -> &mut Self {
        self.label = label.into();
        self
    }

    /// Says what would be right.
    pub(crate) fn help(&mut self, help: impl Into<String>) -> &mut Self {
        self.help = Some(help.into());
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_many_mistakes_keeps_few() {
        let mut sink = Sink::default();
        for at in 0..3 * Sink::KEPT {
            sink.error(&(at..at), format!("mistake {at}")).help("mend it");
            sink.warning(&(at..at), format!("warning {at}")).help("mend it");
        }
        assert_eq!((sink.found.len(), sink.warnings.len()), (Sink::KEPT, Sink::KEPT));
        let shown = sink.finish("x.yaml", &" ".repeat(3 * Sink::KEPT));
        assert_eq!(
            (shown.list[0].message.as_str(), shown.list[0].help.as_deref()),
            ("mistake 0", Some("mend it"))
        );
    }
}
