//! Errors as ETSI GS MEC 009 wants them: problem details (RFC 9457), whatever went wrong.

use axum::{
    http::{HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;

use crate::{callback::CallbackError, requests::InvalidRequest, view::QueryError, wais::RequestError};

/// What went wrong (RFC 9457).
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ProblemDetails {
    /// `about:blank`: the status says what kind of problem it is.
    #[serde(rename = "type")]
    #[cfg_attr(feature = "openapi", schema(format = "uri"))]
    kind: &'static str,
    /// The status in words.
    title: &'static str,
    /// The status.
    status: u16,
    /// What is wrong here, and what would be right.
    detail: String,
}

/// A problem and what its answer's head says of it.
#[derive(Debug)]
pub(crate) struct Problem {
    status: StatusCode,
    detail: String,
    header: Option<(HeaderName, HeaderValue)>,
}

impl Problem {
    pub(crate) fn new(status: StatusCode, detail: impl Into<String>) -> Self {
        Self { status, detail: detail.into(), header: None }
    }

    pub(crate) fn bad_request(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, detail)
    }
}

/// An answer that says what went wrong, for those who answer in the service's place: who is not let in, for instance.
pub fn problem(status: StatusCode, detail: impl Into<String>) -> Response {
    let mut problem = Problem::new(status, detail);
    if status == StatusCode::UNAUTHORIZED {
        problem.header = Some((header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer")));
    }
    problem.into_response()
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

impl From<RequestError> for Problem {
    fn from(refused: RequestError) -> Self {
        let status = match &refused {
            RequestError::Invalid(InvalidRequest::Malformed(_))
            | RequestError::Callback(CallbackError::Invalid(_) | CallbackError::Unknown(_)) => {
                StatusCode::BAD_REQUEST
            }
            RequestError::Invalid(InvalidRequest::Unsupported(_)) => StatusCode::UNPROCESSABLE_ENTITY,
            RequestError::Callback(CallbackError::Forbidden(_)) | RequestError::Full => StatusCode::FORBIDDEN,
            RequestError::NotFound { .. } => StatusCode::NOT_FOUND,
            RequestError::Changed(_) => StatusCode::PRECONDITION_FAILED,
            RequestError::TooOften(_) => StatusCode::TOO_MANY_REQUESTS,
        };
        let header = match &refused {
            RequestError::TooOften(wait) => {
                let seconds = HeaderValue::from(wait.as_secs() + 1);
                Some((header::RETRY_AFTER, seconds))
            }
            _ => None,
        };
        Self { status, detail: refused.to_string(), header }
    }
}

impl From<QueryError> for Problem {
    fn from(error: QueryError) -> Self {
        Self::bad_request(error.to_string())
    }
}

impl From<InvalidRequest> for Problem {
    fn from(error: InvalidRequest) -> Self {
        RequestError::from(error).into()
    }
}

/// What can go wrong with any request.
#[cfg(feature = "openapi")]
#[derive(utoipa::IntoResponses)]
#[expect(dead_code, reason = "it is there for the OpenAPI document")]
pub(crate) enum Asked {
    /// The request is wrong; the details say how.
    #[response(status = 400, content_type = "application/problem+json")]
    BadRequest(ProblemDetails),
    /// The API needs its token.
    #[response(status = 401, content_type = "application/problem+json")]
    Unauthorized(ProblemDetails),
    /// Not from there, not to there, or there is no room.
    #[response(status = 403, content_type = "application/problem+json")]
    Forbidden(ProblemDetails),
    /// There is no such resource.
    #[response(status = 404, content_type = "application/problem+json")]
    NotFound(ProblemDetails),
    /// Only JSON is given.
    #[response(status = 406, content_type = "application/problem+json")]
    NotAcceptable(ProblemDetails),
    /// Longer than 8000 bytes.
    #[response(status = 414, content_type = "application/problem+json")]
    UriTooLong(ProblemDetails),
}

/// What can go wrong with a change beside that.
#[cfg(feature = "openapi")]
#[derive(utoipa::IntoResponses)]
#[expect(dead_code, reason = "it is there for the OpenAPI document")]
pub(crate) enum Changing {
    /// It was changed since `If-Match` was known.
    #[response(status = 412, content_type = "application/problem+json")]
    PreconditionFailed(ProblemDetails),
    /// More than 64 KiB.
    #[response(status = 413, content_type = "application/problem+json")]
    ContentTooLarge(ProblemDetails),
    /// Only JSON is taken.
    #[response(status = 415, content_type = "application/problem+json")]
    UnsupportedMediaType(ProblemDetails),
    /// The testbed does not have what is asked for.
    #[response(status = 422, content_type = "application/problem+json")]
    UnprocessableContent(ProblemDetails),
    /// Too many changes; `Retry-After` says when.
    #[response(status = 429, content_type = "application/problem+json")]
    TooManyRequests(ProblemDetails),
}
