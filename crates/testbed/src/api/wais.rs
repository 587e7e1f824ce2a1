//! The WLAN Access Information Service (ETSI GS MEC 028): `/wai/v2` for all of the testbed, `/domains/{name}/wai/v2` for
//! the radio units of one domain.

use std::{sync::Arc, time::Duration};

use axum::{Router, http::StatusCode, middleware, routing::get};
use cotorra_graph::Timestamp;
use cotorra_mec::{Problem, Task, deliver};
use cotorra_wais::{
    Scope, Site, Survey,
    http::{Service, Testbed, openapi},
};

use super::{
    auth::{self, Gate},
    context::Context,
};

/// Longest age of answers in real time.
const FRESHNESS: Duration = Duration::from_millis(20);

/// Returns the services' paths, and the tasks that send their notifications.
pub(super) fn serve(context: &Context, gate: Gate) -> (Router, Vec<Task>) {
    let graph = &context.testbed.graph;
    let settings = &context.testbed.wais;
    let testbed: Arc<dyn Testbed> = Arc::new(ApiState(context.clone()));
    let service = |scope: Scope, prefix: String| {
        let allowed = context.callbacks(matches!(scope, Scope::Testbed));
        let site = Site::new(graph, settings, &scope);
        Service::new(Arc::clone(&testbed), site, context.wais.epoch, allowed, prefix)
    };
    let of_domain = |domain: &cotorra_graph::DomainId| {
        service(Scope::Domain(domain.clone()), format!("/domains/{domain}/wai/v2"))
    };
    let mut services = vec![service(Scope::Testbed, "/wai/v2".to_owned())];
    services.extend(graph.domains.iter().map(of_domain));
    let no_domain =
        || async { Problem::new(StatusCode::NOT_FOUND, "there is no such domain; see /api/v1/testbed") };
    let document = openapi();
    let router = services
        .iter()
        .fold(Router::new(), |router, service| router.nest(service.prefix(), service.router()))
        .route("/domains/{*rest}", axum::routing::any(no_domain))
        .layer(middleware::from_fn_with_state(gate, auth::check_mec))
        .route(
            "/wai/v2/openapi.json",
            get(move || async move { ([("content-type", "application/json")], document) }),
        );
    (router, services.into_iter().map(deliver).collect())
}

/// The API's state, in the form that the service needs.
struct ApiState(Context);

impl Testbed for ApiState {
    fn now(&self) -> Timestamp {
        self.0.now()
    }

    fn survey(&self, site: &Arc<Site>) -> Survey {
        self.0.live.read(|now| site.survey(now.radio_units_at, &now.radio_units, &now.robots, &now.links))
    }

    fn freshness(&self) -> Duration {
        // While virtual time stands still, the same request always has the same answer.
        if self.0.wais.clock.is_some() { FRESHNESS } else { Duration::ZERO }
    }

    fn tell(&self, message: String) {
        self.0.tell(message);
    }
}
