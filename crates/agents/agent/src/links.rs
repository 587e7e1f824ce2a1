//! Gives interfaces of this machine the conditions that the core wants, by NetEm, and restores them. Probes links that have a
//! reflector.

use std::{collections::BTreeMap, io, time::Duration};

use cotorra_agent_protocol::{LinkReading, LinkState, WantedLink, WantedProbes};
use cotorra_graph::{Conditions, LinkId, Timestamp};
use cotorra_netem::{Confirmed, Hold, HoldError, Rule, Side, put_back};
use cotorra_probes::LinkProbe;

/// Interval of attempts after a failure.
const AGAIN: Duration = Duration::from_secs(1);

/// The links over interfaces of this machine. Dropping it restores the interfaces.
pub(crate) struct Links {
    confirmed: Confirmed,
    wanted: BTreeMap<LinkId, WantedLink>,
    held: BTreeMap<String, Held>,
    /// Why links have no conditions, or not those that are wanted.
    failures: BTreeMap<LinkId, String>,
    /// Time of the next attempt.
    again: Timestamp,
}

/// An interface that has conditions.
struct Held {
    hold: Hold,
    links: BTreeMap<LinkId, Emulated>,
}

/// A link that has conditions.
struct Emulated {
    /// Its rules in force.
    rules: Rules,
    /// Its probes as wanted, and those that were begun.
    probes: Option<WantedProbes>,
    probe: Option<LinkProbe>,
}

/// Wanted conditions of a link, as NetEm applies them.
struct Plan<'a> {
    wanted: &'a WantedLink,
    rules: Rules,
}

/// The plans of an interface.
type Plans<'a> = BTreeMap<&'a LinkId, Plan<'a>>;

/// The rules of a link: for packets that leave, and for those that arrive.
type Rules = [Rule; 2];

impl Links {
    /// Restores the interfaces that a killed agent left.
    pub(crate) fn new(confirmed: Confirmed) -> Self {
        restore_leftovers();
        Self {
            confirmed,
            wanted: BTreeMap::new(),
            held: BTreeMap::new(),
            failures: BTreeMap::new(),
            again: Timestamp::MAX,
        }
    }

    /// Gives these links their conditions, and restores all other interfaces.
    pub(crate) fn want(&mut self, now: Timestamp, wanted: BTreeMap<LinkId, WantedLink>) {
        self.wanted = wanted;
        self.apply(now);
    }

    /// Returns when [`Self::advance`] has something to do.
    pub(crate) fn next_deadline(&self) -> Timestamp {
        self.again
    }

    /// Tries again what failed, if that is due.
    pub(crate) fn advance(&mut self, now: Timestamp) {
        if now >= self.again {
            // A process that was killed may still have been there at the start.
            restore_leftovers();
            self.apply(now);
        }
    }

    /// Returns the state of each wanted link.
    pub(crate) fn states(&self) -> BTreeMap<LinkId, LinkState> {
        let state = |link| match self.failures.get(link) {
            Some(reason) => LinkState::Failed(reason.clone()),
            None => LinkState::Applied,
        };
        self.wanted.keys().map(|link| (link.clone(), state(link))).collect()
    }

    /// Returns what crossed the links that have conditions. An interface that lost its conditions gets them again.
    pub(crate) fn read(&mut self, now: Timestamp) -> BTreeMap<LinkId, LinkReading> {
        let mut readings = BTreeMap::new();
        let mut lost = Vec::new();
        for (interface, Held { hold, links }) in &mut self.held {
            let counted = match hold.rules(interface) {
                Ok(counted) => counted,
                Err(error) => {
                    lost.push((interface.clone(), error.to_string()));
                    continue;
                }
            };
            let counters = |rule: &Rule| {
                let found = counted.iter().find(|(its, _)| its.packets() == rule.packets());
                found.map(|(_, counters)| (*counters).into())
            };
            for (link, Emulated { rules: [leaving, arriving], probes, probe }) in links {
                if let (Some(leaving), Some(arriving)) = (counters(leaving), counters(arriving)) {
                    if let (None, Some(probes), Some(wanted)) = (&probe, *probes, self.wanted.get(link)) {
                        // There may be a route to the reflector now.
                        *probe = begin(link, wanted, probes).ok();
                    }
                    let probed = probe.as_ref().and_then(LinkProbe::probed);
                    readings.insert(link.clone(), LinkReading { leaving, arriving, probed });
                } else if lost.last().is_none_or(|(its, _)| its != interface) {
                    lost.push((interface.clone(), format!("somebody removed conditions of `{interface}`")));
                }
            }
        }
        for (interface, reason) in lost {
            self.release(&interface);
            self.fail(&interface, &reason);
            self.again = now + AGAIN;
        }
        readings
    }

    /// Makes the interfaces as wanted, as far as that is possible.
    fn apply(&mut self, now: Timestamp) {
        let before = std::mem::take(&mut self.failures);
        let wanted = std::mem::take(&mut self.wanted);
        let mut interfaces = BTreeMap::<&str, Plans<'_>>::new();
        for (link, wanted) in &wanted {
            match rules(wanted) {
                Ok(rules) => {
                    let plans = interfaces.entry(&wanted.interface).or_default();
                    plans.insert(link, Plan { wanted, rules });
                }
                Err(reason) => drop(self.failures.insert(link.clone(), reason)),
            }
        }
        let others = self.held.iter().filter(|(interface, held)| {
            interfaces.get(interface.as_str()).is_none_or(|plans| !held.is_for(plans))
        });
        let others: Vec<_> = others.map(|(interface, _)| interface.clone()).collect();
        others.iter().for_each(|interface| self.release(interface));
        for (interface, plans) in interfaces {
            if let Some(held) = self.held.get_mut(interface) {
                self.failures.extend(held.change(interface, plans));
                continue;
            }
            let links: Vec<_> = plans.keys().copied().cloned().collect();
            match Held::take(interface, plans, &self.confirmed) {
                Ok(held) => {
                    tracing::info!("applied the conditions of links to {interface}");
                    self.held.insert(interface.to_owned(), held);
                }
                Err(error) => {
                    self.failures.extend(links.into_iter().map(|link| (link, error.to_string())));
                }
            }
        }
        for (link, reason) in self.failures.iter().filter(|(link, reason)| before.get(*link) != Some(*reason))
        {
            tracing::warn!("link `{link}`: {reason}; trying again");
        }
        self.wanted = wanted;
        self.again = if self.failures.is_empty() { Timestamp::MAX } else { now + AGAIN };
    }

    /// Notes why the links of an interface have no conditions, unless they have reasons of their own.
    fn fail(&mut self, interface: &str, reason: &str) {
        for (link, _) in self.wanted.iter().filter(|(_, wanted)| wanted.interface == interface) {
            self.failures.entry(link.clone()).or_insert_with(|| reason.to_owned());
        }
    }

    /// Restores an interface.
    fn release(&mut self, interface: &str) {
        let Some(mut held) = self.held.remove(interface) else { return };
        match held.hold.release().pop() {
            None => tracing::info!("restored {interface}"),
            Some((_, error)) => {
                tracing::error!(
                    "cannot restore {interface}, which the next start of the agent tries again: {error}"
                );
            }
        }
    }
}

impl Drop for Links {
    fn drop(&mut self) {
        let held: Vec<_> = self.held.keys().cloned().collect();
        held.iter().for_each(|interface| self.release(interface));
    }
}

impl Held {
    /// Gives an interface conditions, and probes its links.
    fn take(interface: &str, plans: Plans<'_>, confirmed: &Confirmed) -> Result<Self, HoldError> {
        let mut hold = Hold::new()?;
        let all: Vec<_> = plans.values().flat_map(|plan| &plan.rules).cloned().collect();
        hold.take(interface, &all, confirmed)?;
        let emulated = |(link, Plan { wanted, rules }): (&LinkId, Plan<'_>)| {
            let probes = wanted.probes;
            let tell = |e: &io::Error| tracing::warn!("link `{link}` cannot be probed: {e}; trying again");
            let probe = probes.and_then(|probes| begin(link, wanted, probes).inspect_err(tell).ok());
            (link.clone(), Emulated { rules, probes, probe })
        };
        Ok(Self { hold, links: plans.into_iter().map(emulated).collect() })
    }

    /// Whether plans are for the same packets, and the same probes.
    fn is_for(&self, plans: &Plans<'_>) -> bool {
        let packets = |rules: &Rules| rules.each_ref().map(Rule::packets);
        self.links.keys().eq(plans.keys().copied())
            && self.links.values().zip(plans.values()).all(|(its, plan)| {
                packets(&its.rules) == packets(&plan.rules) && its.probes == plan.wanted.probes
            })
    }

    /// Changes what differs from these plans, which are for the same packets. Returns the links that could not be changed,
    /// with the reasons.
    fn change(&mut self, interface: &str, plans: Plans<'_>) -> Vec<(LinkId, String)> {
        let mut failures = Vec::new();
        for ((link, its), Plan { wanted, rules }) in self.links.iter_mut().zip(plans.into_values()) {
            let ways = its.rules.iter_mut().zip(rules).zip([&wanted.leaving, &wanted.arriving]).enumerate();
            for (way, ((old, new), conditions)) in ways.filter(|(_, ((old, new), _))| *old != new) {
                let mut set = || self.hold.set(interface, &new);
                let done = match (&its.probe, its.probes) {
                    (Some(probe), Some(probes)) => probe.change(way, &whole(conditions, probes), set),
                    _ => set(),
                };
                match done {
                    Ok(()) => *old = new,
                    Err(error) => failures.push((link.clone(), error.to_string())),
                }
            }
        }
        failures
    }
}

/// Begins to probe a link.
fn begin(link: &LinkId, wanted: &WantedLink, probes: WantedProbes) -> io::Result<LinkProbe> {
    let configured = [&wanted.leaving, &wanted.arriving].map(|way| whole(way, probes));
    LinkProbe::begin(link.clone(), probes.reflector, configured, probes.probing, |_| ())
}

/// Returns what a link does with its medium.
fn whole(added: &Conditions, probes: WantedProbes) -> Conditions {
    Conditions { delay: added.delay + probes.medium_delay, ..added.clone() }
}

/// Restores the interfaces of killed processes.
fn restore_leftovers() {
    for (interface, restored) in put_back() {
        match restored {
            Ok(()) => tracing::info!("restored {}, which a killed process left", interface.name),
            Err(error) => tracing::warn!("cannot restore {}: {error}", interface.name),
        }
    }
}

/// Converts what is wanted of a link.
fn rules(wanted: &WantedLink) -> Result<Rules, String> {
    let rule = |side, conditions| Rule::new(side, wanted.addresses, conditions).map_err(|e| e.to_string());
    Ok([rule(Side::Egress, &wanted.leaving)?, rule(Side::Ingress, &wanted.arriving)?])
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Conditions, Rate, Trace};

    use super::*;

    fn wanted(interface: &str, leaving: Conditions) -> WantedLink {
        let arriving = Conditions::default();
        WantedLink { interface: interface.to_owned(), addresses: None, leaving, arriving, probes: None }
    }

    #[test]
    fn links_that_cannot_be_emulated_have_reasons_and_are_tried_again() {
        let trace = Rate::Trace { trace: Trace::parse("1").unwrap().into() };
        let trace = Conditions { rate: trace, ..Conditions::default() };
        let all = [("a", wanted("no-such", Conditions::default())), ("b", wanted("no-such", trace))];
        let all = BTreeMap::from(all.map(|(link, wanted)| (link.parse().unwrap(), wanted)));
        let mut links = Links::new(Confirmed::default());
        assert_eq!(links.next_deadline(), Timestamp::MAX);
        links.want(Timestamp::ZERO, all);
        let states: Vec<_> = links.states().into_values().collect();
        let LinkState::Failed(missing) = &states[0] else { panic!("{states:?}") };
        assert!(missing.starts_with("there is no interface `no-such` here"), "{missing}");
        let LinkState::Failed(trace) = &states[1] else { panic!("{states:?}") };
        assert!(trace.contains("packet-delivery traces"), "{trace}");
        assert_eq!(links.next_deadline(), Timestamp::ZERO + AGAIN);
        links.advance(Timestamp::ZERO + AGAIN);
        assert_eq!(links.next_deadline(), Timestamp::ZERO + AGAIN * 2);
        assert_eq!(links.read(Timestamp::ZERO), BTreeMap::new());
        links.want(Timestamp::ZERO, BTreeMap::new());
        assert_eq!((links.states(), links.next_deadline()), (BTreeMap::new(), Timestamp::MAX));
    }
}
