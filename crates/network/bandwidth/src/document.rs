//! The OpenAPI document is derived from the types, and compared with the one that is checked in.

use utoipa::OpenApi as _;

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "cotorra's Bandwidth Management API",
        description = "ETSI GS MEC 015 v2.2.1, as far as a testbed can give it. Where a token is set, every request but \
            this document's needs it as `Authorization: Bearer`. Beside this, the service of a domain and its applications is \
            under `/domains/{name}/bwm/v1`.",
        license(name = "MIT OR Apache-2.0"),
        version = "2.2.1"
    ),
    servers((url = "/bwm/v1")),
    paths(paths::list, paths::create, paths::show, paths::replace, paths::modify, paths::remove),
    components(schemas(cotorra_mec::ProblemDetails))
)]
struct Document;

/// The resources of the service (ETSI GS MEC 015 v2.2.1, clause 8), which the API of a run serves.
#[allow(dead_code, reason = "only their descriptions are used")]
mod paths {
    use cotorra_mec::{ChangeProblems, RequestProblems};

    use crate::types::{BwInfo, BwInfoDeltas};

    /// Allocations. Only one of the parameters may be given.
    #[utoipa::path(get, path = "/bw_allocations", tag = "allocations",
        params(("app_instance_id" = Option<Vec<String>>, Query), ("app_name" = Option<Vec<String>>, Query),
            ("session_id" = Option<Vec<String>>, Query)),
        responses((status = 200, description = "the allocations that the caller sees", body = Vec<BwInfo>), RequestProblems))]
    pub(super) async fn list() {}

    /// Allocate bandwidth.
    #[utoipa::path(post, path = "/bw_allocations", tag = "allocations",
        request_body = BwInfo,
        responses((status = 201, description = "the allocation", body = BwInfo, headers(("Location" = String), ("ETag" = String))),
            RequestProblems, ChangeProblems))]
    pub(super) async fn create() {}

    /// An allocation.
    #[utoipa::path(get, path = "/bw_allocations/{allocationId}", tag = "allocations",
        params(("allocationId" = String, Path), ("If-None-Match" = Option<String>, Header)),
        responses((status = 200, description = "the allocation", body = BwInfo, headers(("ETag" = String))),
            (status = 304, description = "as known already"), RequestProblems))]
    pub(super) async fn show() {}

    /// Replace an allocation.
    #[utoipa::path(put, path = "/bw_allocations/{allocationId}", tag = "allocations",
        request_body = BwInfo,
        params(("allocationId" = String, Path), ("If-Match" = Option<String>, Header)),
        responses((status = 200, description = "the allocation", body = BwInfo, headers(("ETag" = String))), RequestProblems, ChangeProblems))]
    pub(super) async fn replace() {}

    /// Change parts of an allocation.
    #[utoipa::path(patch, path = "/bw_allocations/{allocationId}", tag = "allocations",
        request_body = BwInfoDeltas,
        params(("allocationId" = String, Path), ("If-Match" = Option<String>, Header)),
        responses((status = 200, description = "the allocation", body = BwInfo, headers(("ETag" = String))), RequestProblems, ChangeProblems))]
    pub(super) async fn modify() {}

    /// End an allocation.
    #[utoipa::path(delete, path = "/bw_allocations/{allocationId}", tag = "allocations",
        params(("allocationId" = String, Path), ("If-Match" = Option<String>, Header)),
        responses((status = 204, description = "it has ended"), RequestProblems, ChangeProblems))]
    pub(super) async fn remove() {}
}

#[test]
fn the_document_is_the_one_that_is_checked_in() {
    let document = Document::openapi();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/bwm.openapi.json");
    utoipa::documents::compare(&document, file.as_ref());
}
