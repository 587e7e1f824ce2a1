//! The OpenAPI document is derived from the types and handlers, and compared with the one that is checked in.

use utoipa::OpenApi as _;

use super::routes;

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "cotorra's WLAN Access Information Service",
        description = "ETSI GS MEC 028 v2.3.1, as far as a testbed can give it. Where a token is set, every request but \
            this document's needs it as `Authorization: Bearer`. Beside this, a domain's own service is under \
            `/domains/{name}/wai/v2`.",
        license(name = "MIT OR Apache-2.0"),
        version = "2.3.1"
    ),
    servers((url = "/wai/v2")),
    paths(
        routes::ap_information,
        routes::sta_information,
        routes::subscriptions,
        subscriptions::subscribe,
        subscriptions::subscription,
        subscriptions::resubscribe,
        subscriptions::unsubscribe,
        routes::measurements,
        routes::configure,
        routes::measurement,
        routes::reconfigure,
        routes::unconfigure
    ),
    components(schemas(crate::notification::Notification, cotorra_mec::ProblemDetails))
)]
struct Document;

/// The resources that all services have.
#[allow(dead_code, reason = "only their descriptions are used")]
mod subscriptions {
    use crate::requests::Subscription;

    /// Subscribe to notifications.
    #[utoipa::path(post, path = "/subscriptions", tag = "subscriptions",
        request_body = Subscription,
        responses((status = 201, description = "the subscription", body = Subscription, headers(("Location" = String), ("ETag" = String))),
            cotorra_mec::RequestProblems, cotorra_mec::ChangeProblems))]
    pub(super) async fn subscribe() {}

    /// A subscription.
    #[utoipa::path(get, path = "/subscriptions/{subscriptionId}", tag = "subscriptions",
        params(("subscriptionId" = String, Path), ("If-None-Match" = Option<String>, Header)),
        responses((status = 200, description = "the subscription", body = Subscription, headers(("ETag" = String))),
            (status = 304, description = "as known already"), cotorra_mec::RequestProblems))]
    pub(super) async fn subscription() {}

    /// Replace a subscription by another of its type.
    #[utoipa::path(put, path = "/subscriptions/{subscriptionId}", tag = "subscriptions",
        request_body = Subscription,
        params(("subscriptionId" = String, Path), ("If-Match" = Option<String>, Header)),
        responses((status = 200, description = "the subscription", body = Subscription, headers(("ETag" = String))), cotorra_mec::RequestProblems, cotorra_mec::ChangeProblems))]
    pub(super) async fn resubscribe() {}

    /// End a subscription.
    #[utoipa::path(delete, path = "/subscriptions/{subscriptionId}", tag = "subscriptions",
        params(("subscriptionId" = String, Path), ("If-Match" = Option<String>, Header)),
        responses((status = 204, description = "it has ended"), cotorra_mec::RequestProblems, cotorra_mec::ChangeProblems))]
    pub(super) async fn unsubscribe() {}
}

#[test]
fn the_document_is_the_one_that_is_checked_in() {
    let document = Document::openapi();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/wais.openapi.json");
    utoipa::documents::compare(&document, file.as_ref());
}
