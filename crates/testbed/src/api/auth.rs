//! Access control of the API. The operator is the run's user by default: whoever uses the run's own socket, and pages that
//! were signed in from there. It can be whoever shows a token instead, or everyone who reaches the API. A domain's token
//! opens what belongs to its own nodes. An application's token opens its domain's services of ETSI MEC, at a port of an
//! emulated node only.

use std::{
    collections::{BTreeMap, BTreeSet},
    io,
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
use cotorra_graph::{DomainId, PluginId, VnfId};

use super::{
    application_tokens::Applications, connections::Whose, serve::Place, signed_in::SignIns, tls::Origin,
    token::Token, types::Failure,
};
use crate::domain::{DomainView, Domains};

/// The operator, who sees and changes everything.
#[derive(Debug, Clone, Default)]
pub enum Operator {
    /// The run's user, by the run's socket, which no other user can open, and pages that this user signed in.
    #[default]
    User,
    /// Whoever shows this token, and pages that were signed in with it.
    Token(Token),
    /// Every program that reaches the API, which then serves loopback only.
    Everyone,
}

/// The callers of a testbed's API: the operator, and each domain's orchestrator, which sees and changes its own nodes.
#[derive(Debug, Clone, Default)]
pub struct Tokens {
    operator: Operator,
    domains: BTreeMap<DomainId, Token>,
}

/// Error of tokens that would not separate domains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TokensError {
    /// Every caller without a token would be the operator.
    #[error("domains have tokens, and callers without one would be the operator")]
    Everyone,
    /// Two callers have the same secret.
    #[error("two of the tokens are the same: each domain and the operator need their own")]
    Shared,
}

impl Tokens {
    /// Returns the operator, and the tokens of domains.
    ///
    /// # Errors
    /// [`TokensError`].
    pub fn new(operator: Operator, domains: BTreeMap<DomainId, Token>) -> Result<Self, TokensError> {
        if matches!(operator, Operator::Everyone) && !domains.is_empty() {
            return Err(TokensError::Everyone);
        }
        let own = if let Operator::Token(token) = &operator { Some(token) } else { None };
        let all: Vec<_> = own.into_iter().chain(domains.values()).map(Token::secret).collect();
        if all.iter().enumerate().any(|(i, token)| all[..i].contains(token)) {
            return Err(TokensError::Shared);
        }
        Ok(Self { operator, domains })
    }

    /// Whether callers on other machines can show that they are the operator.
    pub(super) fn work_from_afar(&self) -> bool {
        matches!(self.operator, Operator::Token(_))
    }

    /// Returns the domains with a token.
    pub(super) fn domains(&self) -> impl Iterator<Item = &DomainId> {
        self.domains.keys()
    }
}

/// The tokens of the plug-ins that a run starts as programs. Each plug-in finds its own in its environment. The token
/// implies the plug-in's name, which no other caller can use.
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
    /// The application that the token belongs to.
    application: Option<VnfId>,
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

    /// Rejects an application that acts for another. `rest` is the path below a domain.
    fn acts_for_itself(&self, rest: &str) -> Result<(), Failure> {
        let mut segments = rest.split('/').skip_while(|segment| *segment != "applications");
        let named = segments.nth(1);
        match (&self.application, named) {
            (Some(own), Some(named)) if *own != *named => {
                Err(Failure::not_own(format!("the token is of the application `{own}`, not of `{named}`")))
            }
            _ => Ok(()),
        }
    }

    /// Returns the application that the token belongs to.
    pub(super) fn application(&self) -> Option<&VnfId> {
        self.application.as_ref()
    }

    /// Returns the owner of the caller's connections.
    pub(super) fn whose(&self) -> Whose {
        match (&self.plugin, &self.view) {
            (Some(plugin), _) => Whose::Plugin(plugin.clone()),
            (None, Some(view)) => Whose::Domain(view.domain().clone()),
            (None, None) => Whose::Operator,
        }
    }

    /// Returns the name that the caller gives instructions under. It may choose one (`named`) that belongs to no other.
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
    pages: Arc<SignIns>,
    applications: Applications,
}

impl Gate {
    pub(super) fn new(
        tokens: Tokens,
        plugins: PluginTokens,
        domains: Arc<Domains>,
        pages: Arc<SignIns>,
        applications: Applications,
    ) -> Self {
        Self { tokens: Arc::new(tokens), plugins, domains, pages, applications }
    }

    /// Identifies an application by its token, or rejects it.
    fn application(&self, shown: Option<&str>) -> Result<Caller, Failure> {
        let (application, domain) =
            shown.and_then(|shown| self.applications.find(shown)).ok_or_else(Failure::unauthorized)?;
        let view = self.domains.view(&domain).cloned().ok_or_else(Failure::unauthorized)?;
        Ok(Caller { view: Some(view), plugin: None, application: Some(application) })
    }

    /// Identifies the caller by a request's headers and by the origin of its connection, or rejects it.
    fn caller(&self, headers: &HeaderMap, origin: Origin) -> Result<Caller, Failure> {
        let shown = shown(headers);
        if origin == Origin::Node {
            return self.application(shown);
        }
        if let Some(plugin) = shown.and_then(|shown| find(&self.plugins.0, shown)) {
            return Ok(Caller {
                view: self.domains.of_plugin(plugin).cloned(),
                plugin: Some(plugin.clone()),
                application: None,
            });
        }
        let is_operator = match (&self.tokens.operator, shown) {
            (Operator::Everyone, _) if foreign(headers) => return Err(Failure::forbidden()),
            (Operator::Everyone, _) => true,
            (Operator::User, None) => origin == Origin::User,
            (Operator::Token(token), Some(shown)) if token.is(shown) => true,
            (_, shown) => shown.is_some_and(|shown| self.pages.admit(shown)),
        };
        if is_operator {
            return Ok(Caller::default());
        }
        let of_domain = shown.and_then(|shown| find(&self.tokens.domains, shown));
        let view = of_domain.and_then(|domain| self.domains.view(domain));
        view.map(|view| Caller { view: Some(Arc::clone(view)), plugin: None, application: None })
            .ok_or_else(Failure::unauthorized)
    }
}

/// Origin of a browser's request, which no page can choose (Fetch Metadata).
const SEC_FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// Returns a header's text.
fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// Returns the token that a request shows. An empty one is none, as that of an empty variable.
pub(super) fn shown(headers: &HeaderMap) -> Option<&str> {
    let shown = text(headers, &AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
    shown.filter(|shown| !shown.is_empty())
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
    let caller = gate.caller(request.headers(), place.origin())?;
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

/// Checks callers of services of ETSI MEC, which report problems as their standards do. Below `/wai`, `/location` and
/// `/bwm` a service is the operator's, and below `/domains/{name}` that domain's. An application acts for itself only.
pub(super) async fn check_mec(
    State(gate): State<Gate>,
    Extension(place): Extension<Arc<Place>>,
    request: Request,
    next: Next,
) -> Response {
    let path = request.uri().path().to_owned();
    let admitted = admit(&gate, &place, request, |caller| {
        match path.strip_prefix("/domains/").map(|rest| rest.split_once('/').unwrap_or((rest, ""))) {
            Some((domain, rest)) => {
                caller.sees(&domain, |view| view.domain().as_str() == domain)?;
                caller.acts_for_itself(rest)
            }
            None if ["/wai/", "/location/", "/bwm/"].iter().any(|service| path.starts_with(service)) => {
                caller.operator()
            }
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
        assert_eq!(Tokens::new(Operator::Everyone, one.clone()).unwrap_err(), TokensError::Everyone);
        let same = Tokens::new(Operator::Token(token("1")), one.clone());
        assert_eq!(same.unwrap_err(), TokensError::Shared);
        for operator in [Operator::User, Operator::Token(token("0"))] {
            Tokens::new(operator, one.clone()).unwrap();
        }
        let two = BTreeMap::from([(domain("one"), token("1")), (domain("two"), token("1"))]);
        assert_eq!(Tokens::new(Operator::User, two).unwrap_err(), TokensError::Shared);
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
