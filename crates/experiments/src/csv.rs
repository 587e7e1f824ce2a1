//! Rows of tables in CSV (RFC 4180).

/// Appends fields, each followed by a comma, quoted where necessary (RFC 4180, 2).
pub(crate) fn values(text: &mut String, values: &[String]) {
    for value in values {
        if value.contains(['"', ',', '\n', '\r']) {
            *text += &format!("\"{}\",", value.replace('"', "\"\""));
        } else {
            *text += &format!("{value},");
        }
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
