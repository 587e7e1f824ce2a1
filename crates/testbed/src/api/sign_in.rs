//! Signs pages in: a code that works once becomes the secret of one page.
//!
//! A code reaches the browser by a file that only the user can read. It is in no argument, which any user of a machine can
//! see, and in no log. The page keeps its secret in its tab's session storage and shows it in a header. It gets no cookie,
//! because browsers send a host's cookies to all of its ports, also to those on which other users listen.

use std::{
    collections::VecDeque,
    env,
    io::{self, Write as _},
    net::SocketAddr,
    path::PathBuf,
    sync::Arc,
};

use axum::{
    Json, Router,
    extract::{Extension, FromRequest, Request},
    routing::post,
};
use cotorra_plugin::client::SignIn;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use tempfile::NamedTempFile;

use super::{
    Listener, NetworkApi,
    auth::{Caller, Token},
    context::Answer,
    on_loopback,
    serve::Place,
    types::Failure,
};

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

/// The dashboard of a run, a replay or a view.
#[derive(Clone)]
pub struct Dashboard {
    api: SocketAddr,
    network: Option<NetworkApi>,
    pages: Arc<SignIns>,
}

impl Dashboard {
    pub(super) fn new(listener: &Listener, pages: Arc<SignIns>) -> Self {
        let own = listener.address();
        let api = if own.ip().is_unspecified() { on_loopback(own) } else { own };
        Self { api, network: listener.network.clone(), pages }
    }

    /// Returns the address of the API on this machine, which is also that of the dashboard.
    pub fn address(&self) -> SocketAddr {
        self.api
    }

    /// Returns how other machines reach the API; `None` if they do not.
    pub fn network(&self) -> Option<&NetworkApi> {
        self.network.as_ref()
    }

    /// Prepares a page for the user's browser. `query` follows the address, and can be empty.
    ///
    /// # Errors
    /// The system's, if the page's file cannot be written.
    pub fn page(&self, query: &str) -> io::Result<SignIn> {
        self.pages.page(&format!("http://{}/{query}", self.api))
    }
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
    fn redeem(&self, code: &str) -> io::Result<Option<Token>> {
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

/// Returns the path at which a page shows its code. Nobody needs a token there.
pub(super) fn router<S: Clone + Send + Sync + 'static>(pages: Arc<SignIns>) -> Router<S> {
    Router::new().route("/api/v1/sign-in", post(move |place, request| sign_in(pages, place, request)))
}

/// Returns the path at which the operator gets a page of the dashboard.
pub(super) fn pages<S: Clone + Send + Sync + 'static>(dashboard: Dashboard) -> Router<S> {
    let page = move |caller: Extension<Caller>| async move {
        caller.operator()?;
        let failed = |error: io::Error| Failure::unavailable(format!("cannot prepare the page: {error}"));
        Ok::<_, Failure>(Json(dashboard.page("").map_err(failed)?))
    };
    Router::new().route("/api/v1/sign-in/pages", post(page))
}

#[derive(Deserialize)]
struct CodeBody {
    code: String,
}

#[derive(Serialize)]
struct SecretBody {
    token: String,
}

async fn sign_in(
    pages: Arc<SignIns>,
    Extension(place): Extension<Arc<Place>>,
    request: Request,
) -> Answer<SecretBody> {
    let request = place.read(request).await?;
    let Json(CodeBody { code }) =
        Json::from_request(request, &()).await.map_err(|error| Failure::bad_request(error.to_string()))?;
    let failed = |error: io::Error| Failure::unavailable(format!("cannot sign the page in: {error}"));
    match pages.redeem(&code).map_err(failed)? {
        Some(secret) => Ok(Json(SecretBody { token: secret.secret().to_owned() })),
        None => Err(Failure::unauthorized()),
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
