//! Who may use the API: everyone on loopback, elsewhere whoever has a token. A browser's page from elsewhere may not. The
//! operator's token opens all, a domain's what is of its own nodes.

use std::{collections::BTreeMap, sync::Arc};

use axum::{
    extract::{Extension, Request, State},
    http::{
        HeaderMap,
        header::{AUTHORIZATION, HOST, ORIGIN},
    },
    middleware::Next,
    response::Response,
};
use cotorra_graph::DomainId;

use super::{serve::Place, types::Failure};
use crate::domain::{DomainView, Domains};

/// The secret that a caller shows.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// A token; `None` when it is too short to be a secret (fewer than 16 bytes).
    pub fn new(secret: impl Into<String>) -> Option<Self> {
        let secret = secret.into();
        (secret.len() >= 16).then_some(Self(secret))
    }

    /// Compares in a time that does not tell how much of it is right.
    fn is(&self, shown: &str) -> bool {
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

/// The secrets of a testbed's callers: the operator's, who sees and changes all, and one for each domain whose orchestrator
/// sees and changes its own nodes.
#[derive(Debug, Clone, Default)]
pub struct Tokens {
    operator: Option<Token>,
    domains: BTreeMap<DomainId, Token>,
}

/// Tokens that keep domains apart from nobody.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TokensError {
    /// Who shows no token is the operator.
    #[error(
        "domains have tokens, and the operator has none: whoever shows no token would be the operator; give it one, too"
    )]
    NoOperator,
    /// One secret for two.
    #[error("two of the tokens are the same: each domain and the operator need their own")]
    Shared,
}

impl Tokens {
    /// The tokens of the operator and of domains. Without any, everyone on loopback is the operator.
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

    /// Whether callers have to show one.
    pub(super) fn are_needed(&self) -> bool {
        self.operator.is_some()
    }

    /// The domains that have one.
    pub(super) fn domains(&self) -> impl Iterator<Item = &DomainId> {
        self.domains.keys()
    }
}

/// Whom a caller speaks for: the operator, or one domain.
#[derive(Clone)]
pub(super) struct Caller(pub(super) Option<Arc<DomainView>>);

impl Caller {
    /// Refuses what only the operator may see.
    pub(super) fn operator(&self) -> Result<(), Failure> {
        match &self.0 {
            None => Ok(()),
            Some(view) => Err(Failure::not_own(format!(
                "the token of the domain `{}` opens what is of its own nodes; this needs the operator's",
                view.domain()
            ))),
        }
    }

    /// Refuses what is not the caller's to see.
    pub(super) fn sees(
        &self,
        what: &impl std::fmt::Display,
        is_seen: impl FnOnce(&DomainView) -> bool,
    ) -> Result<(), Failure> {
        match self.0.as_deref().filter(|view| !is_seen(view)) {
            None => Ok(()),
            Some(view) => Err(Failure::not_own(format!("`{what}` is not of the domain `{}`", view.domain()))),
        }
    }

    /// The domain that it speaks for.
    fn domain(&self) -> Option<&DomainId> {
        self.0.as_deref().map(DomainView::domain)
    }

    /// Keeps what the caller sees.
    pub(super) fn keeps(&self, is_seen: impl FnOnce(&DomainView) -> bool) -> bool {
        self.0.as_deref().is_none_or(is_seen)
    }
}

/// What is needed to know callers.
#[derive(Clone)]
pub(super) struct Gate {
    tokens: Arc<Tokens>,
    domains: Arc<Domains>,
}

impl Gate {
    pub(super) fn new(tokens: Tokens, domains: Arc<Domains>) -> Self {
        Self { tokens: Arc::new(tokens), domains }
    }

    /// Who sends these headers, if whoever does is let in.
    fn caller(&self, headers: &HeaderMap) -> Result<Caller, Failure> {
        let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
        let Some(operator) = &self.tokens.operator else {
            // Without a token a page that a browser loaded from elsewhere could reach a loopback address, by its own
            // name (Origin) or by one that it lets point there (Host).
            let foreign = text(ORIGIN).is_some() || text(HOST).is_some_and(|host| !is_loopback(host));
            return if foreign { Err(Failure::forbidden()) } else { Ok(Caller(None)) };
        };
        let shown = text(AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
        let shown = shown.ok_or_else(Failure::unauthorized)?;
        // All are compared, so that the time does not tell whose it is.
        let of_domain = self
            .tokens
            .domains
            .iter()
            .fold(None, |found, (domain, token)| if token.is(shown) { Some(domain) } else { found });
        if operator.is(shown) {
            return Ok(Caller(None));
        }
        let view = of_domain.and_then(|domain| self.domains.view(domain));
        view.map(|view| Caller(Some(Arc::clone(view)))).ok_or_else(Failure::unauthorized)
    }
}

pub(super) async fn check(
    State(gate): State<Gate>,
    Extension(place): Extension<Arc<Place>>,
    mut request: Request,
    next: Next,
) -> Result<Response, Failure> {
    let caller = gate.caller(request.headers())?;
    request = place.let_in(caller.domain(), request).await?;
    request.extensions_mut().insert(caller);
    Ok(next.run(request).await)
}

/// The same for the WLAN Access Information Service, which tells problems as its standard does, and has a service for each
/// domain.
pub(super) async fn check_wais(
    State(gate): State<Gate>,
    Extension(place): Extension<Arc<Place>>,
    request: Request,
    next: Next,
) -> Response {
    let of = request.uri().path().strip_prefix("/domains/").and_then(|rest| rest.split('/').next());
    let caller = gate.caller(request.headers()).and_then(|caller| {
        match of {
            Some(domain) => caller.sees(&domain, |view| view.domain().as_str() == domain)?,
            None => caller.operator()?,
        }
        Ok(caller)
    });
    let let_in = match caller {
        Ok(caller) => place.let_in(caller.domain(), request).await,
        Err(refusal) => Err(refusal),
    };
    match let_in {
        Err(refusal) => refusal.into_problem(),
        Ok(request) => next.run(request).await,
    }
}

fn is_loopback(host: &str) -> bool {
    let name = host.strip_prefix('[').and_then(|h| h.split_once(']')).map(|(ip, _)| ip);
    let name = name.unwrap_or_else(|| host.rsplit_once(':').map_or(host, |(name, _)| name));
    name == "localhost" || name.parse().is_ok_and(|ip: std::net::IpAddr| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_whole_token_opens() {
        let token = Token::new("0123456789abcdef").unwrap();
        assert!(token.is("0123456789abcdef"));
        for wrong in ["", "0123456789abcde", "0123456789abcdeg", "0123456789abcdef0"] {
            assert!(!token.is(wrong), "{wrong}");
        }
        assert!(Token::new("short").is_none());
    }

    #[test]
    fn domains_are_kept_apart_only_where_everyone_has_a_token_of_its_own() {
        let token = |digit: &str| Token::new(digit.repeat(16)).unwrap();
        let domain = |name: &str| DomainId::new(name).unwrap();
        let one = BTreeMap::from([(domain("one"), token("1"))]);
        assert_eq!(Tokens::new(None, one.clone()).unwrap_err(), TokensError::NoOperator);
        assert_eq!(Tokens::new(Some(token("1")), one.clone()).unwrap_err(), TokensError::Shared);
        assert!(Tokens::new(Some(token("0")), one).unwrap().are_needed());
        assert!(!Tokens::default().are_needed());
    }

    #[test]
    fn loopback_is_known_by_name_and_by_address() {
        for host in ["localhost", "localhost:7700", "127.0.0.1:7700", "127.0.0.1", "[::1]:7700"] {
            assert!(is_loopback(host), "{host}");
        }
        for host in ["example.org", "example.org:7700", "10.0.0.1", "127.0.0.1.example.org"] {
            assert!(!is_loopback(host), "{host}");
        }
    }
}
