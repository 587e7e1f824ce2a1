//! Applications of ETSI MEC, and whether they are ready.

use axum::{Extension, Json};
use cotorra_app_enablement::Support;
use cotorra_graph::{DomainId, Timestamp, VnfId};
use cotorra_mec::Service;
use serde::Serialize;

use super::auth::Caller;

/// A VNF that is an application of ETSI MEC.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ApplicationBody {
    /// Its name, which is its `appInstanceId`.
    application: VnfId,
    /// The domain whose platform it belongs to.
    domain: DomainId,
    /// When it confirmed that it is ready (ETSI GS MEC 011); `null` if it has not.
    ready_at_ns: Option<Timestamp>,
}

/// The applications of each domain, and when they confirmed that they are ready. Clones share it.
#[derive(Clone, Default)]
pub(super) struct Readiness(Vec<(DomainId, Service<Support>)>);

impl Readiness {
    /// Adds the applications of a domain.
    pub(super) fn add(&mut self, domain: DomainId, applications: Service<Support>) {
        self.0.push((domain, applications));
    }
}

/// Returns the VNFs that are applications of ETSI MEC, and when each confirmed that it is ready.
#[utoipa::path(get, path = "/api/v1/network/applications", tag = "network",
    responses((status = 200, body = Vec<ApplicationBody>)))]
pub(super) async fn applications(
    Extension(readiness): Extension<Readiness>,
    Extension(caller): Extension<Caller>,
) -> Json<Vec<ApplicationBody>> {
    let mut all = Vec::new();
    for (domain, service) in &readiness.0 {
        if caller.keeps(|view| view.domain() == domain) {
            service.with(|support| {
                all.extend(support.readiness().map(|(application, ready_at_ns)| ApplicationBody {
                    application: application.clone(),
                    domain: domain.clone(),
                    ready_at_ns,
                }));
            });
        }
    }
    Json(all)
}
