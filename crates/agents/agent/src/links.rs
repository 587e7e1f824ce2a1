//! Gives interfaces of this machine the conditions that the core wants, by NetEm, and restores them.

use std::{collections::BTreeMap, time::Duration};

use cotorra_agent_protocol::{LinkReading, LinkState, WantedLink};
use cotorra_graph::{LinkId, Timestamp};
use cotorra_netem::{Confirmed, Hold, HoldError, Rule, Side, put_back};

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

/// The rules of a link: for packets that leave, and for those that arrive.
type Rules = [Rule; 2];

/// An interface that has conditions.
struct Held {
    hold: Hold,
    /// The rules in force.
    rules: BTreeMap<LinkId, Rules>,
}

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
        for (interface, Held { hold, rules }) in &self.held {
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
            for (link, [leaving, arriving]) in rules {
                if let (Some(leaving), Some(arriving)) = (counters(leaving), counters(arriving)) {
                    readings.insert(link.clone(), LinkReading { leaving, arriving });
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
        let mut interfaces = BTreeMap::<String, BTreeMap<LinkId, Rules>>::new();
        for (link, wanted) in &self.wanted {
            match rules(wanted) {
                Ok(rules) => {
                    let of = interfaces.entry(wanted.interface.clone()).or_default();
                    of.insert(link.clone(), rules);
                }
                Err(reason) => drop(self.failures.insert(link.clone(), reason)),
            }
        }
        let others = self.held.iter().filter(|(interface, held)| {
            interfaces.get(*interface).is_none_or(|rules| !are_for_same_packets(rules, &held.rules))
        });
        let others: Vec<_> = others.map(|(interface, _)| interface.clone()).collect();
        others.iter().for_each(|interface| self.release(interface));
        for (interface, rules) in interfaces {
            match self.held.get_mut(&interface) {
                Some(held) => self.failures.extend(held.change(&interface, rules)),
                None => match take(&interface, rules, &self.confirmed) {
                    Ok(held) => {
                        tracing::info!("applied the conditions of links to {interface}");
                        self.held.insert(interface, held);
                    }
                    Err(error) => self.fail(&interface, &error.to_string()),
                },
            }
        }
        for (link, reason) in self.failures.iter().filter(|(link, reason)| before.get(*link) != Some(*reason))
        {
            tracing::warn!("link `{link}`: {reason}; trying again");
        }
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
    /// Changes what differs from these rules, which are for the same packets. Returns the links that could not be changed,
    /// with the reasons.
    fn change(&mut self, interface: &str, rules: BTreeMap<LinkId, Rules>) -> Vec<(LinkId, String)> {
        let mut failures = Vec::new();
        for (link, new) in rules {
            let Some(old) = self.rules.get_mut(&link) else { continue };
            for (old, new) in old.iter_mut().zip(new).filter(|(old, new)| *old != new) {
                match self.hold.set(interface, &new) {
                    Ok(()) => *old = new,
                    Err(error) => failures.push((link.clone(), error.to_string())),
                }
            }
        }
        failures
    }
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

/// Gives an interface conditions.
fn take(interface: &str, rules: BTreeMap<LinkId, Rules>, confirmed: &Confirmed) -> Result<Held, HoldError> {
    let mut hold = Hold::new()?;
    let all: Vec<_> = rules.values().flatten().cloned().collect();
    hold.take(interface, &all, confirmed)?;
    Ok(Held { hold, rules })
}

/// Converts what is wanted of a link.
fn rules(wanted: &WantedLink) -> Result<Rules, String> {
    let rule = |side, conditions| Rule::new(side, wanted.addresses, conditions).map_err(|e| e.to_string());
    Ok([rule(Side::Egress, &wanted.leaving)?, rule(Side::Ingress, &wanted.arriving)?])
}

/// Whether the same packets belong to each link.
fn are_for_same_packets(some: &BTreeMap<LinkId, Rules>, others: &BTreeMap<LinkId, Rules>) -> bool {
    let packets = |(_, rules): (_, &Rules)| rules.each_ref().map(Rule::packets);
    some.keys().eq(others.keys()) && some.iter().map(packets).eq(others.iter().map(packets))
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Conditions, Rate, Trace};

    use super::*;

    fn wanted(interface: &str, leaving: Conditions) -> WantedLink {
        let arriving = Conditions::default();
        WantedLink { interface: interface.to_owned(), addresses: None, leaving, arriving }
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
