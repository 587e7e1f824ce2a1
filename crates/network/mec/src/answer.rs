//! Answers of resources, with entity tags.

use axum::{
    Router,
    body::Body,
    http::{HeaderMap, StatusCode, header},
    middleware,
    response::{IntoResponse, Response},
    routing::{MethodRouter, get},
};
use serde::Serialize;

use crate::{
    conditional::is_known,
    extract::{check, text},
    problem::Problem,
    service::{Machine, Service},
    subscribing::Resource,
    websocket,
};

/// Returns a router of resources. Every answer follows the standard, also for unknown paths and methods. The lists of
/// subscriptions are at these paths, below which each subscription has its WebSocket.
pub fn router<M: Machine>(
    service: &Service<M>,
    resources: impl IntoIterator<Item = (&'static str, MethodRouter<Service<M>>)>,
    lists: &[&str],
) -> Router {
    let no_path = || async { Problem::new(StatusCode::NOT_FOUND, "there is no such path here") };
    let no_method =
        || async { Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method not allowed: see `Allow`") };
    let router =
        resources.into_iter().fold(Router::new(), |router, (path, methods)| router.route(path, methods));
    lists
        .iter()
        .fold(router, |router, list| {
            router.route(&format!("{list}/{{subscriptionId}}/websocket"), get(websocket::open::<M>))
        })
        .fallback(no_path)
        .method_not_allowed_fallback(no_method)
        .layer(middleware::from_fn(check))
        .with_state(service.clone())
}

/// Answers with JSON and its entity tag, or with 304 if the requester has it already.
pub fn tagged(headers: &HeaderMap, etag: String, body: impl Into<Body>) -> Response {
    if is_known(text(headers, header::IF_NONE_MATCH), &etag) {
        return (StatusCode::NOT_MODIFIED, [(header::ETAG, etag)]).into_response();
    }
    let head = [(header::ETAG, etag), (header::CONTENT_TYPE, "application/json".to_owned())];
    (head, body.into()).into_response()
}

fn text_of(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("these types hold only what JSON can")
}

/// Answers with JSON.
pub fn json(value: &impl Serialize) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], text_of(value)).into_response()
}

/// Answers with a new resource.
pub fn created<T: Serialize>(resource: &Resource<T>) -> Response {
    let head = [
        (header::LOCATION, resource.href.clone()),
        (header::ETAG, resource.etag.clone()),
        (header::CONTENT_TYPE, "application/json".to_owned()),
    ];
    (StatusCode::CREATED, head, text_of(&resource.value)).into_response()
}

/// Answers with a resource, or with 304 if the requester has it already.
pub fn shown<T: Serialize>(headers: &HeaderMap, resource: &Resource<T>) -> Response {
    tagged(headers, resource.etag.clone(), text_of(&resource.value))
}

/// Answers with a changed resource.
pub fn changed<T: Serialize>(resource: &Resource<T>) -> Response {
    shown(&HeaderMap::new(), resource)
}
