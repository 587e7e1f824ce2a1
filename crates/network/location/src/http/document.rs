//! The OpenAPI document is derived from the types, and compared with the one that is checked in.

use utoipa::OpenApi as _;

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "cotorra's Location API",
        description = "ETSI GS MEC 013 v3.1.1, as far as a testbed can give it. Where a token is set, every request but \
            this document's needs it as `Authorization: Bearer`. Beside this, a domain's own service is under \
            `/domains/{name}/location/v2`.",
        license(name = "MIT OR Apache-2.0"),
        version = "3.1.1"
    ),
    servers((url = "/location/v2")),
    paths(
        queries::distance,
        queries::users,
        queries::zones,
        queries::zone,
        queries::access_points,
        queries::access_point,
        users::subscriptions,
        users::subscribe,
        users::subscription,
        users::resubscribe,
        users::unsubscribe,
        zones::subscriptions,
        zones::subscribe,
        zones::subscription,
        zones::resubscribe,
        zones::unsubscribe,
        area::subscriptions,
        area::subscribe,
        area::subscription,
        area::resubscribe,
        area::unsubscribe,
        distance::subscriptions,
        distance::subscribe,
        distance::subscription,
        distance::resubscribe,
        distance::unsubscribe
    ),
    components(schemas(cotorra_mec::ProblemDetails))
)]
struct Document;

/// Answers, which are objects with one attribute.
mod answers {
    #![allow(dead_code, reason = "only their descriptions are used")]

    use crate::types;

    #[derive(utoipa::ToSchema)]
    #[schema(rename_all = "camelCase")]
    pub(super) struct ZoneListAnswer {
        zone_list: types::ZoneList,
    }

    #[derive(utoipa::ToSchema)]
    #[schema(rename_all = "camelCase")]
    pub(super) struct ZoneInfoAnswer {
        zone_info: types::ZoneInfo,
    }

    #[derive(utoipa::ToSchema)]
    #[schema(rename_all = "camelCase")]
    pub(super) struct AccessPointListAnswer {
        access_point_list: types::AccessPointList,
    }

    #[derive(utoipa::ToSchema)]
    #[schema(rename_all = "camelCase")]
    pub(super) struct AccessPointInfoAnswer {
        access_point_info: types::AccessPointInfo,
    }

    #[derive(utoipa::ToSchema)]
    #[schema(rename_all = "camelCase")]
    pub(super) struct UserListAnswer {
        user_list: types::UserList,
    }

    #[derive(utoipa::ToSchema)]
    #[schema(rename_all = "camelCase")]
    pub(super) struct TerminalDistanceAnswer {
        terminal_distance: types::TerminalDistance,
    }

    #[derive(utoipa::ToSchema)]
    #[schema(rename_all = "camelCase")]
    pub(super) struct SubscriptionListAnswer {
        notification_subscription_list: types::NotificationSubscriptionList,
    }
}

/// Queries (ETSI GS MEC 013 v3.1.1, clauses 7.3 to 7.8).
#[allow(dead_code, reason = "only their descriptions are used")]
mod queries {
    use cotorra_mec::RequestProblems;

    use super::answers::{
        AccessPointInfoAnswer, AccessPointListAnswer, TerminalDistanceAnswer, UserListAnswer, ZoneInfoAnswer,
        ZoneListAnswer,
    };

    /// Distance of a user from another, or from a place.
    #[utoipa::path(get, path = "/queries/distance", tag = "queries",
        params(("address" = Vec<String>, Query, description = "two users, or one with a place"),
            ("latitude" = Option<f64>, Query), ("longitude" = Option<f64>, Query)),
        responses((status = 200, description = "the distance", body = TerminalDistanceAnswer), RequestProblems))]
    pub(super) async fn distance() {}

    /// Users and their locations.
    #[utoipa::path(get, path = "/queries/users", tag = "queries",
        params(("zoneId" = Option<Vec<String>>, Query), ("accessPointId" = Option<Vec<String>>, Query),
            ("address" = Option<Vec<String>>, Query)),
        responses((status = 200, description = "users", body = UserListAnswer), RequestProblems))]
    pub(super) async fn users() {}

    /// Zones.
    #[utoipa::path(get, path = "/queries/zones", tag = "queries",
        params(("zoneId" = Option<Vec<String>>, Query)),
        responses((status = 200, description = "zones", body = ZoneListAnswer), RequestProblems))]
    pub(super) async fn zones() {}

    /// A zone.
    #[utoipa::path(get, path = "/queries/zones/{zoneId}", tag = "queries",
        params(("zoneId" = String, Path)),
        responses((status = 200, description = "the zone", body = ZoneInfoAnswer), RequestProblems))]
    pub(super) async fn zone() {}

    /// Access points of a zone.
    #[utoipa::path(get, path = "/queries/zones/{zoneId}/accessPoints", tag = "queries",
        params(("zoneId" = String, Path), ("accessPointId" = Option<Vec<String>>, Query)),
        responses((status = 200, description = "access points", body = AccessPointListAnswer), RequestProblems))]
    pub(super) async fn access_points() {}

    /// An access point.
    #[utoipa::path(get, path = "/queries/zones/{zoneId}/accessPoints/{accessPointId}", tag = "queries",
        params(("zoneId" = String, Path), ("accessPointId" = String, Path)),
        responses((status = 200, description = "the access point", body = AccessPointInfoAnswer), RequestProblems))]
    pub(super) async fn access_point() {}
}

/// Describes the resources of a list of subscriptions.
macro_rules! list {
    ($name:ident, $list:literal, $one:literal $(, $parameter:literal)*) => {
        #[allow(dead_code, reason = "only their descriptions are used")]
        mod $name {
            use cotorra_mec::{ChangeProblems, RequestProblems};

            use super::answers::SubscriptionListAnswer;
            use crate::requests::Subscription;

            /// Links to subscriptions.
            #[utoipa::path(get, path = $list, tag = "subscriptions",
                params($(($parameter = Option<String>, Query)),*),
                responses((status = 200, description = "links", body = SubscriptionListAnswer), RequestProblems))]
            pub(super) async fn subscriptions() {}

            /// Subscribe to notifications.
            #[utoipa::path(post, path = $list, tag = "subscriptions",
                request_body = Subscription,
                responses((status = 201, description = "the subscription", body = Subscription, headers(("Location" = String), ("ETag" = String))),
                    RequestProblems, ChangeProblems))]
            pub(super) async fn subscribe() {}

            /// A subscription.
            #[utoipa::path(get, path = $one, tag = "subscriptions",
                params(("subscriptionId" = String, Path), ("If-None-Match" = Option<String>, Header)),
                responses((status = 200, description = "the subscription", body = Subscription, headers(("ETag" = String))),
                    (status = 304, description = "as known already"), RequestProblems))]
            pub(super) async fn subscription() {}

            /// Replace a subscription by another of its type.
            #[utoipa::path(put, path = $one, tag = "subscriptions",
                request_body = Subscription,
                params(("subscriptionId" = String, Path), ("If-Match" = Option<String>, Header)),
                responses((status = 200, description = "the subscription", body = Subscription, headers(("ETag" = String))),
                    RequestProblems, ChangeProblems))]
            pub(super) async fn resubscribe() {}

            /// End a subscription.
            #[utoipa::path(delete, path = $one, tag = "subscriptions",
                params(("subscriptionId" = String, Path), ("If-Match" = Option<String>, Header)),
                responses((status = 204, description = "it has ended"), RequestProblems, ChangeProblems))]
            pub(super) async fn unsubscribe() {}
        }
    };
}

list!(users, "/subscriptions/users", "/subscriptions/users/{subscriptionId}", "subscription_type", "address");
list!(zones, "/subscriptions/zones", "/subscriptions/zones/{subscriptionId}", "subscription_type", "zoneId");
list!(area, "/subscriptions/area", "/subscriptions/area/{subscriptionId}", "subscription_type");
list!(distance, "/subscriptions/distance", "/subscriptions/distance/{subscriptionId}", "subscription_type");

#[test]
fn the_document_is_the_one_that_is_checked_in() {
    let document = Document::openapi();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/location.openapi.json");
    utoipa::documents::compare(&document, file.as_ref());
}
