//! The resources of the service (ETSI GS MEC 028 v2.3.1, clause 7).

use axum::{
    extract::State,
    http::{HeaderMap, StatusCode},
    response::{IntoResponse, Response},
};
use cotorra_mec::{
    Base, Id, Json, Parameters, Problem, Query, changed, created, if_match, json, shown, tagged,
};

use super::Service;
use crate::{requests::MeasurementConfig, view::Kind};

type Answer = Result<Response, Problem>;

/// Filters and selectors of a query (ETSI GS MEC 009, 6.18 and 6.19).
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "used by the OpenAPI document")]
struct Selecting {
    /// Expressions `(op,attribute/attribute,value)` separated by `;`, all of which must hold. `op` is one of eq, neq,
    /// gt, lt, gte, lte, in, nin, cont, ncont.
    #[param(example = "(eq,channel,6);(gt,bssLoad/staCount,0)")]
    filter: Option<String>,
    /// All attributes; the default.
    all_fields: Option<String>,
    /// Only these structures and arrays, separated by commas, beside simple and required attributes.
    fields: Option<String>,
    /// All but these structures and arrays, separated by commas.
    exclude_fields: Option<String>,
    /// All attributes: the standard excludes none by default.
    exclude_default: Option<String>,
}

fn query(of: Kind, service: &Service, headers: &HeaderMap, parameters: &[(String, String)]) -> Answer {
    let query = Query::read(of.attributes(), parameters)?;
    let answer = service.with(|wais| wais.query(of, &query));
    Ok(tagged(headers, answer.etag, answer.body))
}

/// Access points and their state.
#[utoipa::path(get, path = "/queries/ap/ap_information", tag = "queries",
    params(Selecting, ("If-None-Match" = Option<String>, Header)),
    responses((status = 200, description = "access points", body = Vec<crate::types::ApInfo>), (status = 304, description = "as known already"), cotorra_mec::RequestProblems))]
pub(super) async fn ap_information(
    State(service): State<Service>,
    headers: HeaderMap,
    Parameters(parameters): Parameters,
) -> Answer {
    query(Kind::AccessPoints, &service, &headers, &parameters)
}

/// Associated stations and their state.
#[utoipa::path(get, path = "/queries/sta/sta_information", tag = "queries",
    params(Selecting, ("If-None-Match" = Option<String>, Header)),
    responses((status = 200, description = "stations", body = Vec<crate::types::StaInfo>), (status = 304, description = "as known already"), cotorra_mec::RequestProblems))]
pub(super) async fn sta_information(
    State(service): State<Service>,
    headers: HeaderMap,
    Parameters(parameters): Parameters,
) -> Answer {
    query(Kind::Stations, &service, &headers, &parameters)
}

/// Subscription types by their names in `subscription_type`.
const SUBSCRIPTION_TYPES: [(&str, &str); 3] = [
    ("assoc_sta", "AssocStaSubscription"),
    ("sta_data_rate", "StaDataRateSubscription"),
    ("measure_report", "MeasurementReportSubscription"),
];

/// Links to subscriptions.
#[utoipa::path(get, path = "/subscriptions", tag = "subscriptions",
    params(("subscription_type" = Option<String>, Query, pattern = "^(assoc_sta|sta_data_rate|measure_report)$")),
    responses((status = 200, description = "links to subscriptions", body = crate::requests::SubscriptionLinkList), cotorra_mec::RequestProblems))]
pub(super) async fn subscriptions(
    State(service): State<Service>,
    Base(base): Base,
    Parameters(parameters): Parameters,
) -> Answer {
    let type_name = match &parameters[..] {
        [] => None,
        [(name, value)] if name == "subscription_type" => {
            let known = SUBSCRIPTION_TYPES.iter().find(|(name, _)| name == value);
            let unknown =
                || Problem::bad_request("subscription_type is assoc_sta, sta_data_rate or measure_report");
            Some(known.ok_or_else(unknown)?.1)
        }
        _ => return Err(Problem::bad_request("the only parameter is `subscription_type`, given once")),
    };
    let list = service.with(|wais| wais.subscription_links(&base, type_name));
    Ok(json(&list))
}

/// Links to measurement configurations.
#[utoipa::path(get, path = "/measurements", tag = "measurements",
    responses((status = 200, description = "links to measurement configurations", body = crate::requests::MeasurementConfigLinkList), cotorra_mec::RequestProblems))]
pub(super) async fn measurements(
    State(service): State<Service>,
    Base(base): Base,
    Parameters(parameters): Parameters,
) -> Answer {
    if !parameters.is_empty() {
        return Err(Problem::bad_request("there are no parameters"));
    }
    let list = service.with(|wais| wais.measurements(&base));
    Ok(json(&list))
}

/// Configure a measurement. Its reports are included in station information from then on.
#[utoipa::path(post, path = "/measurements", tag = "measurements",
    request_body = MeasurementConfig,
    responses((status = 201, description = "the configuration", body = MeasurementConfig, headers(("Location" = String), ("ETag" = String))),
        cotorra_mec::RequestProblems, cotorra_mec::ChangeProblems))]
pub(super) async fn configure(State(service): State<Service>, Base(base): Base, Json(body): Json) -> Answer {
    let config = MeasurementConfig::read(&body)?;
    let now = service.now();
    Ok(created(&service.with(|wais| wais.configure(now, &base, config))?))
}

/// A measurement configuration.
#[utoipa::path(get, path = "/measurements/{measurementConfigId}", tag = "measurements",
    params(("measurementConfigId" = String, Path), ("If-None-Match" = Option<String>, Header)),
    responses((status = 200, description = "the configuration", body = MeasurementConfig, headers(("ETag" = String))),
        (status = 304, description = "as known already"), cotorra_mec::RequestProblems))]
pub(super) async fn measurement(
    State(service): State<Service>,
    Base(base): Base,
    Id(id): Id,
    headers: HeaderMap,
) -> Answer {
    Ok(shown(&headers, &service.with(|wais| wais.measurement(&base, &id))?))
}

/// Replace a measurement configuration.
#[utoipa::path(put, path = "/measurements/{measurementConfigId}", tag = "measurements",
    request_body = MeasurementConfig,
    params(("measurementConfigId" = String, Path), ("If-Match" = Option<String>, Header)),
    responses((status = 200, description = "the configuration", body = MeasurementConfig, headers(("ETag" = String))), cotorra_mec::RequestProblems, cotorra_mec::ChangeProblems))]
pub(super) async fn reconfigure(
    State(service): State<Service>,
    Base(base): Base,
    Id(id): Id,
    headers: HeaderMap,
    Json(body): Json,
) -> Answer {
    service.with(|wais| wais.measurement(&base, &id))?;
    let config = MeasurementConfig::read(&body)?;
    let now = service.now();
    let resource = service.with(|wais| wais.reconfigure(now, &base, &id, if_match(&headers), config))?;
    Ok(changed(&resource))
}

/// End a measurement.
#[utoipa::path(delete, path = "/measurements/{measurementConfigId}", tag = "measurements",
    params(("measurementConfigId" = String, Path), ("If-Match" = Option<String>, Header)),
    responses((status = 204, description = "it has ended"), cotorra_mec::RequestProblems, cotorra_mec::ChangeProblems))]
pub(super) async fn unconfigure(State(service): State<Service>, Id(id): Id, headers: HeaderMap) -> Answer {
    let now = service.now();
    service.with(|wais| wais.unconfigure(now, &id, if_match(&headers)))?;
    Ok(StatusCode::NO_CONTENT.into_response())
}
