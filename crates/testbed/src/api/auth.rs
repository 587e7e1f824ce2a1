//! Who may use the API: everyone on loopback, elsewhere whoever has the token. A browser's page from elsewhere may not.

use axum::{
    extract::{Request, State},
    http::{
        HeaderMap,
        header::{AUTHORIZATION, HOST, ORIGIN},
    },
    middleware::Next,
    response::{IntoResponse, Response},
};

use super::types::Failure;

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

pub(super) async fn check(State(token): State<Option<Token>>, request: Request, next: Next) -> Response {
    match refusal(token.as_ref(), request.headers()) {
        Some(refusal) => refusal.into_response(),
        None => next.run(request).await,
    }
}

/// The same for the WLAN Access Information Service, which tells problems as its standard does.
pub(super) async fn check_wais(State(token): State<Option<Token>>, request: Request, next: Next) -> Response {
    match refusal(token.as_ref(), request.headers()) {
        Some(refusal) => refusal.into_problem(),
        None => next.run(request).await,
    }
}

/// Why whoever sends these headers is not let in.
fn refusal(token: Option<&Token>, headers: &HeaderMap) -> Option<Failure> {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    match token {
        Some(token) => {
            let shown = text(AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
            (!shown.is_some_and(|shown| token.is(shown))).then(Failure::unauthorized)
        }
        // Without a token a page that a browser loaded from elsewhere could reach a loopback address, by its own name
        // (Origin) or by one that it lets point there (Host).
        None => {
            let foreign = text(ORIGIN).is_some() || text(HOST).is_some_and(|host| !is_loopback(host));
            foreign.then(Failure::forbidden)
        }
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
    fn loopback_is_known_by_name_and_by_address() {
        for host in ["localhost", "localhost:7700", "127.0.0.1:7700", "127.0.0.1", "[::1]:7700"] {
            assert!(is_loopback(host), "{host}");
        }
        for host in ["example.org", "example.org:7700", "10.0.0.1", "127.0.0.1.example.org"] {
            assert!(!is_loopback(host), "{host}");
        }
    }
}
