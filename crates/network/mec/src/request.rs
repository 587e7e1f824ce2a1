//! Parts of requests, whose errors are the standard's problems.

use axum::{
    extract::{FromRequestParts, Query},
    http::{
        header::HOST,
        request::Parts,
        uri::{Authority, InvalidUri},
    },
};

use crate::problem::Problem;

/// The parameters of a query, in order.
pub struct Parameters(pub Vec<(String, String)>);

impl<S: Send + Sync> FromRequestParts<S> for Parameters {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        match Query::from_request_parts(parts, state).await {
            Ok(Query(parameters)) => Ok(Self(parameters)),
            Err(rejection) => Err(Problem::bad_request(rejection.body_text())),
        }
    }
}

/// Returns the host and port under which the requester reaches this server.
///
/// # Errors
/// [`Problem`] if the request does not say.
pub fn authority(parts: &Parts) -> Result<Authority, Problem> {
    let host = parts.headers.get(HOST).map(|host| Authority::try_from(host.as_bytes()));
    match host.or_else(|| parts.uri.authority().cloned().map(Ok::<_, InvalidUri>)) {
        Some(Ok(authority)) => Ok(authority),
        _ => Err(Problem::bad_request("the `Host` header is missing or invalid")),
    }
}

/// Returns the scheme and authority of a URI.
pub fn origin(uri: &str) -> &str {
    let authority = uri.find("://").map_or(0, |at| at + "://".len());
    uri[authority..].find('/').map_or(uri, |end| &uri[..authority + end])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_end_before_the_path() {
        for (uri, expected) in [
            ("http://h:1/a/b", "http://h:1"),
            ("http://[::1]:7/", "http://[::1]:7"),
            ("http://h", "http://h"),
        ] {
            assert_eq!(origin(uri), expected);
        }
    }
}
