//! Services of ETSI MEC: `/wai/v2`, the WLAN Access Information Service (ETSI GS MEC 028), and `/location/v2`, the
//! Location API (ETSI GS MEC 013), for all of the testbed. Below `/domains/{name}` each domain has both for its own radio
//! units.

use std::{sync::Arc, time::Duration};

use axum::{Router, http::StatusCode, middleware, routing::get};
use cotorra_graph::Timestamp;
use cotorra_location::{self as location, Location};
use cotorra_mec::{Machine, Problem, Scope, Service, Task, Testbed, deliver};
use cotorra_wais::{self as wais, Wais};

use super::{
    auth::{self, Gate},
    context::Context,
};

/// Longest age of answers in real time.
const FRESHNESS: Duration = Duration::from_millis(20);

/// Returns the services' paths, and the tasks that send their notifications.
pub(super) fn serve(context: &Context, gate: Gate) -> (Router, Vec<Task>) {
    let testbed = &context.testbed;
    let (graph, settings, epoch) = (&testbed.graph, &testbed.wais, context.wais.epoch);
    let domains = graph.domains.iter();
    let domains = domains.map(|domain| (Scope::Domain(domain.clone()), format!("/domains/{domain}")));
    let scopes = [(Scope::Testbed, String::new())].into_iter().chain(domains);
    let (mut router, mut tasks) = (Router::new(), Vec::new());
    for (scope, above) in scopes {
        let site = Arc::new(wais::Site::new(graph, settings, &scope));
        let service = of_scope(context, &scope, Wais::new(site, epoch), format!("{above}/wai/v2"));
        router = router.nest(service.prefix(), wais::http::router(&service));
        tasks.push(deliver(service));
        let site = Arc::new(location::Site::new(graph, &testbed.name, settings.origin, &scope));
        let service = of_scope(context, &scope, Location::new(site, epoch), format!("{above}/location/v2"));
        router = router.nest(service.prefix(), location::http::router(&service));
        tasks.push(deliver(service));
    }
    let no_domain =
        || async { Problem::new(StatusCode::NOT_FOUND, "there is no such domain; see /api/v1/testbed") };
    let document = wais::http::openapi();
    let router = router
        .route("/domains/{*rest}", axum::routing::any(no_domain))
        .layer(middleware::from_fn_with_state(gate, auth::check_mec))
        .route(
            "/wai/v2/openapi.json",
            get(move || async move { ([("content-type", "application/json")], document) }),
        );
    (router, tasks)
}

/// Serves a state machine of a scope below a path.
fn of_scope<M: Machine>(context: &Context, scope: &Scope, machine: M, prefix: String) -> Service<M>
where
    ApiState: Testbed<M>,
{
    let allowed = context.callbacks(*scope == Scope::Testbed);
    Service::new(Arc::new(ApiState(context.clone())), machine, allowed, prefix)
}

/// The API's state, in the form that the services need.
struct ApiState(Context);

impl ApiState {
    fn freshness(&self) -> Duration {
        // While virtual time stands still, the same request always has the same answer.
        if self.0.wais.clock.is_some() { FRESHNESS } else { Duration::ZERO }
    }
}

impl Testbed<Wais> for ApiState {
    fn now(&self) -> Timestamp {
        self.0.now()
    }

    fn survey(&self, site: &Arc<wais::Site>) -> wais::Survey {
        self.0.live.read(|now| site.survey(now.radio_units_at, &now.radio_units, &now.robots, &now.links))
    }

    fn freshness(&self) -> Duration {
        self.freshness()
    }

    fn tell(&self, message: String) {
        self.0.tell(message);
    }
}

impl Testbed<Location> for ApiState {
    fn now(&self) -> Timestamp {
        self.0.now()
    }

    fn survey(&self, site: &Arc<location::Site>) -> location::Survey {
        self.0.live.read(|now| site.survey(now.at, &now.radio_units, &now.robots))
    }

    fn freshness(&self) -> Duration {
        self.freshness()
    }

    fn tell(&self, message: String) {
        self.0.tell(message);
    }
}
