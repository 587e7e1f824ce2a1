//! A testbed file in an editor: the page, and the few paths that it needs. Nothing is written but by [`Edited::save`].

use std::{convert::Infallible, io, net::SocketAddr, sync::Arc};

use axum::{
    Json, Router,
    extract::{Extension, Request, State},
    http::StatusCode,
    middleware::{self, Next},
    response::Response,
    routing::{get, post},
};
use cotorra_graph::Testbed;
use cotorra_plugin::client::SignIn;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

use super::{
    ApiError, Dashboard, Encryption, Listener, Tokens,
    auth::{foreign, shown},
    connections::{Connections, Limits, Whose},
    context::Answer,
    map::{self, MapBody},
    page,
    serve::{self, Patience, Place},
    sign_in,
    signed_in::SignIns,
    tls::{Origin, Port},
    types::{Failure, TestbedBody},
};

/// Open files, of which connections get a share: a browser opens six, and several tabs may show the page.
const OPEN_FILES: u64 = 512;

/// The file that an [`Editor`] edits.
pub trait Edited: Send + Sync + 'static {
    /// Returns its name, as a person wrote it.
    fn name(&self) -> String;
    /// Reads it.
    ///
    /// # Errors
    /// That of the system, or `InvalidData` if it is not text.
    fn read(&self) -> io::Result<String>;
    /// Replaces it as a whole, or not at all.
    ///
    /// # Errors
    /// That of the system; the file is then as before.
    fn save(&self, text: &str) -> io::Result<()>;
    /// Checks a text that may replace it.
    fn check(&self, text: &str) -> Checked;
}

/// The result of a check.
#[derive(Debug)]
pub struct Checked {
    /// The testbed; `None` if there are mistakes.
    pub testbed: Option<Testbed>,
    /// A summary, or the number of mistakes.
    pub overview: String,
    pub mistakes: Vec<Mistake>,
}

/// A mistake in a text.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Mistake {
    /// Its beginning, in UTF-16 code units, which browsers count.
    pub start: usize,
    /// Its end.
    pub end: usize,
    /// Line, from 1.
    pub line: usize,
    pub message: String,
    /// Text of `cotorra check`.
    pub shown: String,
}

/// An editor of one file, served until it is dropped.
pub struct Editor {
    dashboard: Dashboard,
    /// Ends the thread that serves when it is dropped.
    _stop: oneshot::Sender<Infallible>,
}

struct Shared {
    edited: Box<dyn Edited>,
    schema: serde_json::Value,
    pages: Arc<SignIns>,
    known: Mutex<Known>,
    /// The last valid testbed, whose map is served.
    valid: Mutex<Option<Arc<Testbed>>>,
}

/// The file as it was last seen.
struct Known {
    text: String,
    /// Grows with each change of the text.
    version: u64,
}

impl Known {
    /// Takes in what the file has now.
    fn update(&mut self, text: String) {
        if text != self.text {
            *self = Self { text, version: self.version + 1 };
        }
    }
}

impl Editor {
    /// Serves the editor. `schema` is that of testbed files.
    ///
    /// Its address is a loopback one, and only pages that this user signed in are served: other users of this machine could
    /// otherwise change the file, and with it what its user will run.
    ///
    /// # Errors
    /// [`ApiError`] if it cannot be served.
    pub fn start(
        address: SocketAddr,
        moved: bool,
        edited: impl Edited,
        text: String,
        schema: serde_json::Value,
    ) -> Result<Self, ApiError> {
        let listener = Listener::bind(address, moved, &Tokens::default(), &Encryption::Off)?;
        let pages = Arc::<SignIns>::default();
        let dashboard = Dashboard::new(&listener, Arc::clone(&pages));
        listener.tcp.set_nonblocking(true).map_err(ApiError::Start)?;
        let shared = Arc::new(Shared {
            edited: Box::new(edited),
            schema,
            pages: Arc::clone(&pages),
            known: Mutex::new(Known { text, version: 1 }),
            valid: Mutex::default(),
        });
        let app = Router::new()
            .route("/api/v1/editor", get(read).put(save))
            .route("/api/v1/editor/check", post(check))
            .route("/api/v1/map/image", get(map_image))
            .layer(middleware::from_fn_with_state(Arc::clone(&shared), admit))
            .merge(sign_in::router(pages))
            .merge(page::routes(cotorra_dashboard::editor()))
            .fallback(|| async { Failure::not_found("no such path") })
            .with_state(shared)
            .layer(middleware::from_fn(serve::attend));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(ApiError::Start)?;
        let tcp = {
            let _entered = runtime.enter();
            tokio::net::TcpListener::from_std(listener.tcp).map_err(ApiError::Start)?
        };
        let tcp = Port { listener: tcp, tls: None, origin: Origin::Machine };
        let places = Arc::new(Mutex::new(Connections::new(Limits::of(OPEN_FILES))));
        let (stop, stopped) = oneshot::channel();
        let serving = async move {
            tokio::select! {
                () = serve::serve(tcp, app, places, Patience::default()) => {}
                _ = stopped => {}
            }
        };
        let thread = std::thread::Builder::new().name("editor".to_owned());
        thread.spawn(move || runtime.block_on(serving)).map_err(ApiError::Start)?;
        Ok(Self { dashboard, _stop: stop })
    }

    /// Prepares a page for the user's browser.
    ///
    /// # Errors
    /// The system's, if the page's file cannot be written.
    pub fn page(&self) -> io::Result<SignIn> {
        self.dashboard.page("")
    }
}

async fn admit(
    State(shared): State<Arc<Shared>>,
    Extension(place): Extension<Arc<Place>>,
    request: Request,
    next: Next,
) -> Result<Response, Failure> {
    if foreign(request.headers()) {
        return Err(Failure::new(StatusCode::FORBIDDEN, "pages of other sites may not edit"));
    }
    if !shown(request.headers()).is_some_and(|shown| shared.pages.admit(shown)) {
        let reason = "this page is not signed in: open the file that `cotorra edit` named, once";
        return Err(Failure::new(StatusCode::UNAUTHORIZED, reason));
    }
    Ok(next.run(place.let_in(Whose::Operator, request).await?).await)
}

#[derive(Serialize)]
struct FileBody {
    name: String,
    text: String,
    version: u64,
    schema: serde_json::Value,
}

/// Returns the file as it is now.
async fn read(State(shared): State<Arc<Shared>>) -> Answer<FileBody> {
    let text = shared.edited.read().map_err(|error| Failure::unavailable(error.to_string()))?;
    let mut known = shared.known.lock();
    known.update(text);
    let (text, version) = (known.text.clone(), known.version);
    Ok(Json(FileBody { name: shared.edited.name(), text, version, schema: shared.schema.clone() }))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SaveBody {
    text: String,
    /// The version that the text was made from.
    version: u64,
}

#[derive(Serialize)]
struct SavedBody {
    version: u64,
}

/// Replaces the file, unless somebody else has changed it since that version.
async fn save(State(shared): State<Arc<Shared>>, Json(body): Json<SaveBody>) -> Answer<SavedBody> {
    let now = shared.edited.read().map_err(|error| Failure::unavailable(error.to_string()))?;
    let mut known = shared.known.lock();
    known.update(now);
    if known.version != body.version {
        return Err(Failure::refused("another program has changed the file"));
    }
    shared.edited.save(&body.text).map_err(|error| Failure::unavailable(format!("not saved: {error}")))?;
    known.update(body.text);
    Ok(Json(SavedBody { version: known.version }))
}

#[derive(Serialize)]
struct CheckedBody {
    overview: String,
    mistakes: Vec<Mistake>,
    testbed: Option<TestbedBody>,
    map: Option<MapBody>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CheckBody {
    text: String,
}

/// Checks a text. Saves nothing.
async fn check(
    State(shared): State<Arc<Shared>>,
    Json(CheckBody { text }): Json<CheckBody>,
) -> Answer<CheckedBody> {
    let checking = Arc::clone(&shared);
    let checked = tokio::task::spawn_blocking(move || checking.edited.check(&text));
    let Checked { testbed, overview, mistakes } =
        checked.await.map_err(|_| Failure::unavailable("the check failed"))?;
    let body = testbed.as_ref().map(|testbed| TestbedBody::new(testbed, false));
    let map = testbed.as_ref().and_then(|testbed| testbed.map.as_ref()).map(MapBody::from);
    if let Some(testbed) = testbed {
        *shared.valid.lock() = Some(Arc::new(testbed));
    }
    Ok(Json(CheckedBody { overview, mistakes, testbed: body, map }))
}

/// Returns the map of the last valid text.
async fn map_image(State(shared): State<Arc<Shared>>) -> Result<Response, Failure> {
    let valid = shared.valid.lock().clone();
    map::picture(valid.ok_or_else(|| Failure::not_found("nothing valid was checked yet"))?)
}
