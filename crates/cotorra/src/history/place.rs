//! Where a history is, as it was typed: kept as it is until it is used, so that no message shows a password in it.

use std::{convert::Infallible, fmt, str::FromStr};

use cotorra_measurements::{InvalidLocation, Location};

/// The environment variable that names a history.
pub const HISTORY_VARIABLE: &str = "COTORRA_HISTORY";

/// A file, or the URL of a server's database with its password.
#[derive(Clone)]
pub struct Place(String);

impl FromStr for Place {
    type Err = Infallible;
    // Never an error: the parser of arguments would show the text.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.to_owned()))
    }
}

impl fmt::Debug for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Place(…)")
    }
}

/// What was typed names no history.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("--history or {HISTORY_VARIABLE}: {0}")]
#[diagnostic(help("or a file, as in runs/all.sqlite"))]
pub struct WrongPlace(InvalidLocation);

/// The place as a location. An empty text, as an empty variable has it, is none.
pub fn location(place: Option<&Place>) -> Result<Option<Location>, WrongPlace> {
    let named = place.filter(|place| !place.0.is_empty());
    named.map(|place| place.0.parse().map_err(WrongPlace)).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_password_is_in_no_message() {
        for url in ["mysql://ana:secret@db/", "mysql://ana:secret@db:x/y", "mysql://ana:secret@db/cotorra"] {
            let place: Place = url.parse().unwrap();
            let told = format!("{place:?} {:?}", location(Some(&place)).map_err(|e| e.to_string()));
            assert!(!told.contains("secret"), "{told}");
        }
        assert!(location(Some(&Place(String::new()))).unwrap().is_none());
    }
}
