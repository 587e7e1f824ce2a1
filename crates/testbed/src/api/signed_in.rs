//! The pages that are signed in, and the codes by which others can be.

use std::{
    collections::VecDeque,
    env,
    io::{self, Write as _},
    path::PathBuf,
};

use cotorra_plugin::client::SignIn;
use parking_lot::Mutex;
use tempfile::NamedTempFile;

use super::token::Token;

/// Codes that can be open at a time; a new one replaces the oldest.
const CODES: usize = 16;
/// Pages that can be signed in at a time; a new one replaces the oldest.
const PAGES: usize = 64;

/// The pages that are signed in, and the codes by which others can be.
#[derive(Default)]
pub(super) struct SignIns {
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// The oldest first. A file is removed with its code.
    codes: VecDeque<(Token, NamedTempFile)>,
    /// The oldest first.
    pages: VecDeque<Token>,
}

impl SignIns {
    /// Returns a page at an address, with a new code.
    ///
    /// # Errors
    /// The system's, if the file cannot be written.
    pub(super) fn page(&self, address: &str) -> io::Result<SignIn> {
        let code = Token::random()?;
        let address = format!("{address}#{}", code.secret());
        // The folder of the session where there is one: it is in memory, and ends with the session.
        let folder = env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|folder| folder.is_dir());
        let mut builder = tempfile::Builder::new();
        // Readable and writable by this user only.
        builder.prefix("cotorra-page-").suffix(".html");
        let mut file = builder.tempfile_in(folder.unwrap_or_else(env::temp_dir))?;
        let escaped = address.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;");
        writeln!(
            file,
            "<!doctype html><meta charset=\"utf-8\"><meta name=\"referrer\" content=\"no-referrer\">\n\
             <meta http-equiv=\"refresh\" content=\"0; url={escaped}\">\n\
             <title>cotorra</title><a href=\"{escaped}\">Open cotorra</a>"
        )?;
        let page = SignIn { file: file.path().to_owned(), address };
        let mut state = self.state.lock();
        state.codes.push_back((code, file));
        if state.codes.len() > CODES {
            state.codes.pop_front();
        }
        Ok(page)
    }

    /// Uses up a code. Returns the secret of the page; `None` if there is no such code.
    pub(super) fn redeem(&self, code: &str) -> io::Result<Option<Token>> {
        let secret = Token::random()?;
        let mut state = self.state.lock();
        let Some(at) = state.codes.iter().position(|(open, _)| open.is(code)) else { return Ok(None) };
        state.codes.remove(at);
        state.pages.push_back(secret.clone());
        if state.pages.len() > PAGES {
            state.pages.pop_front();
        }
        Ok(Some(secret))
    }

    /// Whether a text is the secret of a page that is signed in.
    pub(super) fn admit(&self, shown: &str) -> bool {
        self.state.lock().pages.iter().fold(false, |found, page| found | page.is(shown))
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::PermissionsExt};

    use super::*;

    fn code(page: &SignIn) -> &str {
        page.address.split_once('#').unwrap().1
    }

    #[test]
    fn a_code_signs_in_one_page_and_its_file_is_removed() {
        let pages = SignIns::default();
        let page = pages.page("http://127.0.0.1:7700/?compare=2&x=<").unwrap();
        assert_eq!(fs::metadata(&page.file).unwrap().permissions().mode() & 0o777, 0o600);
        let text = fs::read_to_string(&page.file).unwrap();
        assert!(text.contains(&format!("?compare=2&amp;x=&lt;#{}\"", code(&page))), "{text}");
        assert!(!pages.admit(code(&page)), "a code is not a secret");
        assert!(pages.redeem("another").unwrap().is_none());
        let secret = pages.redeem(code(&page)).unwrap().unwrap();
        assert!(pages.admit(secret.secret()) && !pages.admit(""));
        assert!(!page.file.exists());
        assert!(pages.redeem(code(&page)).unwrap().is_none(), "a code works once");
    }

    #[test]
    fn codes_and_pages_are_bounded() {
        let pages = SignIns::default();
        let many: Vec<_> = (0..=CODES).map(|_| pages.page("http://127.0.0.1:7700/").unwrap()).collect();
        assert!(!many[0].file.exists() && pages.redeem(code(&many[0])).unwrap().is_none());
        assert!(pages.redeem(code(&many[1])).unwrap().is_some());
        let secrets: Vec<_> = (0..=PAGES)
            .map(|_| pages.redeem(code(&pages.page("http://x/").unwrap())).unwrap().unwrap())
            .collect();
        assert!(!pages.admit(secrets[0].secret()) && pages.admit(secrets[1].secret()));
    }
}
