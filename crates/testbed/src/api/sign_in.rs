//! Signs pages in: a code that works once becomes the secret of one page.
//!
//! A code reaches the browser by a file that only the user can read. It is in no argument, which any user of a machine can
//! see, and in no log. The page keeps its secret in its tab's session storage and shows it in a header. It gets no cookie,
//! because browsers send a host's cookies to all of its ports, also to those on which other users listen.

use std::{io, net::SocketAddr, sync::Arc};

use axum::{
    Json, Router,
    extract::{Extension, FromRequest, Request},
    routing::post,
};
use cotorra_plugin::client::SignIn;
use serde::{Deserialize, Serialize};

use super::{
    Listener, NetworkApi, auth::Caller, context::Answer, on_loopback, serve::Place, signed_in::SignIns,
    types::Failure,
};

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

/// Returns the path at which a page shows its code. It needs no token.
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
