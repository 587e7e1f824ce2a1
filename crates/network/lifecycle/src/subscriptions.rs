//! Subscriptions of ETSI GS MEC 010-2 v2.1.1 to changes of instances and operations, and the notifications of each.

use std::collections::BTreeMap;

use cotorra_graph::{DomainId, Timestamp};
use cotorra_mec::{Callback, Dispatch, Limiter, Outbox, Outcome, TimeStamp};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::{
    application::{Application, sees, share},
    descriptor::Descriptor,
    error::LifecycleError,
    operation::{Occurrence, Operation, OperationState, PROVIDER, State, VERSION, read},
};

/// The most subscriptions of the operator.
const MOST: usize = 256;
/// Longest request for a subscription, bytes.
const LONGEST: usize = 16 * 1024;

/// Kind of a subscription.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum SubscriptionType {
    /// To changes of instances' states.
    #[serde(rename = "AppInstanceStateChange")]
    Instances,
    /// To changes of operations' states.
    #[serde(rename = "AppLcmOpOccStateChange")]
    Operations,
}

/// A valid subscription: AppInstSubscriptionRequest (6.2.2.10) or AppLcmOpOccSubscriptionRequest (6.2.2.14).
#[derive(Debug, Clone)]
pub struct Subscription {
    request: Request,
    callback: Callback,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct Request {
    subscription_type: SubscriptionType,
    callback_uri: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    app_instance_state: Option<OneOrMore<State>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    app_instance_subscription_filter: Option<InstanceFilter>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    app_lcm_op_occ_subscription_filter: Option<OperationFilter>,
}

/// A value or a list. The standard's tables have lists where its OpenAPI document has one value.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(untagged)]
enum OneOrMore<T> {
    One(T),
    More(Vec<T>),
}

impl<T> OneOrMore<T> {
    fn all(&self) -> &[T] {
        match self {
            Self::One(one) => std::slice::from_ref(one),
            Self::More(all) => all,
        }
    }
}

/// Whether an optional list has a value. Without a list, all values match.
fn admits<T: PartialEq>(wanted: Option<&OneOrMore<T>>, value: &T) -> bool {
    wanted.is_none_or(|wanted| wanted.all().contains(value))
}

/// AppInstanceSubscriptionFilter.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct InstanceFilter {
    app_inst_selector_type: Selector,
    /// Identifiers, names or descriptors, as the selector says.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    app_instances: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    apps_from_providers: Vec<Provider>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
enum Selector {
    Void,
    AppIdentity,
    AppName,
    AppDId,
    AppFromProvider,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct Provider {
    app_provider: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    app_products: Option<OneOrMore<Product>>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct Product {
    app_name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    versions: Option<OneOrMore<Versions>>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct Versions {
    app_soft_version: String,
    #[serde(default, rename = "appDVersion", skip_serializing_if = "Vec::is_empty")]
    app_d_version: Vec<String>,
}

/// AppLcmOpOccSubscriptionFilter.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct OperationFilter {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    app_instance_subscription_filter: Option<InstanceFilter>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    notification_types: Option<OneOrMore<NotificationType>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    operation_states: Option<OneOrMore<OperationState>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    operation_types: Option<OneOrMore<Operation>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
enum NotificationType {
    AppLcmOperationOccurrenceNotification,
}

impl InstanceFilter {
    fn check(&self) -> Result<(), LifecycleError> {
        let (instances, providers) = (!self.app_instances.is_empty(), !self.apps_from_providers.is_empty());
        let wanted = match self.app_inst_selector_type {
            Selector::Void => (false, false),
            Selector::AppFromProvider => (false, true),
            Selector::AppIdentity | Selector::AppName | Selector::AppDId => (true, false),
        };
        if (instances, providers) == wanted {
            return Ok(());
        }
        let reason = "`appInstSelectorType` VOID takes no list, APP_FROM_PROVIDER takes `appsFromProviders`, and the others \
                      take `appInstances`";
        Err(LifecycleError::Invalid(reason.to_owned()))
    }

    fn wants(&self, instance: &Application, of: &Descriptor) -> bool {
        let lists = |text: &str| self.app_instances.iter().any(|listed| listed == text);
        match self.app_inst_selector_type {
            Selector::Void => true,
            Selector::AppIdentity => lists(&instance.id),
            Selector::AppName => lists(&of.name),
            Selector::AppDId => lists(&instance.descriptor),
            Selector::AppFromProvider => self.apps_from_providers.iter().any(|one| one.has(of)),
        }
    }
}

impl Provider {
    fn has(&self, of: &Descriptor) -> bool {
        let has_version = |one: &Versions| {
            let of_descriptor = &one.app_d_version;
            one.app_soft_version == VERSION
                && (of_descriptor.is_empty() || of_descriptor.iter().any(|version| version == VERSION))
        };
        let is_product = |product: &Product| {
            let versions = product.versions.as_ref();
            product.app_name == of.name && versions.is_none_or(|all| all.all().iter().any(has_version))
        };
        let products = self.app_products.as_ref();
        self.app_provider == PROVIDER && products.is_none_or(|all| all.all().iter().any(is_product))
    }
}

impl Subscription {
    /// Reads a request.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn read(body: &[u8]) -> Result<Self, LifecycleError> {
        if body.len() > LONGEST {
            let reason = format!("a subscription has at most {LONGEST} bytes");
            return Err(LifecycleError::Invalid(reason));
        }
        let request: Request = read(body)?;
        let of_operations = request.app_lcm_op_occ_subscription_filter.as_ref();
        let of_instances = request.app_instance_subscription_filter.as_ref();
        let reason = match request.subscription_type {
            SubscriptionType::Instances => {
                of_operations.map(|_| "`appLcmOpOccSubscriptionFilter` is for AppLcmOpOccStateChange only")
            }
            SubscriptionType::Operations => (of_instances.is_some() || request.app_instance_state.is_some())
                .then_some(
                    "filters of AppLcmOpOccStateChange are in `appLcmOpOccSubscriptionFilter`, and instances have no state \
                     there",
                ),
        };
        if let Some(reason) = reason {
            return Err(LifecycleError::Invalid(reason.to_owned()));
        }
        let inner = of_operations.and_then(|filter| filter.app_instance_subscription_filter.as_ref());
        of_instances.or(inner).map_or(Ok(()), InstanceFilter::check)?;
        let callback = Callback::read(&request.callback_uri)?;
        Ok(Self { request, callback })
    }

    /// Returns its kind.
    pub fn kind(&self) -> SubscriptionType {
        self.request.subscription_type
    }

    /// Returns the URI for its notifications.
    pub fn callback(&self) -> &Callback {
        &self.callback
    }

    fn wants_instance(&self, instance: &Application, of: &Descriptor) -> bool {
        let filter = self.request.app_instance_subscription_filter.as_ref();
        self.kind() == SubscriptionType::Instances
            && admits(self.request.app_instance_state.as_ref(), &State::of(instance))
            && filter.is_none_or(|filter| filter.wants(instance, of))
    }

    fn wants_operation(&self, occurrence: &Occurrence, instance: &Application, of: &Descriptor) -> bool {
        let is_wanted = |filter: &OperationFilter| {
            let kind = NotificationType::AppLcmOperationOccurrenceNotification;
            let instances = filter.app_instance_subscription_filter.as_ref();
            admits(filter.notification_types.as_ref(), &kind)
                && admits(filter.operation_states.as_ref(), &occurrence.state)
                && admits(filter.operation_types.as_ref(), &occurrence.operation)
                && instances.is_none_or(|filter| filter.wants(instance, of))
        };
        let filter = self.request.app_lcm_op_occ_subscription_filter.as_ref();
        self.kind() == SubscriptionType::Operations && filter.is_none_or(is_wanted)
    }

    /// Returns AppInstSubscriptionInfo (6.2.2.12) or AppLcmOpOccSubscriptionInfo (6.2.2.16).
    fn document(&self, id: u64, base: &str) -> Value {
        let mut document = serde_json::to_value(&self.request).expect("a request holds only what JSON can");
        document["id"] = id.to_string().into();
        document["_links"] = json!({ "self": { "href": href(base, id) } });
        if self.kind() == SubscriptionType::Instances {
            document["notificationType"] = match &self.request.app_instance_state {
                Some(states) => json!(states),
                None => json!(State::ALL),
            };
        }
        document
    }
}

fn href(base: &str, id: u64) -> String {
    format!("{base}/subscriptions/{id}")
}

/// The receiver of a notification.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipient {
    /// Its URI.
    pub callback: Callback,
    /// The domain that subscribed; `None` for the operator.
    pub owner: Option<DomainId>,
}

#[derive(Debug)]
struct Held {
    owner: Option<DomainId>,
    subscription: Subscription,
    /// URI by which the subscriber sees the service.
    base: String,
    outbox: Outbox,
}

/// The subscriptions of all callers. Each sees its own, and the operator sees all.
#[derive(Debug, Default)]
pub struct Subscriptions {
    held: BTreeMap<u64, Held>,
    limiters: BTreeMap<Option<DomainId>, Limiter>,
    /// The last number of a subscription, a notification or an attempt.
    numbers: u64,
    complaints: Vec<String>,
}

impl Subscriptions {
    fn admit(&mut self, viewer: Option<&DomainId>, now: Timestamp) -> Result<(), LifecycleError> {
        Ok(self.limiters.entry(viewer.cloned()).or_default().admit(now)?)
    }

    /// Adds a subscription. `base` is the URI under which the caller sees the service. Returns its address and its document.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn add(
        &mut self,
        viewer: Option<&DomainId>,
        base: &str,
        subscription: Subscription,
        now: Timestamp,
    ) -> Result<(String, Value), LifecycleError> {
        self.admit(viewer, now)?;
        let own = self.held.values().filter(|held| held.owner.as_ref() == viewer).count();
        if own >= share(viewer, MOST) {
            let reason = format!("there are {own} of your subscriptions: delete some first");
            return Err(LifecycleError::Full(reason));
        }
        self.numbers += 1;
        let document = subscription.document(self.numbers, base);
        let (owner, base, outbox) = (viewer.cloned(), base.to_owned(), Outbox::new(true));
        let address = href(&base, self.numbers);
        self.held.insert(self.numbers, Held { owner, subscription, base, outbox });
        Ok((address, document))
    }

    fn find(&self, viewer: Option<&DomainId>, id: &str) -> Result<(u64, &Held), LifecycleError> {
        let found = id.parse().ok().and_then(|number| Some((number, self.held.get(&number)?)));
        found
            .filter(|(_, held)| sees(viewer, held.owner.as_ref()))
            .ok_or_else(|| LifecycleError::Unknown("subscription", id.to_owned()))
    }

    /// Returns the document of a subscription.
    ///
    /// # Errors
    /// [`LifecycleError::Unknown`].
    pub fn document(&self, viewer: Option<&DomainId>, base: &str, id: &str) -> Result<Value, LifecycleError> {
        self.find(viewer, id).map(|(number, held)| held.subscription.document(number, base))
    }

    /// Returns links to all subscriptions, or to those of one kind (SubscriptionLinkList, 6.2.3.3).
    pub fn list(&self, viewer: Option<&DomainId>, base: &str, kind: Option<SubscriptionType>) -> Value {
        let is_listed = |held: &Held| {
            sees(viewer, held.owner.as_ref()) && kind.is_none_or(|kind| held.subscription.kind() == kind)
        };
        let listed = self.held.iter().filter(|(_, held)| is_listed(held));
        let link = |(id, held): (&u64, &Held)| json!({ "href": href(base, *id), "subscriptionType": held.subscription.kind() });
        let links: Vec<_> = listed.map(link).collect();
        json!({ "_links": {
            "self": { "href": format!("{base}/subscriptions") }, "subscriptions": links,
        } })
    }

    /// Removes a subscription. Waiting notifications are not sent.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn remove(
        &mut self,
        viewer: Option<&DomainId>,
        id: &str,
        now: Timestamp,
    ) -> Result<(), LifecycleError> {
        self.admit(viewer, now)?;
        let (number, _) = self.find(viewer, id)?;
        self.held.remove(&number);
        Ok(())
    }

    /// Queues notifications of an instance's new state.
    pub(crate) fn tell_instance(&mut self, instance: &Application, of: &Descriptor, now: TimeStamp) {
        let notification = json!({
            "notificationType": State::of(instance), "appInstanceId": instance.id,
            "appDId": instance.descriptor, "appPkgId": instance.descriptor, "_links": {},
        });
        self.tell(instance, notification, &[], now, |subscription| subscription.wants_instance(instance, of));
    }

    /// Queues notifications of an operation's new state.
    pub(crate) fn tell_operation(
        &mut self,
        number: u64,
        occurrence: &Occurrence,
        instance: &Application,
        of: &Descriptor,
        now: TimeStamp,
    ) {
        let notification = json!({
            "notificationType": occurrence.state, "appLcmOpOccId": number.to_string(),
            "appInstanceId": instance.id, "_links": {},
        });
        let links = [
            ("appInstance", format!("app_instances/{}", instance.id)),
            ("appLcmOpOcc", format!("app_lcm_op_occs/{number}")),
        ];
        let wants = |subscription: &Subscription| subscription.wants_operation(occurrence, instance, of);
        self.tell(instance, notification, &links, now, wants);
    }

    /// Queues a notification for those who want it and see the instance. `links` are paths below the service.
    fn tell(
        &mut self,
        instance: &Application,
        mut notification: Value,
        links: &[(&str, String)],
        now: TimeStamp,
        wants: impl Fn(&Subscription) -> bool,
    ) {
        // A change has the same identifier for all subscribers.
        self.numbers += 1;
        notification["id"] = self.numbers.to_string().into();
        notification["timeStamp"] = json!(now);
        let sees = |held: &Held| sees(held.owner.as_ref(), instance.owner.as_ref());
        for (id, held) in self.held.iter_mut().filter(|(_, held)| sees(held) && wants(&held.subscription)) {
            notification["subscriptionId"] = id.to_string().into();
            notification["_links"]["subscription"] = json!({ "href": href(&held.base, *id) });
            for (name, path) in links {
                notification["_links"][name] = json!({ "href": format!("{}/{path}", held.base) });
            }
            let complaint = held.outbox.push(notification.to_string().into());
            self.complaints.extend(complaint.map(|what| about(&held.base, *id, &what)));
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }

    /// Returns the notifications to send now. Call [`Self::done`] with the outcome of each.
    pub fn poll(&mut self, now: Timestamp) -> Vec<Dispatch<Recipient>> {
        let mut dispatches = Vec::new();
        for (id, held) in &mut self.held {
            if let Some(body) = held.outbox.poll(now, self.numbers + 1) {
                self.numbers += 1;
                let (callback, owner) = (held.subscription.callback.clone(), held.owner.clone());
                let target = Recipient { callback, owner };
                dispatches.push(Dispatch { subscription: *id, attempt: self.numbers, target, body });
            }
        }
        dispatches
    }

    /// Returns when the next notification is due.
    pub fn deadline(&self) -> Option<Timestamp> {
        self.held.values().filter_map(|held| held.outbox.deadline()).min()
    }

    /// Records the outcome of an attempt to send a notification.
    pub fn done(&mut self, subscription: u64, attempt: u64, outcome: Outcome, now: Timestamp) {
        let Some(held) = self.held.get_mut(&subscription) else { return };
        let complaint = held.outbox.done(now, attempt, outcome);
        self.complaints.extend(complaint.map(|what| about(&held.base, subscription, &what)));
    }

    /// Returns the complaints to the operator since the last call: dropped notifications and their reasons.
    pub fn take_complaints(&mut self) -> Vec<String> {
        std::mem::take(&mut self.complaints)
    }
}

fn about(base: &str, id: u64, what: &str) -> String {
    format!("MEC 010-2, {}: {what}", href(base, id))
}
