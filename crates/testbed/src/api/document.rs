//! The OpenAPI document is derived from the types and handlers, and compared with the one that is checked in.

use utoipa::OpenApi as _;

use super::{capture, clock, coverage, map, measurements, readiness, routes, sensors, stream};

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "cotorra",
        description = "A running testbed: its robots, its network, its measurements and its events. \
            Times are nanoseconds since the run began unless a name says otherwise. \
            Where a token is set, every request but this document's needs it as `Authorization: Bearer`. The operator's \
            opens all; a domain's what is of its own nodes, and what it asks of others is answered with 403.",
        license(name = "MIT OR Apache-2.0")
    ),
    paths(
        routes::testbed,
        clock::clock,
        clock::control,
        map::map,
        map::image,
        routes::node,
        routes::machine,
        routes::robots,
        routes::robot,
        routes::candidates,
        sensors::sensors,
        sensors::large_data,
        routes::links,
        routes::test_throughput,
        capture::capture,
        routes::radio_units,
        coverage::coverage,
        routes::placements,
        readiness::applications,
        routes::virtual_links,
        routes::vnfs,
        routes::add_vnf,
        routes::remove_vnf,
        routes::instruct,
        measurements::robot_history,
        measurements::link_history,
        measurements::machine_history,
        measurements::service_times,
        measurements::handovers,
        measurements::event_history,
        measurements::state,
        measurements::series,
        measurements::gaps,
        measurements::retained,
        measurements::runs,
        measurements::verdict,
        measurements::kpis,
        measurements::difference,
        stream::events,
        stream::done
    ),
    components(schemas(cotorra_graph::Stamped))
)]
struct Document;

#[test]
fn the_document_is_the_one_that_is_checked_in() {
    let mut document = Document::openapi();
    describe_answers(&mut document);
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/openapi.json");
    utoipa::documents::compare(&document, file.as_ref());
}

/// Describes the answers of every operation. The description of a success is the operation's first sentence. Failures are
/// added: an invalid request, a rejected caller, a missing object, an unreadable body, and an ended run.
fn describe_answers(document: &mut utoipa::openapi::OpenApi) {
    use utoipa::openapi::{Ref, RefOr, ResponseBuilder, content::ContentBuilder};
    let always = [
        ("400", "the request cannot be"),
        ("401", "the API needs its token"),
        ("403", "it is of another domain than the token, or asked by a web page from elsewhere"),
        ("404", "there is no such thing"),
        ("503", "the run has ended, or its history cannot answer"),
    ];
    let with_body = [
        ("413", "the body is too long"),
        ("415", "the body does not say that it is JSON"),
        ("422", "the body is not what it should be"),
    ];
    let operations =
        document.paths.paths.values_mut().flat_map(|item| {
            [&mut item.get, &mut item.post, &mut item.put, &mut item.delete, &mut item.patch]
        });
    for operation in operations.flatten() {
        let summary = operation.summary.as_deref().unwrap_or_default();
        let first = summary.split_inclusive(". ").next().unwrap_or_default().trim_end().trim_end_matches('.');
        for answer in operation.responses.responses.values_mut() {
            if let RefOr::T(answer) = answer
                && answer.description.is_empty()
            {
                answer.description = first.replace('\n', " ");
            }
        }
        let bodies = with_body.into_iter().filter(|_| operation.request_body.is_some());
        for (status, description) in always.into_iter().chain(bodies) {
            let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("FailureBody"))).build();
            let response =
                ResponseBuilder::new().description(description).content("application/json", content).build();
            operation.responses.responses.entry(status.to_owned()).or_insert(RefOr::T(response));
        }
    }
}
