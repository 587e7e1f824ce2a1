//! The resources of subscriptions, which all services have.

use axum::{
    extract::State,
    http::{HeaderMap, StatusCode, Uri},
    response::{IntoResponse as _, Response},
};

use crate::{
    answer::{changed, created, shown},
    extract::{Base, Id, Json, if_match},
    problem::Problem,
    service::{Machine, Service},
    subscriptions::Subscribed as _,
};

type Answer = Result<Response, Problem>;

/// Returns the path of a list.
fn list(uri: &Uri) -> &str {
    uri.path().trim_start_matches('/')
}

/// Returns the path of the list that a subscription is in.
fn list_of(uri: &Uri) -> &str {
    list(uri).rsplit_once('/').map_or("", |(list, _)| list)
}

pub(crate) async fn subscribe<M: Machine>(
    State(service): State<Service<M>>,
    Base(base): Base,
    uri: Uri,
    Json(body): Json,
) -> Answer {
    let subscription = M::Subscription::read(list(&uri), &body)?;
    service.check(&subscription).await?;
    let now = service.now();
    let resource = service.with(|machine| machine.subscribe(now, &base, subscription))?;
    service.wake();
    Ok(created(&resource))
}

pub(crate) async fn subscription<M: Machine>(
    State(service): State<Service<M>>,
    Base(base): Base,
    Id(id): Id,
    uri: Uri,
    headers: HeaderMap,
) -> Answer {
    let resource = service.with(|machine| machine.subscriptions().get(&base, list_of(&uri), &id))?;
    Ok(shown(&headers, &resource))
}

pub(crate) async fn resubscribe<M: Machine>(
    State(service): State<Service<M>>,
    Base(base): Base,
    Id(id): Id,
    uri: Uri,
    headers: HeaderMap,
    Json(body): Json,
) -> Answer {
    let list = list_of(&uri);
    service.with(|machine| machine.subscriptions().get(&base, list, &id).map(drop))?;
    let subscription = M::Subscription::read(list, &body)?;
    service.check(&subscription).await?;
    let (now, if_match) = (service.now(), if_match(&headers));
    let resource = service.with(|machine| machine.resubscribe(now, &base, &id, if_match, subscription))?;
    service.wake();
    Ok(changed(&resource))
}

pub(crate) async fn unsubscribe<M: Machine>(
    State(service): State<Service<M>>,
    Id(id): Id,
    uri: Uri,
    headers: HeaderMap,
) -> Answer {
    let now = service.now();
    service.with(|machine| machine.subscriptions().remove(now, list_of(&uri), &id, if_match(&headers)))?;
    service.wake();
    Ok(StatusCode::NO_CONTENT.into_response())
}
