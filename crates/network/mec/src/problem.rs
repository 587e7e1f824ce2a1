//! Errors in the form that ETSI GS MEC 009 requires: problem details (RFC 9457).

use axum::{
    http::{HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;

use crate::{
    callback::CallbackError,
    limiter::TooOften,
    query::QueryError,
    subscribing::{InvalidRequest, RequestError},
};

/// A problem (RFC 9457).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct ProblemDetails {
    /// `about:blank`: the status describes the kind of problem.
    #[serde(rename = "type")]
    #[schema(format = "uri")]
    kind: &'static str,
    /// Name of the status.
    title: &'static str,
    /// HTTP status.
    status: u16,
    /// Explanation of the error, and its remedy.
    detail: String,
}

/// A response with a problem, and a header if the status needs one.
#[derive(Debug)]
pub struct Problem {
    status: StatusCode,
    detail: String,
    header: Option<(HeaderName, HeaderValue)>,
}

impl Problem {
    /// Creates a problem.
    pub fn new(status: StatusCode, detail: impl Into<String>) -> Self {
        let header = match status {
            StatusCode::UNAUTHORIZED => Some((header::WWW_AUTHENTICATE, "Bearer")),
            // Limits on rates and connections may admit a request again at once. Seconds are the smallest unit.
            StatusCode::TOO_MANY_REQUESTS => Some((header::RETRY_AFTER, "1")),
            _ => None,
        };
        let header = header.map(|(name, value)| (name, HeaderValue::from_static(value)));
        Self { status, detail: detail.into(), header }
    }

    /// Creates the problem of a request that the state of the service does not allow.
    pub fn forbidden(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::FORBIDDEN, detail)
    }

    /// Creates the problem of an invalid request.
    pub fn bad_request(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, detail)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let body = ProblemDetails {
            kind: "about:blank",
            title: self.status.canonical_reason().unwrap_or("Error"),
            status: self.status.as_u16(),
            detail: self.detail,
        };
        let text = serde_json::to_string(&body).expect("problem details hold only what JSON can");
        let content_type = [(header::CONTENT_TYPE, "application/problem+json")];
        let mut response = (self.status, content_type, text).into_response();
        if let Some((name, value)) = self.header {
            response.headers_mut().insert(name, value);
        }
        response
    }
}

impl From<CallbackError> for Problem {
    fn from(error: CallbackError) -> Self {
        let status = match error {
            CallbackError::Invalid(_) | CallbackError::Unknown(_) => StatusCode::BAD_REQUEST,
            CallbackError::Forbidden(_) => StatusCode::FORBIDDEN,
        };
        Self::new(status, error.to_string())
    }
}

impl From<QueryError> for Problem {
    fn from(error: QueryError) -> Self {
        Self::bad_request(error.to_string())
    }
}

impl From<TooOften> for Problem {
    fn from(error: TooOften) -> Self {
        let wait = HeaderValue::from(error.0.as_secs() + 1);
        let problem = Self::new(StatusCode::TOO_MANY_REQUESTS, error.to_string());
        Self { header: Some((header::RETRY_AFTER, wait)), ..problem }
    }
}

impl From<RequestError> for Problem {
    fn from(error: RequestError) -> Self {
        let status = match error {
            RequestError::Callback(error) => return error.into(),
            RequestError::TooOften(error) => return error.into(),
            RequestError::Invalid(InvalidRequest::Malformed(_)) => StatusCode::BAD_REQUEST,
            RequestError::Invalid(InvalidRequest::Unsupported(_)) => StatusCode::UNPROCESSABLE_ENTITY,
            RequestError::Full | RequestError::State(_) => StatusCode::FORBIDDEN,
            RequestError::NotFound { .. } => StatusCode::NOT_FOUND,
            RequestError::Changed(_) => StatusCode::PRECONDITION_FAILED,
        };
        Self::new(status, error.to_string())
    }
}

impl From<InvalidRequest> for Problem {
    fn from(error: InvalidRequest) -> Self {
        RequestError::from(error).into()
    }
}

/// Problems of any request.
#[derive(utoipa::IntoResponses)]
pub enum RequestProblems {
    /// The request is invalid; the details explain how.
    #[response(status = 400, content_type = "application/problem+json")]
    BadRequest(ProblemDetails),
    /// The API requires its token.
    #[response(status = 401, content_type = "application/problem+json")]
    Unauthorized(ProblemDetails),
    /// The source or target is not allowed, or a limit is reached.
    #[response(status = 403, content_type = "application/problem+json")]
    Forbidden(ProblemDetails),
    /// There is no such resource.
    #[response(status = 404, content_type = "application/problem+json")]
    NotFound(ProblemDetails),
    /// The service answers only in JSON.
    #[response(status = 406, content_type = "application/problem+json")]
    NotAcceptable(ProblemDetails),
    /// Longer than 8000 bytes.
    #[response(status = 414, content_type = "application/problem+json")]
    UriTooLong(ProblemDetails),
}

/// Further problems of a change.
#[derive(utoipa::IntoResponses)]
pub enum ChangeProblems {
    /// The resource was changed since the version in `If-Match`.
    #[response(status = 412, content_type = "application/problem+json")]
    PreconditionFailed(ProblemDetails),
    /// Longer than 64 KiB.
    #[response(status = 413, content_type = "application/problem+json")]
    ContentTooLarge(ProblemDetails),
    /// Only JSON is accepted.
    #[response(status = 415, content_type = "application/problem+json")]
    UnsupportedMediaType(ProblemDetails),
    /// The testbed lacks the requested data.
    #[response(status = 422, content_type = "application/problem+json")]
    UnprocessableContent(ProblemDetails),
    /// Too many changes; `Retry-After` has the waiting time.
    #[response(status = 429, content_type = "application/problem+json")]
    TooManyRequests(ProblemDetails),
}
