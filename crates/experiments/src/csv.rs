//! Rows of tables in CSV (RFC 4180).

/// Appends fields, each followed by a comma.
pub(crate) fn values(text: &mut String, values: &[String]) {
    for value in values {
        *text += &quoted(value);
        text.push(',');
    }
}

/// Returns a field, quoted where necessary (RFC 4180, 2).
pub(crate) fn quoted(value: &str) -> String {
    if value.contains(['"', ',', '\n', '\r']) {
        format!("\"{}\"", value.replace('"', "\"\""))
    } else {
        value.to_owned()
    }
}

/// Appends a comma and the figure, if there is one.
pub(crate) fn push(text: &mut String, figure: Option<f64>) {
    text.push(',');
    if let Some(figure) = figure {
        // Nanosecond resolution for figures in milliseconds.
        *text += &format!("{}", (figure * 1e6).round() / 1e6);
    }
}
