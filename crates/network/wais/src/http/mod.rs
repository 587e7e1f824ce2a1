//! HTTP resources of a [`Wais`].

#[cfg(test)]
mod document;
mod routes;

use axum::{
    Router,
    routing::{MethodRouter, get},
};

use crate::wais::Wais;

/// A service that is ready to be served.
pub type Service = cotorra_mec::Service<Wais>;

/// The resources; [`openapi`] describes them.
fn resources() -> [(&'static str, MethodRouter<Service>); 5] {
    [
        ("/queries/ap/ap_information", get(routes::ap_information)),
        ("/queries/sta/sta_information", get(routes::sta_information)),
        ("/subscriptions", get(routes::subscriptions)),
        ("/measurements", get(routes::measurements).post(routes::configure)),
        (
            "/measurements/{measurementConfigId}",
            get(routes::measurement).put(routes::reconfigure).delete(routes::unconfigure),
        ),
    ]
}

/// Returns the OpenAPI document of the service, which is checked in. A test derives it from the types and handlers, and compares.
pub fn openapi() -> String {
    include_str!("../../../../../docs/wais.openapi.json").to_owned()
}

/// Returns the resources of a service.
pub fn router(service: &Service) -> Router {
    cotorra_mec::router(service, resources())
}

#[cfg(test)]
mod tests;
