//! Access control of the API. On loopback everyone is admitted, elsewhere only callers with a token. Without a token, web
//! pages from other origins are rejected. The operator's token opens everything, a domain's token what belongs to its own
//! nodes.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io::{self, Read},
    sync::Arc,
};

use axum::{
    extract::{Extension, Request, State},
    http::{
        HeaderMap, HeaderName,
        header::{AUTHORIZATION, HOST, ORIGIN},
    },
    middleware::Next,
    response::Response,
};
use cotorra_graph::{DomainId, PluginId};

use super::{connections::Whose, serve::Place, types::Failure};
use crate::domain::{DomainView, Domains};

/// A caller's secret.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Creates a token; `None` if the text has fewer than 16 bytes, too few for a secret.
    pub fn new(secret: impl Into<String>) -> Option<Self> {
        let secret = secret.into();
        (secret.len() >= 16).then_some(Self(secret))
    }

    /// Creates a random token.
    pub(super) fn random() -> io::Result<Self> {
        let mut bytes = [0; 32];
        File::open("/dev/urandom")?.read_exact(&mut bytes)?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// Returns the secret.
    pub(crate) fn secret(&self) -> &str {
        &self.0
    }

    /// Compares in constant time, which does not reveal how much of a guess is right.
    pub(super) fn is(&self, shown: &str) -> bool {
        let (secret, shown) = (self.0.as_bytes(), shown.as_bytes());
        let differences = secret.iter().zip(shown).fold(0, |all, (a, b)| all | (a ^ b));
        secret.len() == shown.len() && differences == 0
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(…)")
    }
}

/// The tokens of a testbed's callers. The operator sees and changes everything. Each domain's orchestrator sees and changes
/// its own nodes.
#[derive(Debug, Clone, Default)]
pub struct Tokens {
    operator: Option<Token>,
    domains: BTreeMap<DomainId, Token>,
}

/// Error of tokens that would not separate domains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TokensError {
    /// The operator has no token, so every caller without one would be the operator.
    #[error(
        "domains have tokens, and the operator has none: callers without a token would be the operator; give it one, too"
    )]
    NoOperator,
    /// Two callers have the same secret.
    #[error("two of the tokens are the same: each domain and the operator need their own")]
    Shared,
}

impl Tokens {
    /// Creates the tokens of the operator and of domains. Without any, everyone on loopback is the operator.
    ///
    /// # Errors
    /// [`TokensError`].
    pub fn new(operator: Option<Token>, domains: BTreeMap<DomainId, Token>) -> Result<Self, TokensError> {
        if operator.is_none() && !domains.is_empty() {
            return Err(TokensError::NoOperator);
        }
        let all: Vec<_> = operator.iter().chain(domains.values()).map(|token| &token.0).collect();
        if all.iter().enumerate().any(|(i, token)| all[..i].contains(token)) {
            return Err(TokensError::Shared);
        }
        Ok(Self { operator, domains })
    }

    /// Whether callers need a token.
    pub(super) fn are_needed(&self) -> bool {
        self.operator.is_some()
    }

    /// Returns the domains with a token.
    pub(super) fn domains(&self) -> impl Iterator<Item = &DomainId> {
        self.domains.keys()
    }
}

/// The tokens of the plug-ins that a run starts as programs. Each plug-in finds its own in its environment. The token
/// implies the plug-in's name, which nobody else can use.
#[derive(Debug, Clone, Default)]
pub(crate) struct PluginTokens(BTreeMap<PluginId, Token>);

impl PluginTokens {
    /// Creates a token for each of these plug-ins.
    pub(super) fn new<'a>(plugins: impl IntoIterator<Item = &'a PluginId>) -> io::Result<Self> {
        plugins
            .into_iter()
            .map(|plugin| Ok((plugin.clone(), Token::random()?)))
            .collect::<io::Result<_>>()
            .map(Self)
    }

    /// Returns the token of a plug-in.
    pub(crate) fn of(&self, plugin: &PluginId) -> Option<&Token> {
        self.0.get(plugin)
    }
}

/// Returns the owner of a token. All tokens are compared, so that the time does not reveal the owner.
fn find<'a, K>(tokens: &'a BTreeMap<K, Token>, shown: &str) -> Option<&'a K> {
    tokens.iter().fold(None, |found, (whose, token)| if token.is(shown) { Some(whose) } else { found })
}

/// The caller of a request: the operator, or one domain.
#[derive(Clone, Default)]
pub(super) struct Caller {
    /// The domain's view; `None` for the operator.
    pub(super) view: Option<Arc<DomainView>>,
    /// The plug-in that the token belongs to.
    plugin: Option<PluginId>,
}

impl Caller {
    /// Rejects callers other than the operator.
    pub(super) fn operator(&self) -> Result<(), Failure> {
        match &self.view {
            None => Ok(()),
            Some(view) => Err(Failure::not_own(format!(
                "the token of the domain `{}` opens what is of its own nodes; this needs the operator's",
                view.domain()
            ))),
        }
    }

    /// Rejects callers that do not see an object.
    pub(super) fn sees(
        &self,
        what: &impl std::fmt::Display,
        is_seen: impl FnOnce(&DomainView) -> bool,
    ) -> Result<(), Failure> {
        match self.view.as_deref().filter(|view| !is_seen(view)) {
            None => Ok(()),
            Some(view) => Err(Failure::not_own(format!("`{what}` is not of the domain `{}`", view.domain()))),
        }
    }

    /// Returns the owner of the caller's connections.
    pub(super) fn whose(&self) -> Whose {
        match (&self.plugin, &self.view) {
            (Some(plugin), _) => Whose::Plugin(plugin.clone()),
            (None, Some(view)) => Whose::Domain(view.domain().clone()),
            (None, None) => Whose::Operator,
        }
    }

    /// Returns the name that the caller gives instructions under. It may choose one (`named`) that belongs to nobody else.
    /// `hosted` are the plug-ins of this run. A caller with a domain's token can use the name of one of its plug-ins
    /// elsewhere, or the domain's name.
    pub(super) fn name(
        &self,
        named: Option<PluginId>,
        hosted: &BTreeSet<PluginId>,
    ) -> Result<Option<PluginId>, Failure> {
        if let Some(own) = &self.plugin {
            return match named.filter(|named| named != own) {
                None => Ok(Some(own.clone())),
                Some(named) => Err(Failure::not_own(format!("the secret is of `{own}`, not of `{named}`"))),
            };
        }
        let name = match (&self.view, named) {
            (Some(_), Some(named)) => {
                self.sees(&named, |view| view.has_plugin(&named))?;
                Some(named)
            }
            (Some(view), None) => PluginId::new(view.domain().as_str()).ok(),
            (None, named) => named,
        };
        match name.as_ref().filter(|name| hosted.contains(*name)) {
            Some(taken) => Err(Failure::not_own(format!(
                "`{taken}` is a plug-in of this run, which has a secret of its own: choose another name"
            ))),
            None => Ok(name),
        }
    }

    /// Returns the view of a domain's caller; `None` for a caller who sees everything.
    pub(super) fn view(&self) -> Option<&DomainView> {
        self.view.as_deref()
    }

    /// Whether the caller sees an object, for filters.
    pub(super) fn keeps(&self, is_seen: impl FnOnce(&DomainView) -> bool) -> bool {
        self.view.as_deref().is_none_or(is_seen)
    }
}

/// The state that identifies callers.
#[derive(Clone)]
pub(super) struct Gate {
    tokens: Arc<Tokens>,
    plugins: PluginTokens,
    domains: Arc<Domains>,
}

impl Gate {
    pub(super) fn new(tokens: Tokens, plugins: PluginTokens, domains: Arc<Domains>) -> Self {
        Self { tokens: Arc::new(tokens), plugins, domains }
    }

    /// Identifies the caller by a request's headers, or rejects it.
    fn caller(&self, headers: &HeaderMap) -> Result<Caller, Failure> {
        let shown = shown(headers);
        if let Some(plugin) = shown.and_then(|shown| find(&self.plugins.0, shown)) {
            return Ok(Caller {
                view: self.domains.of_plugin(plugin).cloned(),
                plugin: Some(plugin.clone()),
            });
        }
        let Some(operator) = &self.tokens.operator else {
            return if foreign(headers) { Err(Failure::forbidden()) } else { Ok(Caller::default()) };
        };
        let shown = shown.ok_or_else(Failure::unauthorized)?;
        let of_domain = find(&self.tokens.domains, shown);
        if operator.is(shown) {
            return Ok(Caller::default());
        }
        let view = of_domain.and_then(|domain| self.domains.view(domain));
        view.map(|view| Caller { view: Some(Arc::clone(view)), plugin: None })
            .ok_or_else(Failure::unauthorized)
    }
}

/// Where a browser's request comes from, which no page can choose (Fetch Metadata).
const SEC_FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// Returns a header's text.
fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// Returns the token that a request shows.
pub(super) fn shown(headers: &HeaderMap) -> Option<&str> {
    text(headers, &AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "))
}

/// Whether a page from elsewhere in a user's browser makes a request.
pub(super) fn foreign(headers: &HeaderMap) -> bool {
    is_of_another_site(text(headers, &HOST), text(headers, &ORIGIN), text(headers, &SEC_FETCH_SITE))
}

/// Whether a page from elsewhere in a user's browser makes a request. It can reach a loopback address under a name that it
/// points there (`host`), or under its own (`origin`). For pictures and scripts, browsers leave the origin out and send the
/// `site`.
fn is_of_another_site(host: Option<&str>, origin: Option<&str>, site: Option<&str>) -> bool {
    let is_own = |origin: &str| origin.strip_prefix("http://").is_some_and(|at| Some(at) == host);
    host.is_some_and(|host| !is_loopback(host))
        || origin.is_some_and(|origin| !is_own(origin))
        || site.is_some_and(|site| !matches!(site, "same-origin" | "none"))
}

/// Admits a request of a caller that passes a check, and reads its body.
async fn admit(
    gate: &Gate,
    place: &Place,
    mut request: Request,
    check: impl FnOnce(&Caller) -> Result<(), Failure>,
) -> Result<Request, Failure> {
    let caller = gate.caller(request.headers())?;
    check(&caller)?;
    request = place.let_in(caller.whose(), request).await?;
    request.extensions_mut().insert(caller);
    Ok(request)
}

pub(super) async fn check(
    State(gate): State<Gate>,
    Extension(place): Extension<Arc<Place>>,
    request: Request,
    next: Next,
) -> Result<Response, Failure> {
    Ok(next.run(admit(&gate, &place, request, |_| Ok(())).await?).await)
}

/// Checks callers of services of ETSI MEC, which report problems as their standards do. Below `/wai` a service is the
/// operator's, and below `/domains/{name}` that domain's.
pub(super) async fn check_mec(
    State(gate): State<Gate>,
    Extension(place): Extension<Arc<Place>>,
    request: Request,
    next: Next,
) -> Response {
    let path = request.uri().path().to_owned();
    let admitted = admit(&gate, &place, request, |caller| {
        match path.strip_prefix("/domains/").and_then(|rest| rest.split('/').next()) {
            Some(domain) => caller.sees(&domain, |view| view.domain().as_str() == domain),
            None if path.starts_with("/wai/") => caller.operator(),
            None => Ok(()),
        }
    });
    match admitted.await {
        Err(refusal) => refusal.into_problem(),
        Ok(request) => next.run(request).await,
    }
}

/// Whether a `Host` names this machine: a loopback name or address, with nothing but a port after it.
fn is_loopback(host: &str) -> bool {
    let (name, port) = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some(parts) => parts,
        None => host.split_at(host.find(':').unwrap_or(host.len())),
    };
    let is_port = |port: &str| port.strip_prefix(':').is_some_and(|digits| digits.parse::<u16>().is_ok());
    (port.is_empty() || is_port(port))
        && (name == "localhost" || name.parse().is_ok_and(|ip: std::net::IpAddr| ip.is_loopback()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_whole_token_is_accepted() {
        let token = Token::new("0123456789abcdef").unwrap();
        assert!(token.is("0123456789abcdef"));
        for wrong in ["", "0123456789abcde", "0123456789abcdeg", "0123456789abcdef0"] {
            assert!(!token.is(wrong), "{wrong}");
        }
        assert!(Token::new("short").is_none());
    }

    #[test]
    fn domains_are_separated_only_if_every_caller_has_its_own_token() {
        let token = |digit: &str| Token::new(digit.repeat(16)).unwrap();
        let domain = |name: &str| DomainId::new(name).unwrap();
        let one = BTreeMap::from([(domain("one"), token("1"))]);
        assert_eq!(Tokens::new(None, one.clone()).unwrap_err(), TokensError::NoOperator);
        assert_eq!(Tokens::new(Some(token("1")), one.clone()).unwrap_err(), TokensError::Shared);
        assert!(Tokens::new(Some(token("0")), one).unwrap().are_needed());
        assert!(!Tokens::default().are_needed());
    }

    #[test]
    fn only_the_own_page_may_use_an_api_without_tokens() {
        let own = [
            (Some("localhost:7700"), None, None),
            (Some("localhost:7700"), Some("http://localhost:7700"), Some("same-origin")),
            (Some("[::1]:7700"), Some("http://[::1]:7700"), None),
            (Some("127.0.0.1:7700"), None, Some("none")),
            // Tools that use the Unix socket.
            (None, None, None),
        ];
        for (host, origin, site) in own {
            assert!(!is_of_another_site(host, origin, site), "{host:?} {origin:?} {site:?}");
        }
        let others = [
            (Some("localhost:7700"), Some("http://localhost:7701"), None),
            (Some("localhost:7700"), Some("http://127.0.0.1:7700"), None),
            (Some("localhost:7700"), Some("https://localhost:7700"), None),
            (Some("localhost:7700"), Some("http://example.org"), Some("cross-site")),
            (Some("localhost:7700"), Some("null"), None),
            (None, Some("http://localhost:7700"), None),
            (Some("example.org:7700"), Some("http://example.org:7700"), Some("same-origin")),
            (Some("localhost:7700"), None, Some("cross-site")),
            (Some("localhost:7700"), None, Some("same-site")),
        ];
        for (host, origin, site) in others {
            assert!(is_of_another_site(host, origin, site), "{host:?} {origin:?} {site:?}");
        }
    }

    #[test]
    fn loopback_is_recognized_by_name_and_by_address() {
        for host in ["localhost", "localhost:7700", "127.0.0.1:7700", "127.0.0.1", "[::1]:7700"] {
            assert!(is_loopback(host), "{host}");
        }
        for host in [
            "example.org",
            "example.org:7700",
            "10.0.0.1",
            "127.0.0.1.example.org",
            "[::1].example.org",
            "[::1].example.org:7700",
            "[::1]:7700.example.org",
            "localhost:7700.example.org",
            "localhost:",
            "[::1",
            "",
        ] {
            assert!(!is_loopback(host), "{host}");
        }
    }
}
