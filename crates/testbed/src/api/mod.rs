//! The HTTP API: the current state, the history, events, and instructions. A script can do everything here that bundled
//! plug-ins can. The API is described at `/openapi.json`.

mod application_tokens;
mod applications;
mod auth;
mod bandwidth;
mod capture;
mod clock;
mod connections;
mod context;
mod coverage;
#[cfg(test)]
mod document;
mod editor;
mod map;
mod measurements;
mod mec;
mod page;
mod readiness;
mod routes;
mod sensors;
mod serve;
mod sign_in;
mod signed_in;
mod stream;
mod tls;
mod token;
mod turns;
mod types;

use std::{
    io::ErrorKind,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr},
    sync::Arc,
};

use axum::{
    Extension, Router, middleware,
    routing::{MethodRouter, delete, get, post},
};
use cotorra_mec::Delivery;
use cotorra_plugin::runs::{Announced, Runs, RunsError};
use parking_lot::Mutex;
use rustls::ServerConfig;
use tokio::sync::oneshot;

use self::{
    auth::Gate,
    connections::{Connections, Limits},
    context::BLOCKING_THREADS,
    serve::Patience,
    signed_in::SignIns,
    tls::{Origin, Port},
};
use crate::domain::Domains;

/// Returns the OpenAPI document of application life cycle management.
pub fn app_lcm_openapi() -> String {
    applications::openapi()
}

pub(crate) use application_tokens::Applications;
pub(crate) use auth::PluginTokens;
pub use auth::{Operator, Tokens, TokensError};
pub(crate) use context::{Context, Lockstep, WaisOptions};
pub use editor::{Checked, Edited, Editor, Mistake};
pub use sign_in::Dashboard;
pub use tls::{Encryption, NetworkApi, TlsError};
pub use token::Token;

#[cfg(test)]
mod tests;

/// Error of serving the API.
#[derive(Debug, thiserror::Error)]
pub enum ApiError {
    /// The address is in use, or not this machine's.
    #[error("cannot serve the API on {address}: {source}{}", remedy(source))]
    Bind {
        address: SocketAddr,
        /// The system's error.
        source: std::io::Error,
    },
    /// A token is for a domain that does not exist.
    #[error("a token is for the domain `{0}`, which the testbed does not have")]
    NoSuchDomain(cotorra_graph::DomainId),
    /// The limit of open files cannot be read.
    #[error("cannot read the limit of open files, which bounds the API's connections: {0}")]
    OpenFiles(cotorra_datapath::Error),
    /// A thread or a runtime cannot be started.
    #[error("cannot start the API's server: {0}")]
    Start(std::io::Error),
    /// The certificate for an address other than loopback cannot be used.
    #[error("cannot serve the API on {address} with TLS: {source}")]
    Tls {
        address: SocketAddr,
        /// Cause.
        source: TlsError,
    },
    /// An address other than loopback needs a token.
    #[error(
        "{0} is not a loopback address: set COTORRA_TOKEN, so that not everyone on the network can move the robots"
    )]
    TokenMissing(SocketAddr),
}

/// Returns what to do about an address that cannot be bound.
fn remedy(error: &std::io::Error) -> &'static str {
    match error.kind() {
        ErrorKind::AddrInUse => {
            "; another program serves there: name another port, or none, so that a free one is found"
        }
        ErrorKind::AddrNotAvailable => "; it is not an address of this machine",
        _ => "",
    }
}

/// Returns all paths with their handlers. [`openapi`] describes the same.
fn paths() -> [(&'static str, MethodRouter<Context>); 38] {
    [
        ("/api/v1/testbed", get(routes::testbed)),
        ("/api/v1/clock", get(clock::clock).post(clock::control)),
        ("/api/v1/map", get(map::map)),
        ("/api/v1/map/image", get(map::image)),
        ("/api/v1/network/nodes/{id}", get(routes::node)),
        ("/api/v1/network/nodes/{id}/machine", get(routes::machine)),
        ("/api/v1/robots", get(routes::robots)),
        ("/api/v1/robots/{id}", get(routes::robot)),
        ("/api/v1/robots/{id}/candidates", get(routes::candidates)),
        ("/api/v1/robots/{id}/sensors", get(sensors::sensors)),
        ("/api/v1/robots/{id}/sensors/{name}/{reading}", get(sensors::large_data)),
        ("/api/v1/network/links", get(routes::links)),
        ("/api/v1/network/links/{id}/throughput-test", post(routes::test_throughput)),
        ("/api/v1/network/captures/{id}", get(capture::capture)),
        ("/api/v1/network/radio-units", get(routes::radio_units)),
        ("/api/v1/network/coverage", get(coverage::coverage)),
        ("/api/v1/network/placements", get(routes::placements)),
        ("/api/v1/network/applications", get(readiness::applications)),
        ("/api/v1/network/virtual-links", get(routes::virtual_links)),
        ("/api/v1/vnfs", get(routes::vnfs).post(routes::add_vnf)),
        ("/api/v1/vnfs/{vnf}", delete(routes::remove_vnf)),
        ("/api/v1/instructions", post(routes::instruct)),
        ("/api/v1/measurements/robots/{id}", get(measurements::robot_history)),
        ("/api/v1/measurements/links/{id}", get(measurements::link_history)),
        ("/api/v1/measurements/machines/{id}", get(measurements::machine_history)),
        ("/api/v1/measurements/service-times", get(measurements::service_times)),
        ("/api/v1/measurements/handovers", get(measurements::handovers)),
        ("/api/v1/measurements/events", get(measurements::event_history)),
        ("/api/v1/measurements/state", get(measurements::state)),
        ("/api/v1/measurements/series", get(measurements::series)),
        ("/api/v1/measurements/gaps", get(measurements::gaps)),
        ("/api/v1/measurements/retained", get(measurements::retained)),
        ("/api/v1/measurements/runs", get(measurements::runs)),
        ("/api/v1/measurements/verdict", get(measurements::verdict)),
        ("/api/v1/measurements/kpis", get(measurements::kpis)),
        ("/api/v1/measurements/difference", get(measurements::difference)),
        ("/api/v1/events", get(stream::events)),
        ("/api/v1/marks/{number}", post(stream::done)),
    ]
}

/// Returns the OpenAPI document, which is checked in. A test derives it from the types and handlers, and compares.
pub fn openapi() -> String {
    include_str!("../../../../docs/openapi.json").to_owned()
}

/// An API, which answers once it is open. Ends when it is dropped.
pub(crate) struct Server {
    dashboard: Dashboard,
    plugins: PluginTokens,
    open: Option<oneshot::Sender<()>>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
    announced: Option<Announced>,
    _delivery: Delivery,
}

/// Address of the API where none is chosen.
pub(crate) const DEFAULT_ADDRESS: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 7700);

/// Connections that wait to be accepted. A client that finds no room retries a second later.
const BACKLOG: i32 = 4096;

/// A reserved address, where nothing is served yet.
pub(crate) struct Listener {
    tcp: std::net::TcpListener,
    /// Port at which this machine reaches a run with TLS on an address that is not loopback.
    loopback: Option<std::net::TcpListener>,
    tls: Option<Arc<ServerConfig>>,
    network: Option<NetworkApi>,
    announced: Option<Announced>,
    /// Port of an emulated node for these applications.
    on_node: Option<std::net::TcpListener>,
    applications: Applications,
}

impl Listener {
    /// Reserves an address, or the next free port if it may be `moved`. Beyond loopback, `encryption` protects it.
    pub(crate) fn bind(
        address: SocketAddr,
        moved: bool,
        tokens: &Tokens,
        encryption: &Encryption,
    ) -> Result<Self, ApiError> {
        let is_local = address.ip().is_loopback();
        if !is_local && !tokens.work_from_afar() {
            return Err(ApiError::TokenMissing(address));
        }
        let tcp = bind(address, moved)?;
        let mut listener = Self {
            tcp,
            loopback: None,
            tls: None,
            network: None,
            announced: None,
            on_node: None,
            applications: Applications::default(),
        };
        let bound = listener.address();
        if address.port() != 0 && bound != address {
            tracing::warn!("{address} is taken: the API is on {bound}");
        }
        if is_local {
            return Ok(listener);
        }
        let of_tls = |source| ApiError::Tls { address, source };
        listener.network = Some(match tls::configure(encryption, address).map_err(of_tls)? {
            Some((config, identity)) => {
                if !address.ip().is_unspecified() {
                    listener.loopback = Some(bind(on_loopback(bound), true)?);
                }
                listener.tls = Some(config);
                NetworkApi { url: tls::url("https", bound), identity: Some(identity) }
            }
            None => {
                tracing::warn!(
                    "the API on {bound} has no TLS: whoever sees its packets sees the token, and can then steer the run"
                );
                NetworkApi { url: tls::url("http", bound), identity: None }
            }
        });
        Ok(listener)
    }

    /// Lets tools of this user find the API among these runs: that of the testbed `name`, and what it is.
    pub(crate) fn announced(self, runs: Option<&Runs>, name: &str, what: &str) -> Self {
        let announced = runs.and_then(|runs| {
            let told = |error: &RunsError| tracing::warn!("other commands do not find this run: {error}");
            runs.announce(self.address(), name, what).inspect_err(told).ok()
        });
        Self { announced, ..self }
    }

    /// Also lets applications reach services of ETSI MEC at a port of an emulated node.
    pub(crate) fn on_node(self, tcp: Option<std::net::TcpListener>, applications: Applications) -> Self {
        Self { on_node: tcp, applications, ..self }
    }

    /// Returns the address at which programs of this machine reach the API without TLS.
    pub(crate) fn address(&self) -> SocketAddr {
        let listener = self.loopback.as_ref().unwrap_or(&self.tcp);
        listener.local_addr().expect("a bound socket has an address")
    }
}

/// Binds a port, or any if it is taken and may be `moved`.
fn bind(address: SocketAddr, moved: bool) -> Result<std::net::TcpListener, ApiError> {
    let any_port = SocketAddr::new(address.ip(), 0);
    std::net::TcpListener::bind(address)
        .or_else(|e| if moved { std::net::TcpListener::bind(any_port) } else { Err(e) })
        .map_err(|source| ApiError::Bind { address, source })
}

/// Returns the loopback address with the port of another.
fn on_loopback(address: SocketAddr) -> SocketAddr {
    let ip = if address.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() };
    SocketAddr::new(ip, address.port())
}

impl Server {
    /// Starts a thread that serves the API once it is open. Connections wait until then.
    pub(crate) fn start(listener: Listener, context: Context, tokens: Tokens) -> Result<Self, ApiError> {
        let open_files = cotorra_datapath::raise_open_files().map_err(ApiError::OpenFiles)?;
        Self::start_within(listener, context, tokens, Limits::of(open_files), Patience::default())
    }

    /// Does the same with other limits.
    fn start_within(
        listener: Listener,
        context: Context,
        tokens: Tokens,
        limits: Limits,
        patience: Patience,
    ) -> Result<Self, ApiError> {
        let domains = Arc::new(Domains::new(&context.testbed));
        if let Some(domain) = tokens.domains().find(|domain| domains.view(domain).is_none()) {
            return Err(ApiError::NoSuchDomain(domain.clone()));
        }
        let programs = crate::plugins::programs(&context.testbed).filter(|id| context.hosted.contains(*id));
        let plugins = PluginTokens::new(programs).map_err(ApiError::Start)?;
        let pages = Arc::new(SignIns::default());
        let gate = Gate::new(
            tokens,
            plugins.clone(),
            Arc::clone(&domains),
            Arc::clone(&pages),
            listener.applications.clone(),
        );
        let dashboard = Dashboard::new(&listener, Arc::clone(&pages));
        for tcp in listener.loopback.iter().chain([&listener.tcp]).chain(&listener.on_node) {
            tcp.set_nonblocking(true).map_err(ApiError::Start)?;
            socket2::SockRef::from(tcp).listen(BACKLOG).map_err(ApiError::Start)?;
        }
        let mut announced = listener.announced;
        let local = announced.as_mut().and_then(Announced::listener);
        if let Some(local) = &local {
            local.set_nonblocking(true).map_err(ApiError::Start)?;
        }
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(BLOCKING_THREADS)
            .build()
            .map_err(ApiError::Start)?;
        let (open, opened) = oneshot::channel();
        let (stop, stopped) = oneshot::channel();
        let document = openapi();
        let mec = mec::serve(&context, gate.clone(), &domains);
        let (mec, mut senders, readiness) = (mec.router, mec.tasks, mec.readiness);
        let for_nodes = mec::on_node(mec.clone()).layer(middleware::from_fn(serve::attend));
        let (lifecycle, more) = applications::serve(&context, gate.clone());
        senders.extend(more);
        let delivery = Delivery::start(senders).map_err(ApiError::Start)?;
        let app = paths()
            .into_iter()
            .fold(Router::new(), |router, (path, methods)| router.route(path, methods))
            .merge(sign_in::pages(dashboard.clone()))
            .layer(Extension(readiness))
            .layer(middleware::from_fn_with_state(gate, auth::check))
            .merge(sign_in::router(pages))
            .route(
                "/openapi.json",
                get(move || async move { ([("content-type", "application/json")], document) }),
            )
            .merge(page::routes(cotorra_dashboard::files()))
            .fallback(|| async { types::Failure::not_found("no such path; see /openapi.json") })
            .with_state(context)
            .merge(mec)
            .merge(lifecycle)
            .layer(middleware::from_fn(serve::attend));
        let thread = std::thread::Builder::new()
            .name("api".to_owned())
            .spawn(move || {
                runtime.block_on(async move {
                    let port = |tcp, tls, origin| {
                        let listener = tokio::net::TcpListener::from_std(tcp)?;
                        Ok::<_, std::io::Error>(Port { listener, tls, origin })
                    };
                    let listeners = port(listener.tcp, listener.tls, Origin::Machine).and_then(|tcp| {
                        let loopback = listener.loopback.map(|tcp| port(tcp, None, Origin::Machine));
                        let on_node = listener.on_node.map(|tcp| port(tcp, None, Origin::Node));
                        let local = local.map(tokio::net::UnixListener::from_std);
                        Ok((tcp, loopback.transpose()?, on_node.transpose()?, local.transpose()?))
                    });
                    let (tcp, loopback, on_node, local) = match listeners {
                        Ok(listeners) => listeners,
                        Err(error) => return tracing::error!("the API is not served: {error}"),
                    };
                    if opened.await.is_err() {
                        return;
                    }
                    let places = |limits| Arc::new(Mutex::new(Connections::new(limits)));
                    let of_ports = places(limits);
                    let to_user = async {
                        match local {
                            Some(local) => {
                                serve::serve(local, app.clone(), places(limits.of_user()), patience).await;
                            }
                            None => std::future::pending().await,
                        }
                    };
                    let on_loopback = async {
                        match loopback {
                            Some(tcp) => {
                                serve::serve(tcp, app.clone(), Arc::clone(&of_ports), patience).await
                            }
                            None => std::future::pending().await,
                        }
                    };
                    let to_applications = async {
                        match on_node {
                            Some(tcp) => {
                                serve::serve(tcp, for_nodes, places(limits), patience).await;
                            }
                            None => std::future::pending().await,
                        }
                    };
                    // An open event stream must not keep a finished run alive, so this stops at once rather than
                    // gracefully.
                    tokio::select! {
                        () = serve::serve(tcp, app.clone(), Arc::clone(&of_ports), patience) => {}
                        () = on_loopback => {}
                        () = to_user => {}
                        () = to_applications => {}
                        _ = stopped => {}
                    }
                });
            })
            .map_err(ApiError::Start)?;
        Ok(Self {
            dashboard,
            plugins,
            open: Some(open),
            stop: Some(stop),
            thread: Some(thread),
            announced,
            _delivery: delivery,
        })
    }

    /// Answers requests from now on.
    pub(crate) fn open(&mut self) {
        if let Some(open) = self.open.take() {
            let _ = open.send(());
        }
    }

    pub(crate) fn dashboard(&self) -> &Dashboard {
        &self.dashboard
    }

    /// Returns the tokens of the run's own programs.
    pub(crate) fn plugins(&self) -> &PluginTokens {
        &self.plugins
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Dropped first, so that tools find no run that does not answer any more.
        self.announced = None;
        self.open = None;
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
