//! The HTTP resources of a [`Location`] (ETSI GS MEC 013 v3.1.1, clause 7).

#[cfg(test)]
mod document;

use axum::{
    Router,
    extract::{Path, State},
    response::Response,
    routing::{MethodRouter, get},
};
use cotorra_mec::{Base, Id, Parameters, Problem, json};
use serde::Serialize;
use serde_json::{Map, Value};

use crate::{
    location::Location,
    requests::{List, Point, Subscription},
    view::{DistanceQuery, End, UserQuery},
};

/// A service that is ready to be served.
pub type Service = cotorra_mec::Service<Location>;

type Answer = Result<Response, Problem>;

/// Returns the OpenAPI document of the service, which is checked in. A test derives it from the types, and compares.
pub fn openapi() -> String {
    include_str!("../../../../docs/location.openapi.json").to_owned()
}

/// Returns the resources of a service.
pub fn router(service: &Service) -> Router {
    let queries: [(&'static str, MethodRouter<Service>); 6] = [
        ("/queries/distance", get(distance)),
        ("/queries/users", get(users)),
        ("/queries/zones", get(zones)),
        ("/queries/zones/{zoneId}", get(zone)),
        ("/queries/zones/{zoneId}/accessPoints", get(access_points)),
        ("/queries/zones/{zoneId}/accessPoints/{accessPointId}", get(access_point)),
    ];
    let lists: [(&'static str, MethodRouter<Service>); 4] = [
        ("/subscriptions/area", get(|service, base, given| links(List::Area, service, base, given))),
        ("/subscriptions/distance", get(|service, base, given| links(List::Distance, service, base, given))),
        ("/subscriptions/users", get(|service, base, given| links(List::Users, service, base, given))),
        ("/subscriptions/zones", get(|service, base, given| links(List::Zones, service, base, given))),
    ];
    cotorra_mec::router(service, queries.into_iter().chain(lists))
}

/// Answers with an object that has a value as its only attribute.
fn wrapped(name: &str, value: &impl Serialize) -> Response {
    let value = serde_json::to_value(value).expect("these types hold only what JSON can");
    json(&Value::Object(Map::from_iter([(name.to_owned(), value)])))
}

/// Sorts parameters into lists by these names.
fn lists<const N: usize>(
    names: [&str; N],
    parameters: Vec<(String, String)>,
) -> Result<[Vec<String>; N], Problem> {
    let mut lists = [const { Vec::new() }; N];
    for (name, value) in parameters {
        let Some(place) = names.iter().position(|known| *known == name) else {
            let there = if N == 0 { "none".to_owned() } else { names.join(", ") };
            return Err(Problem::bad_request(format!("there is no parameter `{name}`; there are {there}")));
        };
        lists[place].push(value);
    }
    Ok(lists)
}

/// Returns the only value of a parameter.
fn single(name: &str, values: Vec<String>) -> Result<Option<String>, Problem> {
    match values.len() {
        0 | 1 => Ok(values.into_iter().next()),
        _ => Err(Problem::bad_request(format!("`{name}` is given twice"))),
    }
}

async fn zones(State(service): State<Service>, Base(base): Base, Parameters(given): Parameters) -> Answer {
    let [zones] = lists(["zoneId"], given)?;
    Ok(wrapped("zoneList", &service.with(|location| location.zones(&base, &zones))))
}

async fn zone(
    State(service): State<Service>,
    Base(base): Base,
    Id(zone): Id,
    Parameters(given): Parameters,
) -> Answer {
    let [] = lists([], given)?;
    Ok(wrapped("zoneInfo", &service.with(|location| location.zone(&base, &zone))?))
}

async fn access_points(
    State(service): State<Service>,
    Base(base): Base,
    Id(zone): Id,
    Parameters(given): Parameters,
) -> Answer {
    let [ids] = lists(["accessPointId"], given)?;
    let list = service.with(|location| location.access_points(&base, &zone, &ids))?;
    Ok(wrapped("accessPointList", &list))
}

async fn access_point(
    State(service): State<Service>,
    Base(base): Base,
    Path((zone, id)): Path<(String, String)>,
    Parameters(given): Parameters,
) -> Answer {
    let [] = lists([], given)?;
    let info = service.with(|location| location.access_point(&base, &zone, &id))?;
    Ok(wrapped("accessPointInfo", &info))
}

async fn users(State(service): State<Service>, Base(base): Base, Parameters(given): Parameters) -> Answer {
    let [zones, access_points, addresses] = lists(["zoneId", "accessPointId", "address"], given)?;
    let query = UserQuery { zones, access_points, addresses };
    Ok(wrapped("userList", &service.with(|location| location.users(&base, &query))))
}

async fn distance(State(service): State<Service>, Parameters(given): Parameters) -> Answer {
    let [addresses, latitude, longitude] = lists(["address", "latitude", "longitude"], given)?;
    let degrees = |name: &str, values: Vec<String>, most: f64| -> Result<Option<f64>, Problem> {
        let Some(text) = single(name, values)? else { return Ok(None) };
        let number = text.parse().ok().filter(|number| (-most..=most).contains(number));
        let invalid = || Problem::bad_request(format!("`{name}` must be a number from -{most} to {most}"));
        Ok(Some(number.ok_or_else(invalid)?))
    };
    let place = (degrees("latitude", latitude, 90.0)?, degrees("longitude", longitude, 180.0)?);
    let query = match (&addresses[..], place) {
        ([from, to], (None, None)) => DistanceQuery { from: from.clone(), to: End::User(to.clone()) },
        ([from], (Some(latitude), Some(longitude))) => {
            DistanceQuery { from: from.clone(), to: End::Place(Point { latitude, longitude }) }
        }
        _ => {
            let detail = "a distance is between two addresses, or an address and a latitude and longitude";
            return Err(Problem::bad_request(detail));
        }
    };
    Ok(wrapped("terminalDistance", &service.with(|location| location.distance(&query))?))
}

async fn links(
    list: List,
    State(service): State<Service>,
    Base(base): Base,
    Parameters(given): Parameters,
) -> Answer {
    let subject = match list {
        List::Users => "address",
        List::Zones => "zoneId",
        List::Area | List::Distance => "",
    };
    let [types, subjects] = match subject {
        "" => {
            let [types] = lists(["subscription_type"], given)?;
            [types, Vec::new()]
        }
        subject => lists(["subscription_type", subject], given)?,
    };
    let wanted_type = single("subscription_type", types)?;
    let wanted_subject = single(subject, subjects)?;
    let known: &[(&str, &str)] = match list {
        List::Users => {
            &[("event", "UserLocationEventSubscription"), ("periodic", "UserLocationPeriodicSubscription")]
        }
        List::Zones => &[("event", "ZoneLocationEventSubscription"), ("status", "ZoneStatusSubscription")],
        List::Area => &[("event", "UserAreaSubscription")],
        List::Distance => &[("event", "UserDistanceSubscription")],
    };
    let type_name = match &wanted_type {
        None => None,
        Some(name) => match known.iter().find(|(known, _)| known == name) {
            Some((_, type_name)) => Some(*type_name),
            None => {
                let names: Vec<_> = known.iter().map(|(name, _)| *name).collect();
                return Err(Problem::bad_request(format!("subscription_type is {}", names.join(" or "))));
            }
        },
    };
    let is_wanted = |subscription: &Subscription| {
        let subject = match subscription {
            Subscription::UserLocationEventSubscription(s) => Some(&s.address),
            Subscription::UserLocationPeriodicSubscription(s) => Some(&s.address),
            Subscription::ZoneLocationEventSubscription(s) => Some(&s.zone_id),
            Subscription::ZoneStatusSubscription(s) => Some(&s.zone_id),
            _ => None,
        };
        type_name.is_none_or(|name| name == subscription.type_name())
            && (wanted_subject.is_none() || wanted_subject.as_ref() == subject)
    };
    let links = service.with(|location| location.links(&base, list, is_wanted));
    Ok(wrapped("notificationSubscriptionList", &links))
}
