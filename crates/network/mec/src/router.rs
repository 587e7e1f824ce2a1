//! The router of a service: its own resources, and those of its subscriptions.

use axum::{
    Router,
    http::StatusCode,
    middleware,
    routing::{MethodRouter, get, post},
};

use crate::{
    extract::check,
    problem::Problem,
    service::{Machine, Service},
    subscription_routes::{resubscribe, subscribe, subscription, unsubscribe},
    subscriptions::Subscribed as _,
    websocket,
};

/// Returns a router of a service's resources and of its subscriptions. The resources have the queries of the lists of
/// subscriptions. Every answer follows the standard, also for unknown paths and methods.
pub fn router<M: Machine>(
    service: &Service<M>,
    resources: impl IntoIterator<Item = (&'static str, MethodRouter<Service<M>>)>,
) -> Router {
    let no_path = || async { Problem::new(StatusCode::NOT_FOUND, "there is no such path here") };
    let no_method =
        || async { Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method not allowed: see `Allow`") };
    let router =
        resources.into_iter().fold(Router::new(), |router, (path, methods)| router.route(path, methods));
    M::Subscription::LISTS
        .iter()
        .fold(router, |router, list| {
            let one = format!("/{list}/{{subscriptionId}}");
            let methods = get(subscription::<M>).put(resubscribe::<M>).delete(unsubscribe::<M>);
            router
                .route(&format!("/{list}"), post(subscribe::<M>))
                .route(&format!("{one}/websocket"), get(websocket::open::<M>))
                .route(&one, methods)
        })
        .fallback(no_path)
        .method_not_allowed_fallback(no_method)
        .layer(middleware::from_fn(check))
        .with_state(service.clone())
}
