//! The HTTP resources of the three services.

use axum::{
    Router,
    extract::{Path, State},
    http::{HeaderMap, StatusCode},
    response::{IntoResponse as _, Response},
    routing::{MethodRouter, get, post},
};
use cotorra_mec::{Base, Id, Json, Parameters, Problem, Service, changed, created, if_match, json, shown};

use crate::{
    mobility::{Mobility, RegistrationInfo},
    registry::{Registry, ServiceInfo, ServiceQuery},
    support::{Confirmation, Rules, Support},
};

type Answer = Result<Response, Problem>;
type Resources<M, const N: usize> = [(&'static str, MethodRouter<Service<M>>); N];

/// Returns the resources of a registry (ETSI GS MEC 011 v3.1.1, clause 8.2).
pub fn registry(service: &Service<Registry>) -> Router {
    let resources: Resources<Registry, 6> = [
        ("/services", get(services)),
        ("/services/{serviceId}", get(service_info)),
        ("/transports", get(transports)),
        ("/applications/{appInstanceId}/services", get(services_of).post(register)),
        (
            "/applications/{appInstanceId}/services/{serviceId}",
            get(service_of).put(update).delete(deregister),
        ),
        ("/applications/{appInstanceId}/subscriptions", get(availability_links)),
    ];
    cotorra_mec::router(service, resources)
}

/// Returns the resources of application support (ETSI GS MEC 011 v3.1.1, clause 7.2).
pub fn support(service: &Service<Support>) -> Router {
    let rule =
        |of| get(move |state, path| rule(of, state, path)).put(move |state, path| rule(of, state, path));
    let resources: Resources<Support, 11> = [
        ("/applications/{appInstanceId}/subscriptions", get(termination_links)),
        ("/timing/timing_caps", get(timing_caps)),
        ("/timing/current_time", get(current_time)),
        ("/applications/{appInstanceId}/traffic_rules", get(rules)),
        ("/applications/{appInstanceId}/traffic_rules/{trafficRuleId}", rule(Rules::Traffic)),
        ("/applications/{appInstanceId}/dns_rules", get(rules)),
        ("/applications/{appInstanceId}/dns_rules/{dnsRuleId}", rule(Rules::Dns)),
        (
            "/applications/{appInstanceId}/confirm_termination",
            post(|state, id, body| confirm(Confirmation::Termination, state, id, body)),
        ),
        (
            "/applications/{appInstanceId}/confirm_ready",
            post(|state, id, body| confirm(Confirmation::Ready, state, id, body)),
        ),
        ("/registrations", post(new_registration)),
        ("/registrations/{appInstanceId}", get(registration)),
    ];
    cotorra_mec::router(service, resources)
}

/// Returns the resources of application mobility (ETSI GS MEC 021 v2.2.1, clause 8).
pub fn mobility(service: &Service<Mobility>) -> Router {
    let resources: Resources<Mobility, 4> = [
        ("/app_mobility_services", get(mobile).post(register_mobile)),
        (
            "/app_mobility_services/{appMobilityServiceId}",
            get(mobile_one).put(update_mobile).delete(deregister_mobile),
        ),
        ("/app_mobility_services/{appMobilityServiceId}/deregister_task", post(deregister_mobile)),
        ("/subscriptions", get(mobility_links)),
    ];
    cotorra_mec::router(service, resources)
}

/// Rejects parameters where there are none.
fn none(given: &[(String, String)]) -> Result<(), Problem> {
    match given.first() {
        None => Ok(()),
        Some((name, _)) => Err(Problem::bad_request(format!("there is no parameter `{name}` here"))),
    }
}

async fn services(
    State(service): State<Service<Registry>>,
    Base(base): Base,
    Parameters(given): Parameters,
) -> Answer {
    let query = ServiceQuery::read(given)?;
    Ok(json(&service.with(|registry| registry.services(&base, &query))))
}

async fn service_info(
    State(service): State<Service<Registry>>,
    Base(base): Base,
    Id(id): Id,
    headers: HeaderMap,
) -> Answer {
    Ok(shown(&headers, &service.with(|registry| registry.service(&base, &id))?))
}

/// The platform has no transports: it carries no messages for services.
async fn transports(Parameters(given): Parameters) -> Answer {
    none(&given)?;
    Ok(json(&[(); 0]))
}

async fn services_of(
    State(service): State<Service<Registry>>,
    Base(base): Base,
    Path(application): Path<String>,
    Parameters(given): Parameters,
) -> Answer {
    let query = ServiceQuery::read(given)?;
    Ok(json(&service.with(|registry| registry.services_of(&base, &application, &query))?))
}

async fn register(
    State(service): State<Service<Registry>>,
    Base(base): Base,
    Path(application): Path<String>,
    Json(body): Json,
) -> Answer {
    let (now, info) = (service.now(), ServiceInfo::read(&body)?);
    let made = service.with(|registry| registry.register(now, &base, &application, info))?;
    service.wake();
    Ok(created(&made))
}

async fn service_of(
    State(service): State<Service<Registry>>,
    Base(base): Base,
    Path((application, id)): Path<(String, String)>,
    headers: HeaderMap,
) -> Answer {
    Ok(shown(&headers, &service.with(|registry| registry.service_of(&base, &application, &id))?))
}

async fn update(
    State(service): State<Service<Registry>>,
    Base(base): Base,
    Path((application, id)): Path<(String, String)>,
    headers: HeaderMap,
    Json(body): Json,
) -> Answer {
    let (now, info, of) = (service.now(), ServiceInfo::read(&body)?, (&*application, &*id));
    let resource = service.with(|registry| registry.update(now, &base, of, if_match(&headers), info))?;
    service.wake();
    Ok(changed(&resource))
}

async fn deregister(
    State(service): State<Service<Registry>>,
    Path((application, id)): Path<(String, String)>,
    headers: HeaderMap,
) -> Answer {
    let now = service.now();
    service.with(|registry| registry.deregister(now, (&application, &id), if_match(&headers)))?;
    service.wake();
    Ok(StatusCode::NO_CONTENT.into_response())
}

async fn availability_links(
    State(service): State<Service<Registry>>,
    Base(base): Base,
    Path(application): Path<String>,
    Parameters(given): Parameters,
) -> Answer {
    none(&given)?;
    Ok(json(&service.with(|registry| registry.links(&base, &application))?))
}

async fn termination_links(
    State(service): State<Service<Support>>,
    Base(base): Base,
    Path(application): Path<String>,
    Parameters(given): Parameters,
) -> Answer {
    none(&given)?;
    Ok(json(&service.with(|support| support.links(&base, &application))?))
}

async fn timing_caps(State(service): State<Service<Support>>, Parameters(given): Parameters) -> Answer {
    none(&given)?;
    let now = service.now();
    Ok(json(&service.with(|support| support.timing_caps(now))))
}

async fn current_time(State(service): State<Service<Support>>, Parameters(given): Parameters) -> Answer {
    none(&given)?;
    let now = service.now();
    Ok(json(&service.with(|support| support.current_time(now))))
}

async fn rules(State(service): State<Service<Support>>, Path(application): Path<String>) -> Answer {
    Ok(json(&service.with(|support| support.rules(&application))?))
}

async fn rule(
    of: Rules,
    State(service): State<Service<Support>>,
    Path((application, id)): Path<(String, String)>,
) -> Answer {
    Ok(json(&service.with(|support| support.rule(&application, of, &id))?))
}

async fn confirm(
    what: Confirmation,
    State(service): State<Service<Support>>,
    Path(application): Path<String>,
    Json(body): Json,
) -> Answer {
    let now = service.now();
    service.with(|support| support.confirm(now, &application, what, &body))?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

async fn new_registration(State(service): State<Service<Support>>) -> Answer {
    Err(service.with(|support| support.register()).into())
}

async fn registration(State(service): State<Service<Support>>, Path(application): Path<String>) -> Answer {
    Ok(json(&service.with(|support| support.registration(&application))?))
}

async fn mobile(State(service): State<Service<Mobility>>, Parameters(given): Parameters) -> Answer {
    none(&given)?;
    Ok(json(&service.with(|mobility| mobility.registrations())))
}

async fn mobile_one(
    State(service): State<Service<Mobility>>,
    Base(base): Base,
    Id(id): Id,
    headers: HeaderMap,
) -> Answer {
    Ok(shown(&headers, &service.with(|mobility| mobility.registration(&base, &id))?))
}

async fn register_mobile(
    State(service): State<Service<Mobility>>,
    Base(base): Base,
    Json(body): Json,
) -> Answer {
    let (now, info) = (service.now(), RegistrationInfo::read(&body)?);
    Ok(created(&service.with(|mobility| mobility.register(now, &base, info))?))
}

async fn update_mobile(
    State(service): State<Service<Mobility>>,
    Base(base): Base,
    Id(id): Id,
    headers: HeaderMap,
    Json(body): Json,
) -> Answer {
    let (now, info) = (service.now(), RegistrationInfo::read(&body)?);
    let resource = service.with(|mobility| mobility.update(now, &base, &id, if_match(&headers), info))?;
    Ok(changed(&resource))
}

async fn deregister_mobile(
    State(service): State<Service<Mobility>>,
    Id(id): Id,
    headers: HeaderMap,
) -> Answer {
    let now = service.now();
    service.with(|mobility| mobility.deregister(now, &id, if_match(&headers)))?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

async fn mobility_links(
    State(service): State<Service<Mobility>>,
    Base(base): Base,
    Parameters(given): Parameters,
) -> Answer {
    none(&given)?;
    Ok(json(&service.with(|mobility| mobility.links(&base))))
}
