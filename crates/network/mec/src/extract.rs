//! Extractors of request data, whose errors are the standard's problems: URIs, bodies, conditions.

use axum::{
    extract::{FromRequest, FromRequestParts, Path, Request},
    http::{HeaderMap, HeaderName, StatusCode, header, request::Parts},
    middleware::Next,
    response::{IntoResponse, Response},
};
use bytes::Bytes;

use crate::{
    problem::Problem,
    request::authority,
    service::{Machine, Service},
};

/// Longest body, bytes.
const LONGEST_BODY: usize = 64 * 1024;
/// Longest path and query, bytes.
const LONGEST_URI: usize = 8000;

/// Rejects requests with an overlong URI, and those that do not accept JSON.
pub(crate) async fn check(request: Request, next: Next) -> Response {
    let uri = request.uri();
    if uri.path_and_query().is_some_and(|asked| asked.as_str().len() > LONGEST_URI) {
        let detail = format!("path and query have at most {LONGEST_URI} bytes");
        return Problem::new(StatusCode::URI_TOO_LONG, detail).into_response();
    }
    if !takes_json(request.headers()) {
        let detail = "this service answers in application/json, and problems in application/problem+json";
        return Problem::new(StatusCode::NOT_ACCEPTABLE, detail).into_response();
    }
    next.run(request).await
}

/// Whether `Accept` includes JSON (RFC 9110, 12.5.1).
fn takes_json(headers: &HeaderMap) -> bool {
    let mut accepted = headers.get_all(header::ACCEPT).iter().peekable();
    if accepted.peek().is_none() {
        return true;
    }
    accepted.filter_map(|value| value.to_str().ok()).flat_map(|value| value.split(',')).any(|range| {
        let mut parts = range.split(';').map(str::trim);
        let media = parts.next().unwrap_or_default().to_ascii_lowercase();
        let weight = parts.find_map(|part| part.strip_prefix("q=")?.parse::<f32>().ok());
        matches!(&*media, "" | "*/*" | "application/*" | "application/json") && weight != Some(0.0)
    })
}

/// The URI under which the requester reaches the service.
pub struct Base(pub String);

impl<M: Machine> FromRequestParts<Service<M>> for Base {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, service: &Service<M>) -> Result<Self, Problem> {
        Ok(Self(format!("http://{}{}", authority(parts)?, service.prefix())))
    }
}

/// The last parameter of a path.
pub struct Id(pub String);

impl<S: Send + Sync> FromRequestParts<S> for Id {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        match Path::<Vec<(String, String)>>::from_request_parts(parts, state).await {
            Ok(Path(parameters)) => Ok(Self(parameters.into_iter().next_back().unwrap_or_default().1)),
            Err(rejection) => Err(Problem::bad_request(rejection.body_text())),
        }
    }
}

/// A body declared as JSON.
pub struct Json(pub Bytes);

impl<S: Send + Sync> FromRequest<S> for Json {
    type Rejection = Problem;

    async fn from_request(request: Request, _: &S) -> Result<Self, Problem> {
        let media = text(request.headers(), header::CONTENT_TYPE).unwrap_or_default();
        let media = media.split(';').next().unwrap_or_default().trim();
        if !media.eq_ignore_ascii_case("application/json") {
            let detail = "a body is JSON, and says so: Content-Type: application/json";
            return Err(Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, detail));
        }
        match axum::body::to_bytes(request.into_body(), LONGEST_BODY).await {
            Ok(body) => Ok(Self(body)),
            Err(_) => {
                let detail = format!("a body has at most {LONGEST_BODY} bytes");
                Err(Problem::new(StatusCode::PAYLOAD_TOO_LARGE, detail))
            }
        }
    }
}

/// Returns a header's value, if it is ASCII text.
pub(crate) fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

/// Returns `If-Match`. An unreadable value becomes one that matches nothing.
pub fn if_match(headers: &HeaderMap) -> Option<&str> {
    headers.get(header::IF_MATCH).map(|value| value.to_str().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_is_accepted_unless_excluded() {
        for (accept, expected) in [
            ("application/json", true),
            ("text/html, */*;q=0.1", true),
            ("application/*", true),
            ("text/html", false),
            ("application/json;q=0", false),
            ("application/xml, text/plain", false),
        ] {
            let headers = HeaderMap::from_iter([(header::ACCEPT, accept.parse().unwrap())]);
            assert_eq!(takes_json(&headers), expected, "{accept}");
        }
        assert!(takes_json(&HeaderMap::new()));
    }
}
