//! Answers of resources, with entity tags.

use axum::{
    body::Body,
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;

use crate::{conditional::is_known, extract::text, subscribing::Resource};

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
