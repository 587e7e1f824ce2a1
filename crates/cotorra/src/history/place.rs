//! Where a history is, as it was typed: kept as it is until it is used, so that no message shows a password in it.

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
pub enum WrongPlace {
    #[error("--history or {HISTORY_VARIABLE}: {0}")]
    #[diagnostic(help("or a file, as in runs/all.sqlite"))]
    Invalid(#[from] InvalidLocation),
    /// A kind of history that this build leaves out.
    #[error("--history or {HISTORY_VARIABLE}: {0}")]
    Unsupported(cotorra_measurements::Error),
}

/// The place as a location. An empty text, as an empty variable has it, is none.
pub fn location(place: Option<&Place>) -> Result<Option<Location>, WrongPlace> {
    let Some(Place(text)) = place.filter(|place| !place.0.is_empty()) else { return Ok(None) };
    let location: Location = text.parse()?;
    location.check().map_err(WrongPlace::Unsupported)?;
    if location.has_password() && std::env::var(HISTORY_VARIABLE).as_ref() != Ok(text) {
        note!(
            "warning: everyone on this machine can see the password in --history: leave it out there, and set \
             {PASSWORD_VARIABLE} to it"
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
    fn a_password_is_in_no_message() {
        for url in ["mysql://ana:secret@db/", "mysql://ana:secret@db:x/y", "mysql://ana:secret@db/cotorra"] {
            let place: Place = url.parse().unwrap();
            let told = format!("{place:?} {:?}", location(Some(&place)).map_err(|e| e.to_string()));
            assert!(!told.contains("secret"), "{told}");
        }
        assert!(location(Some(&Place(String::new()))).unwrap().is_none());
    }
}
