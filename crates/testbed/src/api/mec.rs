//! Services of ETSI MEC. `/wai/v2`, the WLAN Access Information Service (ETSI GS MEC 028), `/location/v2`, the Location
//! API (ETSI GS MEC 013), and `/bwm/v1`, the Bandwidth Management API (ETSI GS MEC 015), are for all of the testbed. Below
//! `/domains/{name}` each domain has them for its own nodes, and serves its applications: `/mec_service_mgmt/v1` and
//! `/mec_app_support/v1` (ETSI GS MEC 011), and `/amsi/v1` (ETSI GS MEC 021).

use std::{sync::Arc, time::Duration};

use axum::{
    Router,
    http::StatusCode,
    middleware,
    routing::{any, get},
};
use cotorra_app_enablement::{self as enablement, Mobility, Provided, Registry, Support};
use cotorra_graph::{DomainId, Timestamp};
use cotorra_location::{self as location, Location};
use cotorra_mec::{Machine, Problem, Scope, Service, Task, Testbed, deliver};
use cotorra_plugin::wire;
use cotorra_wais::{self as wais, Wais};

use super::{
    auth::{self, Gate},
    bandwidth::{self, Allocations},
    context::Context,
    readiness::Readiness,
};
use crate::{
    domain::{DomainView, Domains},
    events::live::Snapshot,
};

/// Longest age of answers in real time.
const FRESHNESS: Duration = Duration::from_millis(20);

/// The services of ETSI MEC.
pub(super) struct Served {
    context: Context,
    /// Their paths.
    pub(super) router: Router,
    /// The tasks that send their notifications.
    pub(super) tasks: Vec<Task>,
    /// The applications of each domain, and when they confirmed that they are ready.
    pub(super) readiness: Readiness,
}

/// Returns the services.
pub(super) fn serve(context: &Context, gate: Gate, domains: &Domains) -> Served {
    let mut served = Served {
        context: context.clone(),
        router: Router::new(),
        tasks: Vec::new(),
        readiness: Readiness::default(),
    };
    let allocations = Allocations::new(context);
    served.tasks.extend(allocations.follow());
    served.add_bandwidth(&allocations, "", None);
    served.add_radio(&Scope::Testbed, "");
    for domain in &context.testbed.graph.domains {
        let above = format!("/domains/{domain}");
        served.add_radio(&Scope::Domain(domain.clone()), &above);
        served.add_applications(domain, domains, &above);
        served.add_bandwidth(&allocations, &above, domains.view(domain));
    }
    let no_domain =
        || async { Problem::new(StatusCode::NOT_FOUND, "there is no such domain; see /api/v1/testbed") };
    let router = std::mem::take(&mut served.router)
        .route("/domains/{*rest}", any(no_domain))
        .layer(middleware::from_fn_with_state(gate, auth::check_mec));
    let documents = [
        ("/wai/v2/openapi.json", wais::http::openapi()),
        ("/location/v2/openapi.json", location::http::openapi()),
        ("/bwm/v1/openapi.json", cotorra_bandwidth::openapi()),
    ];
    let with_document = |router: Router, (path, document): (_, String)| {
        router.route(path, get(async move || ([("content-type", "application/json")], document)))
    };
    Served { router: documents.into_iter().fold(router, with_document), ..served }
}

/// Returns the services' paths at a port of an emulated node, which applications reach.
pub(super) fn on_node(services: Router) -> Router {
    let lifecycle = "app_lcm is for the operator and orchestrators of domains, beside the emulated network";
    services
        .route("/app_lcm/{*rest}", any(async move || Problem::new(StatusCode::FORBIDDEN, lifecycle)))
        .fallback(async || Problem::new(StatusCode::NOT_FOUND, "there is no such path for applications"))
}

impl Served {
    /// Adds the services of the radio in a scope, below a path.
    fn add_radio(&mut self, scope: &Scope, above: &str) {
        let testbed = Arc::clone(&self.context.testbed);
        let (graph, settings, epoch) = (&testbed.graph, &testbed.wais, self.context.wais.epoch);
        let wais = Wais::new(Arc::new(wais::Site::new(graph, settings, scope)), epoch);
        self.add(scope, wais, format!("{above}/wai/v2"), wais::http::router);
        let site = location::Site::new(graph, &testbed.name, settings.origin, scope);
        let location = Location::new(Arc::new(site), epoch);
        self.add(scope, location, format!("{above}/location/v2"), location::http::router);
    }

    /// Adds allocations of bandwidth below a path, for the operator or for the domain of a view.
    fn add_bandwidth(&mut self, allocations: &Allocations, above: &str, view: Option<&Arc<DomainView>>) {
        let prefix = format!("{above}{}", bandwidth::PATH);
        let all = std::mem::take(&mut self.router);
        self.router = all.nest(&prefix, allocations.router(prefix.clone(), view));
    }

    /// Adds the services for applications of a domain, below a path.
    fn add_applications(&mut self, domain: &DomainId, domains: &Domains, above: &str) {
        let Some(view) = domains.view(domain) else { return };
        let testbed = Arc::clone(&self.context.testbed);
        let site =
            Arc::new(enablement::Site::new(&testbed.graph, view.testbed(), |vnf| wire::port(&testbed, vnf)));
        let (scope, epoch) = (Scope::Domain(domain.clone()), self.context.wais.epoch);
        let provided = |name, standard, version, path: String| Provided { name, standard, version, path };
        let services = vec![
            provided("wai", "MEC 028", "2.3.1", format!("{above}/wai/v2")),
            provided("location", "MEC 013", "3.1.1", format!("{above}/location/v2")),
            provided("bwm", "MEC 015", "2.2.1", format!("{above}{}", bandwidth::PATH)),
            provided("amsi", "MEC 021", "2.2.1", format!("{above}/amsi/v1")),
            provided("app_lcm", "MEC 010-2", "2.1.1", "/app_lcm/v1".to_owned()),
        ];
        let registry = Registry::new(Arc::clone(&site), epoch, services);
        self.add(&scope, registry, format!("{above}/mec_service_mgmt/v1"), enablement::http::registry);
        let support = Support::new(Arc::clone(&site), epoch);
        let support =
            self.add(&scope, support, format!("{above}/mec_app_support/v1"), enablement::http::support);
        self.readiness.add(domain.clone(), support);
        let mobility = Mobility::new(site, epoch);
        self.add(&scope, mobility, format!("{above}/amsi/v1"), enablement::http::mobility);
    }

    /// Adds a service below a path, and returns it.
    fn add<M: Surveyor>(
        &mut self,
        scope: &Scope,
        machine: M,
        prefix: String,
        router: impl Fn(&Service<M>) -> Router,
    ) -> Service<M> {
        let allowed = self.context.callbacks(*scope == Scope::Testbed);
        let service = Service::new(Arc::new(ApiState(self.context.clone())), machine, allowed, prefix);
        let all = std::mem::take(&mut self.router);
        self.router = all.nest(service.prefix(), router(&service));
        self.tasks.push(deliver(service.clone()));
        service
    }
}

/// A state machine that surveys the testbed's current state.
trait Surveyor: Machine {
    /// Surveys a site.
    fn survey(site: &Arc<Self::Site>, now: &Snapshot) -> Self::Survey;
}

impl Surveyor for Wais {
    fn survey(site: &Arc<wais::Site>, now: &Snapshot) -> wais::Survey {
        site.survey(now.radio_units_at, &now.radio_units, &now.robots, &now.links)
    }
}

impl Surveyor for Location {
    fn survey(site: &Arc<location::Site>, now: &Snapshot) -> location::Survey {
        site.survey(now.at, &now.radio_units, &now.robots)
    }
}

fn applications(site: &enablement::Site, now: &Snapshot) -> enablement::Applications {
    site.survey(now.at, &now.placements, &now.wanted, &now.added)
}

impl Surveyor for Registry {
    fn survey(site: &Arc<enablement::Site>, now: &Snapshot) -> enablement::Applications {
        applications(site, now)
    }
}

impl Surveyor for Support {
    fn survey(site: &Arc<enablement::Site>, now: &Snapshot) -> enablement::Applications {
        applications(site, now)
    }
}

impl Surveyor for Mobility {
    fn survey(site: &Arc<enablement::Site>, now: &Snapshot) -> enablement::Applications {
        applications(site, now)
    }
}

/// The API's state, in the form that the services need.
struct ApiState(Context);

impl<M: Surveyor> Testbed<M> for ApiState {
    fn now(&self) -> Timestamp {
        self.0.now()
    }

    fn survey(&self, site: &Arc<M::Site>) -> M::Survey {
        self.0.live.read(|now| M::survey(site, now))
    }

    fn freshness(&self) -> Duration {
        // While virtual time stands still, the same request always has the same answer.
        if self.0.wais.clock.is_some() { FRESHNESS } else { Duration::ZERO }
    }

    fn tell(&self, message: String) {
        self.0.tell(message);
    }
}
