//! Notifications (ETSI GS MEC 013 v3.1.1, clause 6.4): their contents, and when they are due.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use cotorra_graph::{NodeId, Position, Timestamp};
use serde_json::{Value, json};

use crate::{
    requests::{
        AreaInfo, DistanceCriteria, LocationEventType, Subscription, UserAreaSubscription,
        UserDistanceSubscription, UserLocationEventSubscription, UserLocationPeriodicSubscription,
        ZoneLocationEventSubscription, ZoneStatusSubscription,
    },
    survey::{Place, User, address},
    types::OperationStatus,
    view::{View, apart, position, status},
};

/// What a user is in: a zone, or an access point of one.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Inside {
    zone: String,
    access_point: NodeId,
    /// Whether each access point counts by itself.
    by_access_point: bool,
}

impl Inside {
    fn is_same(&self, other: &Self) -> bool {
        self.zone == other.zone && (!self.by_access_point || self.access_point == other.access_point)
    }
}

/// Conditions of a zone that are notified when they are newly met.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Condition {
    /// The standard's `userNumEvent`, of an access point or of the zone.
    Users(u8, Option<NodeId>),
    Status(NodeId, OperationStatus),
}

/// Schedule of a subscription's notifications.
#[derive(Debug)]
pub struct Schedule {
    /// Time of the next periodic report.
    next: Option<Timestamp>,
    /// Notifications so far.
    count: u32,
    /// Time of the last one.
    last: Option<Timestamp>,
    /// Whether the state at the beginning was seen. It is no event.
    began: bool,
    /// Where users were at the last poll.
    inside: BTreeMap<String, Inside>,
    /// Users that were in the area.
    in_area: BTreeSet<String>,
    /// Conditions that were met.
    met: BTreeSet<Condition>,
    /// Whether the criterion of distance was met.
    was_met: bool,
}

impl Schedule {
    pub(crate) fn new(now: Timestamp, subscription: &Subscription) -> Self {
        let next = match subscription {
            Subscription::UserLocationPeriodicSubscription(s) => Some(now + interval(s)),
            _ => None,
        };
        Self {
            next,
            count: 0,
            last: None,
            began: false,
            inside: BTreeMap::new(),
            in_area: BTreeSet::new(),
            met: BTreeSet::new(),
            was_met: false,
        }
    }

    /// Returns when a notification may be due even if nothing changes.
    pub(crate) fn deadline(&self) -> Option<Timestamp> {
        self.next
    }

    /// Returns the notifications that are due now. `href` is the subscription's URI.
    pub(crate) fn poll(
        &mut self,
        now: Timestamp,
        of: &Subscription,
        view: &View<'_>,
        href: &str,
    ) -> Vec<Value> {
        let mut due = match of {
            Subscription::UserLocationEventSubscription(s) => self.user_events(s, view),
            Subscription::UserLocationPeriodicSubscription(s) => self.periodic(now, s, view),
            Subscription::ZoneLocationEventSubscription(s) => self.zone_events(s, view),
            Subscription::ZoneStatusSubscription(s) => self.zone_status(s, view),
            Subscription::UserAreaSubscription(s) => self.area(s, view),
            Subscription::UserDistanceSubscription(s) => self.distance(s, view),
        };
        self.began = true;
        let bounds = of.reporting();
        let pause = bounds.minimum_interval.unwrap_or(0).max(bounds.maximum_frequency.unwrap_or(0));
        let pause = Duration::from_secs(pause.into());
        if self.last.is_some_and(|last| now < last + pause) {
            due.clear();
        }
        if let Some(most) = bounds.maximum_count.filter(|most| *most > 0) {
            due.truncate(most.saturating_sub(self.count) as usize);
        }
        if !due.is_empty() {
            self.count = self.count.saturating_add(u32::try_from(due.len()).unwrap_or(u32::MAX));
            self.last = Some(now);
        }
        for notification in &mut due {
            notification["notificationType"] = of.type_name().replace("Subscription", "Notification").into();
            notification["timeStamp"] = json!(view.epoch.at(view.survey.at));
            notification["_links"] = links(href);
        }
        due
    }

    fn user_events(&mut self, of: &UserLocationEventSubscription, view: &View<'_>) -> Vec<Value> {
        let para = of.user_event_para.as_ref();
        let zone = para.and_then(|para| para.zone_id.as_deref());
        let units = para.map(|para| para.access_point_list.as_slice()).unwrap_or_default();
        let with_location = para.and_then(|para| para.reporting_location_req) == Some(true);
        let events = self.moved(view, std::slice::from_ref(&of.address), !units.is_empty(), |user| {
            zone.is_none_or(|zone| zone == user.zone)
                && (units.is_empty() || units.iter().any(|unit| unit == user.access_point.as_str()))
        });
        let wanted = events.into_iter().filter(|(_, event, _)| wants(&of.location_event_criteria, *event));
        wanted
            .map(|(address, event, at)| {
                let mut notification = json!({
                    "address": address, "userLocationEvent": event,
                    "zoneId": at.zone, "accessPointId": at.access_point,
                });
                if with_location {
                    locate(&mut notification, view, view.survey.user(&address));
                }
                notification
            })
            .collect()
    }

    fn zone_events(&mut self, of: &ZoneLocationEventSubscription, view: &View<'_>) -> Vec<Value> {
        let everyone: Vec<_>;
        let addresses = if of.address_list.is_empty() {
            let gone = self.inside.keys().cloned();
            let all: BTreeSet<_> = view.survey.users.keys().map(address).chain(gone).collect();
            everyone = all.into_iter().collect();
            &everyone
        } else {
            &of.address_list
        };
        let events = self.moved(view, addresses, false, |user| user.zone == of.zone_id);
        let wanted = events.into_iter().filter(|(_, event, _)| wants(&of.location_event_criteria, *event));
        wanted
            .map(|(address, event, at)| {
                json!({ "address": address, "userLocationEvent": event, "zoneId": at.zone })
            })
            .collect()
    }

    /// Returns who left what and entered what, since the last poll.
    fn moved(
        &mut self,
        view: &View<'_>,
        addresses: &[String],
        by_access_point: bool,
        counts: impl Fn(&User) -> bool,
    ) -> Vec<(String, LocationEventType, Inside)> {
        let mut events = Vec::new();
        for address in addresses {
            let user = view.survey.user(address).filter(|user| counts(user));
            let now = user.map(|user| Inside {
                zone: user.zone.clone(),
                access_point: user.access_point.clone(),
                by_access_point,
            });
            let before = self.inside.remove(address);
            self.inside.extend(now.clone().map(|now| (address.clone(), now)));
            let is_same = matches!((&before, &now), (Some(before), Some(now)) if before.is_same(now));
            if is_same || !self.began {
                continue;
            }
            let left = before.map(|at| (address.clone(), LocationEventType::LeavingAreaEvent, at));
            let entered = now.map(|at| (address.clone(), LocationEventType::EnteringAreaEvent, at));
            events.extend(left.into_iter().chain(entered));
        }
        events
    }

    fn periodic(
        &mut self,
        now: Timestamp,
        of: &UserLocationPeriodicSubscription,
        view: &View<'_>,
    ) -> Vec<Value> {
        let Some(next) = self.next.filter(|next| *next <= now) else { return Vec::new() };
        let is_final = self.count + 1 >= of.periodic_event_info.reporting_amount;
        // Missed periods are skipped.
        let mut after = next;
        while after <= now {
            after = after + interval(of);
        }
        self.next = (!is_final).then_some(after);
        let user = view.survey.user(&of.address);
        let is_located = user.is_some_and(|user| user.place.is_some());
        let mut notification = json!({
            "address": of.address, "isFinalNotification": is_final,
            "result": if is_located { "SUCCESS" } else { "ABNORMAL" },
        });
        if let Some(user) = user {
            notification["zoneId"] = user.zone.clone().into();
            notification["accessPointId"] = user.access_point.to_string().into();
        }
        locate(&mut notification, view, user);
        vec![notification]
    }

    fn zone_status(&mut self, of: &ZoneStatusSubscription, view: &View<'_>) -> Vec<Value> {
        let mut met = BTreeSet::new();
        let over = |count: usize, most: Option<u32>| most.is_some_and(|most| count > most as usize);
        let under = |count: usize, least: Option<u32>| least.is_some_and(|least| count < least as usize);
        let of_zone = view.survey.users_in(&of.zone_id);
        if over(of_zone, of.upper_number_of_users_zone_threshold) {
            met.insert(Condition::Users(1, None));
        }
        if under(of_zone, of.lower_number_of_users_zone_threshold) {
            met.insert(Condition::Users(2, None));
        }
        for (id, _) in view.site.units(&of.zone_id) {
            let count = view.survey.users_at(id);
            if over(count, of.upper_number_of_users_ap_threshold) {
                met.insert(Condition::Users(3, Some(id.clone())));
            }
            if under(count, of.lower_number_of_users_ap_threshold) {
                met.insert(Condition::Users(4, Some(id.clone())));
            }
            let status = status(view.survey, id);
            if of.operation_status.contains(&status) {
                met.insert(Condition::Status(id.clone(), status));
            }
        }
        let news: Vec<_> = met.difference(&self.met).cloned().collect();
        self.met = met;
        if !self.began {
            return Vec::new();
        }
        let notification = |condition| match condition {
            Condition::Users(event, None) => json!({ "zoneId": of.zone_id, "userNumEvent": event }),
            Condition::Users(event, Some(id)) => {
                json!({ "zoneId": of.zone_id, "userNumEvent": event, "accessPointId": id })
            }
            Condition::Status(id, status) => {
                json!({ "zoneId": of.zone_id, "accessPointId": id, "operationStatus": status })
            }
        };
        news.into_iter().map(notification).collect()
    }

    fn area(&mut self, of: &UserAreaSubscription, view: &View<'_>) -> Vec<Value> {
        // The area was checked when it was subscribed to.
        let Ok(area) = Area::new(&of.area_define, view) else { return Vec::new() };
        let mut events = Vec::new();
        for address in &of.address_list {
            let user = view.survey.user(address);
            // A user of unknown location neither enters nor leaves.
            let Some(place) = user.and_then(|user| user.place) else { continue };
            let is_in = area.has(place.position);
            let was_in =
                if is_in { !self.in_area.insert(address.clone()) } else { self.in_area.remove(address) };
            let event = match (was_in, is_in) {
                (false, true) => LocationEventType::EnteringAreaEvent,
                (true, false) => LocationEventType::LeavingAreaEvent,
                _ => continue,
            };
            if !self.began || !wants(&of.location_event_criteria, event) {
                continue;
            }
            let mut notification = json!({ "address": address, "userLocationEvent": event });
            if of.reporting_location_req == Some(true) {
                locate(&mut notification, view, user);
            }
            events.push(notification);
        }
        events
    }

    fn distance(&mut self, of: &UserDistanceSubscription, view: &View<'_>) -> Vec<Value> {
        let place = |address: &String| view.survey.user(address).and_then(|user| user.place);
        let monitored: Vec<Option<Place>> = of.monitored_address.iter().map(place).collect();
        let references: Vec<Option<Place>> = of.reference_address.iter().map(place).collect();
        let mut distances = Vec::new();
        for (i, one) in monitored.iter().enumerate() {
            let others = if references.is_empty() { &monitored[i + 1..] } else { &references[..] };
            distances.extend(others.iter().map(|other| Some(apart(one.as_ref()?, other.as_ref()?))));
        }
        // An unknown distance meets nothing.
        let within = |d: &Option<f64>| d.is_some_and(|d| d <= of.distance);
        let beyond = |d: &Option<f64>| d.is_some_and(|d| d > of.distance);
        let is_met = match of.criteria {
            DistanceCriteria::AllWithinDistance => distances.iter().all(within),
            DistanceCriteria::AnyWithinDistance => distances.iter().any(within),
            DistanceCriteria::AllBeyondDistance => distances.iter().all(beyond),
            DistanceCriteria::AnyBeyondDistance => distances.iter().any(beyond),
        };
        let was_met = std::mem::replace(&mut self.was_met, is_met);
        if !is_met || was_met || (!self.began && !of.check_immediate) {
            return Vec::new();
        }
        let named = view.survey.users.iter().filter(|(id, _)| of.monitored_address.contains(&address(id)));
        vec![json!({ "distanceEvent": of.criteria, "monitoredUsers": view.list(named) })]
    }
}

/// An area on the map.
pub(crate) enum Area {
    Circle(Position, f64),
    Polygon(Vec<Position>),
}

impl Area {
    /// Converts an area on Earth.
    pub(crate) fn new(area: &AreaInfo, view: &View<'_>) -> Result<Self, cotorra_mec::InvalidRequest> {
        let points = area.points.iter().map(|point| position(view.site, *point));
        let points = points.collect::<Result<Vec<_>, _>>()?;
        Ok(match (points.as_slice(), area.radius) {
            ([centre], Some(radius)) => Self::Circle(*centre, radius.into()),
            _ => Self::Polygon(points),
        })
    }

    /// Whether a place is in the area, at any height.
    pub(crate) fn has(&self, place: Position) -> bool {
        match self {
            Self::Circle(centre, radius) => (place.x - centre.x).hypot(place.y - centre.y) <= *radius,
            // A ray to the east crosses an odd number of sides.
            Self::Polygon(corners) => {
                let next = corners.iter().cycle().skip(1);
                let crossed = corners.iter().zip(next).filter(|(a, b)| {
                    (a.y > place.y) != (b.y > place.y)
                        && place.x < a.x + (place.y - a.y) / (b.y - a.y) * (b.x - a.x)
                });
                crossed.count() % 2 == 1
            }
        }
    }
}

fn wants(criteria: &[LocationEventType], event: LocationEventType) -> bool {
    criteria.is_empty() || criteria.contains(&event)
}

fn interval(of: &UserLocationPeriodicSubscription) -> Duration {
    Duration::from_secs(of.periodic_event_info.reporting_interval.into())
}

/// Adds a user's location to a notification.
fn locate(notification: &mut Value, view: &View<'_>, user: Option<&User>) {
    let Some(place) = user.and_then(|user| user.place) else { return };
    let whereabouts = view.site.whereabouts(&place);
    if let Some(location) = whereabouts.location_info {
        notification["locationInfo"] = json!(location);
    }
    if let Some(relative) = whereabouts.relative_location_info {
        notification["relativeLocationInfo"] = json!(relative);
    }
}

/// Returns the links of a notification. The text of the standard has the subscription, its OpenAPI document `self`.
pub(crate) fn links(href: &str) -> Value {
    json!({ "self": { "href": href }, "subscription": { "href": href } })
}
