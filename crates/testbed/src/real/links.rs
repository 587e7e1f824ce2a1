//! Links over interfaces of this machine. NetEm works on the interface itself, for the packets of any program. The fabric
//! keeps the state of these links as of all others, but does not carry their packets.

use std::collections::{BTreeMap, HashMap};

use cotorra_fabric::Fabric;
use cotorra_graph::{
    AgentId, Conditions, Direction, HardwareGraph, Lateness, LinkContext, LinkId, Probing, Timestamp,
};
use cotorra_netem::{Confirmed, Hold, HoldError, Plan, Rule};
use parking_lot::{Mutex, MutexGuard};

use crate::real::{
    places::{NotForNetem, Place},
    reflectors::{LinkProbes, ReflectorError},
    traffic::{Traffic, TrafficCounters},
};

/// Error of a link over a real interface. Nothing has changed then.
#[derive(Debug, thiserror::Error)]
pub enum RealLinkError {
    /// NetEm cannot emulate a condition.
    #[error(transparent)]
    Setting(#[from] NotForNetem),
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
    /// Whether all links of the testbed lead over real interfaces.
    alone: bool,
    /// `None` if the testbed is not probed.
    probes: Option<LinkProbes>,
}

/// The rules of each interface, by the agent on whose machine it is, and by its name. This machine is no agent's.
type Rules<'a> = BTreeMap<(Option<&'a AgentId>, &'a str), Vec<Rule>>;

/// Returns the rules of each interface for the links' effective conditions in the fabric.
fn rules<'a>(graph: &'a HardwareGraph, contexts: &[LinkContext]) -> Result<Rules<'a>, NotForNetem> {
    let mut rules = Rules::new();
    for real in graph.real_links() {
        let place = Place::of(real);
        for context in contexts.iter().filter(|context| context.link == real.link.id) {
            let rule = place.rule(&context.link, context.direction, &context.effective)?;
            let interface = (real.reached.via.as_ref(), real.reached.interface.as_str());
            rules.entry(interface).or_default().push(rule);
        }
    }
    Ok(rules)
}

/// Changes of an interface by a run.
#[derive(Debug)]
pub enum InterfacePlan {
    /// Changes of an interface of this machine.
    Here(Plan),
    /// An agent gives an interface of its machine these rules. It is not asked before the run.
    AtAgent(AgentId, Vec<Rule>),
}

/// Returns what a run would do to interfaces, by name. `fabric` is of the same graph.
///
/// # Errors
/// [`RealLinkError`], as [`RealLinks::begin`].
pub(crate) fn interface_plans(
    graph: &HardwareGraph,
    fabric: &mut Fabric,
    confirmed: &Confirmed,
) -> Result<Vec<(String, InterfacePlan)>, RealLinkError> {
    let hold = Hold::new().map_err(HoldError::from)?;
    let plan = |((via, name), rules): ((Option<&AgentId>, &str), Vec<Rule>)| {
        let plan = match via {
            None => InterfacePlan::Here(hold.plan(name, &rules, confirmed)?),
            Some(agent) => InterfacePlan::AtAgent(agent.clone(), rules),
        };
        Ok((name.to_owned(), plan))
    };
    rules(graph, &fabric.link_contexts(Timestamp::ZERO))?.into_iter().map(plan).collect()
}

impl RealLinks {
    /// Applies the fabric's conditions to links over interfaces of this machine; `None` without such links.
    ///
    /// # Errors
    /// [`RealLinkError`].
    pub(crate) fn begin(
        graph: &HardwareGraph,
        fabric: &mut Fabric,
        confirmed: &Confirmed,
        probing: Option<Probing>,
    ) -> Result<Option<Self>, RealLinkError> {
        let here = graph.real_links().filter(|real| real.reached.via.is_none());
        let links: HashMap<_, _> = here.map(|real| (real.link.id.clone(), Place::of(real))).collect();
        if links.is_empty() {
            return Ok(None);
        }
        let mut hold = Hold::new().map_err(HoldError::from)?;
        for ((via, name), rules) in rules(graph, &fabric.link_contexts(Timestamp::ZERO))? {
            if via.is_some() {
                continue;
            }
            hold.take(name, &rules, confirmed)?;
            tracing::info!("applied the conditions of links to {name}");
        }
        let reflectors = links.iter().filter(|(_, place)| place.reached.reflector);
        let reflectors = reflectors.filter_map(|(link, place)| {
            let configured = fabric.effective(link)?.map(Conditions::clone);
            Some((link.clone(), place.reached.address?.address(), place.there_and_back(configured)))
        });
        let probes = probing.map(|probing| LinkProbes::begin(reflectors, probing)).transpose()?;
        let alone = graph.real_links().count() == graph.links.len();
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
                let rule = rules.iter().find(|(rule, _)| rule.packets() == place.packets(direction));
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
