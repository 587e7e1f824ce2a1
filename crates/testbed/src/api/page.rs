//! The files of the dashboard and of the editor, beside the API that they use.

use axum::{
    Router,
    http::{
        HeaderMap, HeaderName, StatusCode,
        header::{
            CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, IF_NONE_MATCH, REFERRER_POLICY,
            X_CONTENT_TYPE_OPTIONS,
        },
    },
    response::{IntoResponse, Response},
    routing::get,
};
use cotorra_dashboard::File;

/// Resources of the page that no other origin may load (Fetch standard).
const CROSS_ORIGIN_RESOURCE_POLICY: HeaderName = HeaderName::from_static("cross-origin-resource-policy");
/// Windows that opened the page have no reference to it (HTML standard).
const CROSS_ORIGIN_OPENER_POLICY: HeaderName = HeaderName::from_static("cross-origin-opener-policy");

/// Returns the paths of a page's files.
pub(super) fn routes<S: Clone + Send + Sync + 'static>(files: Vec<File>) -> Router<S> {
    let add = |router: Router<S>, file: File| {
        router.route(file.path, get(move |headers: HeaderMap| async move { answer(file, &headers) }))
    };
    files.into_iter().fold(Router::new(), add)
}

fn answer(file: File, request: &HeaderMap) -> Response {
    let etag = file.etag();
    let headers = [
        (CONTENT_TYPE, file.content_type()),
        (CONTENT_SECURITY_POLICY, cotorra_dashboard::CONTENT_SECURITY_POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (CROSS_ORIGIN_RESOURCE_POLICY, "same-origin"),
        (CROSS_ORIGIN_OPENER_POLICY, "same-origin"),
        // The browser asks each time, and gets the file only if this is another version of cotorra.
        (CACHE_CONTROL, "no-cache"),
    ];
    let is_known = request.get(IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == etag.as_bytes());
    if is_known {
        return (StatusCode::NOT_MODIFIED, headers, [(ETAG, etag)]).into_response();
    }
    (headers, [(ETAG, etag)], file.bytes).into_response()
}
