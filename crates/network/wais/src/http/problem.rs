//! Errors of the service as problems.

use axum::http::StatusCode;
use cotorra_mec::{Problem, ProblemDetails};

use crate::{requests::InvalidRequest, wais::RequestError};

impl From<RequestError> for Problem {
    fn from(error: RequestError) -> Self {
        let status = match error {
            RequestError::Callback(error) => return error.into(),
            RequestError::TooOften(error) => return error.into(),
            RequestError::Invalid(InvalidRequest::Malformed(_)) => StatusCode::BAD_REQUEST,
            RequestError::Invalid(InvalidRequest::Unsupported(_)) => StatusCode::UNPROCESSABLE_ENTITY,
            RequestError::Full => StatusCode::FORBIDDEN,
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
#[allow(dead_code, reason = "used by the OpenAPI document")]
pub(crate) enum RequestProblems {
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
#[allow(dead_code, reason = "used by the OpenAPI document")]
pub(crate) enum ChangeProblems {
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
