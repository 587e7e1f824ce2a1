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
        routes::subscribe,
        routes::subscription,
        routes::resubscribe,
        routes::unsubscribe,
        routes::measurements,
        routes::configure,
        routes::measurement,
        routes::reconfigure,
        routes::unconfigure
    ),
    components(schemas(crate::notification::Notification, cotorra_mec::ProblemDetails))
)]
struct Document;

#[test]
fn the_document_is_the_one_that_is_checked_in() {
    let document = Document::openapi();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/wais.openapi.json");
    utoipa::documents::compare(&document, file.as_ref());
}
