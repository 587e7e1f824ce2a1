//! Paths and lists of subscriptions that belong to an application.

use cotorra_mec::{Subscribed, Subscriptions};
use serde_json::{Value, json};

/// Path of an application's subscriptions.
pub(crate) const SUBSCRIPTIONS: &str = "applications/{appInstanceId}/subscriptions";

/// Returns the path of the subscriptions of an application.
pub(crate) fn subscriptions_of(application: &str) -> String {
    SUBSCRIPTIONS.replace("{appInstanceId}", application)
}

/// Returns links to the subscriptions of a list, under the name that the standard gives them.
pub(crate) fn links<S: Subscribed>(
    subscriptions: &Subscriptions<S>,
    base: &str,
    list: &str,
    name: &str,
    wanted: impl Fn(&S) -> bool,
) -> Value {
    let of_list = subscriptions.all(base).filter(|(one, _)| one.list() == list && wanted(one));
    let all: Vec<_> =
        of_list.map(|(one, href)| json!({ "href": href, "subscriptionType": one.type_name() })).collect();
    json!({ "_links": { "self": { "href": format!("{base}/{list}") }, name: all } })
}

/// Returns the base URI of a service, given the URI of one of its subscriptions.
pub(crate) fn base_of<'a>(href: &'a str, list: &str) -> &'a str {
    href.split_once(&format!("/{list}/")).map_or(href, |(base, _)| base)
}
