//! Links over interfaces of this machine. NetEm works on the interface itself, for the packets of any program. The fabric
//! keeps the state of these links as of all others, but carries none of their packets.

use std::collections::{BTreeMap, HashMap};

use cotorra_fabric::Fabric;
use cotorra_graph::{
    Conditions, Direction, HardwareGraph, Lateness, LinkContext, LinkId, Medium, Probing, Reached, RealLink,
    Timestamp,
};
use cotorra_netem::{ConditionsError, Confirmed, Hold, HoldError, Netem, Network, Plan, Rule, Side};
use parking_lot::{Mutex, MutexGuard};

use crate::{
    reflectors::{LinkProbes, ReflectorError},
    traffic::{Traffic, TrafficCounters},
};

/// Error of a link over an interface of this machine. Nothing has changed then.
#[derive(Debug, thiserror::Error)]
pub enum RealLinkError {
    /// NetEm cannot emulate a condition.
    #[error("link `{link}`: {reason}")]
    Setting {
        link: LinkId,
        /// The condition that NetEm cannot emulate.
        reason: ConditionsError,
    },
    /// A reflector cannot be probed.
    #[error(transparent)]
    Reflector(#[from] ReflectorError),
    /// An interface or the kernel fails.
    #[error(transparent)]
    Hold(#[from] HoldError),
}

/// The links of a testbed over interfaces of this machine, which it holds. Dropping it restores the interfaces.
pub(crate) struct RealLinks {
    links: HashMap<LinkId, Place>,
    hold: Mutex<Hold>,
    traffic: Traffic,
    /// Whether all links of the testbed are such links.
    alone: bool,
    /// `None` if the testbed is not probed.
    probes: Option<LinkProbes>,
}

/// The place of a link in the real network.
struct Place {
    reached: Reached,
    leaving: Direction,
    medium: Medium,
}

impl Place {
    fn of(real: RealLink<'_>) -> Self {
        Self { reached: real.reached.clone(), leaving: real.leaving, medium: real.link.medium() }
    }

    /// Returns 0 for the direction that leaves this machine, and 1 for the way back.
    fn way(&self, direction: Direction) -> usize {
        usize::from(direction != self.leaving)
    }

    /// Reorders values of the forward and the backward direction into there and back.
    fn there_and_back<T>(&self, mut directions: [T; 2]) -> [T; 2] {
        directions.rotate_left(self.way(Direction::Forward));
        directions
    }

    /// Selects the packets of the interface that cross the link in a direction.
    fn packets(&self, direction: Direction) -> (Side, Option<Network>) {
        let side = if direction == self.leaving { Side::Egress } else { Side::Ingress };
        let network = self.reached.address.map(|address| {
            Network::new(address.address(), address.prefix())
                .expect("a network has no more bits than addresses")
        });
        (side, network)
    }

    fn rule(
        &self,
        link: &LinkId,
        direction: Direction,
        conditions: &Conditions,
    ) -> Result<Rule, RealLinkError> {
        // The medium itself contributes its delay.
        let delay = self.medium.added_delay(conditions.delay);
        let netem = Netem::try_from(&Conditions { delay, ..conditions.clone() })
            .map_err(|reason| RealLinkError::Setting { link: link.clone(), reason })?;
        let (side, network) = self.packets(direction);
        Ok(Rule { side, network, netem })
    }
}

/// Returns the rules of each interface for the links' effective conditions in the fabric.
fn rules<'a>(
    graph: &'a HardwareGraph,
    contexts: &[LinkContext],
) -> Result<BTreeMap<&'a str, Vec<Rule>>, RealLinkError> {
    let mut rules: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for real in graph.real_links() {
        let place = Place::of(real);
        for context in contexts.iter().filter(|context| context.link == real.link.id) {
            let rule = place.rule(&context.link, context.direction, &context.effective)?;
            rules.entry(real.reached.interface.as_str()).or_default().push(rule);
        }
    }
    Ok(rules)
}

/// Returns the changes that a run would make to interfaces of this machine, by name. `fabric` is of the same graph.
///
/// # Errors
/// [`RealLinkError`], as [`RealLinks::begin`].
pub(crate) fn interface_plans(
    graph: &HardwareGraph,
    fabric: &mut Fabric,
    confirmed: &Confirmed,
) -> Result<Vec<(String, Plan)>, RealLinkError> {
    let hold = Hold::new().map_err(HoldError::from)?;
    let plan = |(name, rules): (&str, Vec<Rule>)| Ok((name.to_owned(), hold.plan(name, &rules, confirmed)?));
    rules(graph, &fabric.link_contexts(Timestamp::ZERO))?.into_iter().map(plan).collect()
}

impl RealLinks {
    /// Applies the fabric's conditions to links over interfaces; `None` without such links.
    ///
    /// # Errors
    /// [`RealLinkError`].
    pub(crate) fn begin(
        graph: &HardwareGraph,
        fabric: &mut Fabric,
        confirmed: &Confirmed,
        probing: Option<Probing>,
    ) -> Result<Option<Self>, RealLinkError> {
        let links: HashMap<_, _> =
            graph.real_links().map(|real| (real.link.id.clone(), Place::of(real))).collect();
        if links.is_empty() {
            return Ok(None);
        }
        let mut hold = Hold::new().map_err(HoldError::from)?;
        for (name, rules) in rules(graph, &fabric.link_contexts(Timestamp::ZERO))? {
            hold.take(name, &rules, confirmed)?;
            tracing::info!("applied the conditions of links to {name}");
        }
        let reflectors = links.iter().filter(|(_, place)| place.reached.reflector);
        let reflectors = reflectors.filter_map(|(link, place)| {
            let configured = fabric.effective(link)?.map(Conditions::clone);
            Some((link.clone(), place.reached.address?.address(), place.there_and_back(configured)))
        });
        let probes = probing.map(|probing| LinkProbes::begin(reflectors, probing)).transpose()?;
        let alone = links.len() == graph.links.len();
        Ok(Some(Self { links, hold: Mutex::new(hold), traffic: Traffic::default(), alone, probes }))
    }

    /// Whether there are no other links, so that only probes measure lateness.
    pub(crate) fn are_alone(&self) -> bool {
        self.alone
    }

    /// Whether a link leads over an interface of this machine.
    pub(crate) fn has(&self, link: &LinkId) -> bool {
        self.links.contains_key(link)
    }

    /// Changes the conditions of one direction of such a link. They are in force when this returns.
    ///
    /// # Errors
    /// [`RealLinkError`].
    ///
    /// # Panics
    /// For any other link.
    pub(crate) fn set(
        &self,
        link: &LinkId,
        direction: Direction,
        conditions: &Conditions,
    ) -> Result<(), RealLinkError> {
        let place = &self.links[link];
        let rule = place.rule(link, direction, conditions)?;
        let set = || self.hold().set(&place.reached.interface, &rule);
        let way = place.way(direction);
        let done = match &self.probes {
            Some(probes) => probes.change(link, way, conditions, set),
            None => set(),
        };
        done.map_err(RealLinkError::from)
    }

    /// Returns how much longer probes took than configured. The lateness of other packets is unknown.
    pub(crate) fn lateness(&self) -> Lateness {
        self.probes.as_ref().map(LinkProbes::lateness).unwrap_or_default()
    }

    /// Completes the contexts of such links. λ and the counters are those of the interface. Delays come from probes if a
    /// reflector answers. The delay of other packets is not measured, and the fabric's own probes do not cross the link.
    pub(crate) fn complete(&self, now: Timestamp, mut contexts: Vec<LinkContext>) -> Vec<LinkContext> {
        if !contexts.iter().any(|context| self.has(&context.link)) {
            return contexts;
        }
        let hold = self.hold();
        let mut counted = TrafficCounters::new();
        for (link, place) in &self.links {
            let rules = match hold.rules(&place.reached.interface) {
                Ok(rules) => rules,
                Err(error) => {
                    tracing::warn!("cannot read the counters of `{link}`: {error}");
                    continue;
                }
            };
            for direction in [Direction::Forward, Direction::Backward] {
                let packets = place.packets(direction);
                let rule = rules.iter().find(|(rule, _)| (rule.side, rule.network) == packets);
                counted.extend(rule.map(|(_, counters)| ((link.clone(), direction), (*counters).into())));
            }
        }
        let mut found = 0;
        for context in contexts.iter_mut().filter(|context| self.has(&context.link)) {
            let probed = self.probes.as_ref().and_then(|probes| probes.probed(&context.link));
            let way = self.links[&context.link].way(context.direction);
            (context.delay, context.probed) = (None, probed.map(|ways| ways[way]));
            found += 1;
        }
        self.traffic.complete(now, &mut contexts, &counted, found == 2 * self.links.len());
        contexts
    }

    fn hold(&self) -> MutexGuard<'_, Hold> {
        self.hold.lock()
    }
}

impl Drop for RealLinks {
    fn drop(&mut self) {
        for (interface, error) in self.hold().release() {
            tracing::error!("cannot restore {}, which `cotorra clean` tries again: {error}", interface.name);
        }
    }
}
