//! The location of a history, as the user wrote it.
//!
//! It is parsed only when it is used, so that no message of the argument parser shows a password in it.

use std::{convert::Infallible, fmt, str::FromStr};

use cotorra_measurements::{InvalidLocation, Location};

/// The environment variable that names a history.
pub const HISTORY_VARIABLE: &str = "COTORRA_HISTORY";

/// The environment variable that has the password of a history's server.
pub const PASSWORD_VARIABLE: &str = "COTORRA_HISTORY_PASSWORD";

/// A file, or the URL of a server's database with its password.
#[derive(Clone)]
pub struct Place(String);

impl FromStr for Place {
    type Err = Infallible;
    // Never fails, because the argument parser would show the text in its error.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.to_owned()))
    }
}

impl fmt::Debug for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Place(…)")
    }
}

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum WrongPlace {
    #[error("--history or {HISTORY_VARIABLE}: {0}")]
    #[diagnostic(help("or name a file, as in runs/all.sqlite"))]
    Invalid(#[from] InvalidLocation),
    /// A kind of history that this build does not include.
    #[error("--history or {HISTORY_VARIABLE}: {0}")]
    Unsupported(cotorra_measurements::Error),
}

/// Parses the location. An empty text, as from an empty variable, counts as none.
pub fn location(place: Option<&Place>) -> Result<Option<Location>, WrongPlace> {
    let Some(Place(text)) = place.filter(|place| !place.0.is_empty()) else { return Ok(None) };
    let location: Location = text.parse()?;
    location.check().map_err(WrongPlace::Unsupported)?;
    if location.has_password() && std::env::var(HISTORY_VARIABLE).as_ref() != Ok(text) {
        note!(
            "warning: everyone on this machine can see the password in --history; put it into the environment variable \
             {PASSWORD_VARIABLE} instead"
        );
    }
    Ok(Some(match std::env::var(PASSWORD_VARIABLE) {
        Ok(password) if !password.is_empty() => location.with_password(&password),
        _ => location,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_message_shows_a_password() {
        for url in ["mysql://ana:secret@db/", "mysql://ana:secret@db:x/y", "mysql://ana:secret@db/cotorra"] {
            let place: Place = url.parse().unwrap();
            let messages = format!("{place:?} {:?}", location(Some(&place)).map_err(|e| e.to_string()));
            assert!(!messages.contains("secret"), "{messages}");
        }
        assert!(location(Some(&Place(String::new()))).unwrap().is_none());
    }
}
