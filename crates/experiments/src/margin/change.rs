//! Changes of a testbed: more delay, more loss, a slower server, a radio unit down.

use std::{collections::BTreeSet, fmt, time::Duration};

use cotorra_graph::{
    ConditionChange, Conditions, LinkId, Loss, NodeId, NodeKind, Probability, Scheduled, Testbed, millis,
};
use cotorra_testbed::Altered;

/// Loss is counted in millionths.
pub const LOSS_UNITS: u64 = 1_000_000;

/// Kinds of changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Extra delay on a link, or on the air.
    Delay,
    /// Extra loss on a link, or on the air.
    Loss,
    /// A server whose VNFs answer later.
    Answers,
    /// A radio unit that is off.
    Down,
}

impl Kind {
    /// All kinds, with their names.
    pub const ALL: [(&'static str, Self); 4] =
        [("delay", Self::Delay), ("loss", Self::Loss), ("answers", Self::Answers), ("down", Self::Down)];

    /// Returns its name.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

/// A quantity of the testbed that can get worse by any amount.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Dimension {
    /// Delay of a wired link, in each direction. Amounts are in nanoseconds.
    Delay(LinkId),
    /// Delay of all links of a wireless network, in each direction. Amounts are in nanoseconds.
    AirDelay(String),
    /// Loss of a wired link, in each direction. Amounts are in units of [`LOSS_UNITS`].
    Loss(LinkId),
    /// Loss of all links of a wireless network, in each direction. Amounts are in units of [`LOSS_UNITS`].
    AirLoss(String),
    /// Time that a server's bundled VNFs take to answer. Amounts are in nanoseconds.
    Answers(NodeId),
}

impl Dimension {
    /// Returns the name of the link, network or server.
    pub fn on(&self) -> &str {
        match self {
            Self::Delay(link) | Self::Loss(link) => link.as_str(),
            Self::AirDelay(network) | Self::AirLoss(network) => network,
            Self::Answers(server) => server.as_str(),
        }
    }

    /// Returns the kind of change that makes it worse.
    pub(super) fn kind(&self) -> Kind {
        match self {
            Self::Delay(_) | Self::AirDelay(_) => Kind::Delay,
            Self::Loss(_) | Self::AirLoss(_) => Kind::Loss,
            Self::Answers(_) => Kind::Answers,
        }
    }

    /// Returns an amount for people.
    pub fn amount(&self, amount: u64) -> String {
        match self.kind() {
            Kind::Loss => format!("+{} %", amount as f64 * 100.0 / LOSS_UNITS as f64),
            _ => format!("+{} ms", millis::of(Duration::from_nanos(amount))),
        }
    }
}

/// A change of a testbed; the default changes nothing.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Change {
    /// A dimension that gets worse, and the amount.
    pub worse: Option<(Dimension, u64)>,
    /// A radio unit that is off from the start.
    pub down: Option<NodeId>,
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { worse, down } = self;
        match worse {
            Some((dimension, amount)) => {
                let kind = dimension.kind().name();
                write!(f, "{kind} {} {}", dimension.on(), dimension.amount(*amount))?;
            }
            None if down.is_none() => f.write_str("unchanged")?,
            None => {}
        }
        match down {
            Some(unit) if worse.is_some() => write!(f, ", {unit} down"),
            Some(unit) => write!(f, "{unit} down"),
            None => Ok(()),
        }
    }
}

impl Change {
    /// Applies the change to a testbed, and returns its part that no testbed file can state.
    pub(crate) fn apply(&self, testbed: &mut Testbed) -> Altered {
        if let Some(down) = &self.down {
            for node in testbed.graph.nodes.iter_mut().filter(|node| node.id == *down) {
                if let NodeKind::RadioUnit(unit) = &mut node.kind {
                    unit.serving = false;
                }
            }
        }
        let mut altered = Altered::default();
        if let Some((dimension, amount)) = &self.worse {
            let (delay, loss) = (Duration::from_nanos(*amount), *amount as f64 / LOSS_UNITS as f64);
            match dimension {
                Dimension::Answers(server) => drop(altered.slow.insert(server.clone(), delay)),
                Dimension::Delay(link) => {
                    each_direction(testbed, link, |conditions| conditions.delay += delay);
                    delay_schedule(testbed, &[link.clone()].into(), delay);
                }
                Dimension::Loss(link) => {
                    each_direction(testbed, link, |conditions| {
                        conditions.loss = with_more(conditions.loss, loss);
                    });
                    thin_schedule(testbed, &[link.clone()].into(), loss);
                }
                Dimension::AirDelay(ssid) => {
                    if let Some(network) = testbed.graph.wireless.get_mut(ssid) {
                        network.delay += delay;
                    }
                    delay_schedule(testbed, &links_of(testbed, ssid), delay);
                }
                Dimension::AirLoss(ssid) => {
                    if let Some(network) = testbed.graph.wireless.get_mut(ssid) {
                        network.loss = with_more(network.loss, loss);
                    }
                    thin_schedule(testbed, &links_of(testbed, ssid), loss);
                }
            }
        }
        altered
    }
}

/// Changes the conditions of each direction of a wired link at the start.
fn each_direction(testbed: &mut Testbed, link: &LinkId, change: impl Fn(&mut Conditions)) {
    for link in testbed.graph.links.iter_mut().filter(|other| other.id == *link) {
        change(&mut link.forward);
        change(&mut link.backward);
    }
}

/// Returns the links of a wireless network.
fn links_of(testbed: &Testbed, ssid: &str) -> BTreeSet<LinkId> {
    let graph = &testbed.graph;
    let units = || graph.radio_units().filter(|(_, unit)| unit.network == ssid).map(|(node, _)| &node.id);
    let robots = graph.robots().filter(|(_, robot)| robot.network == ssid);
    robots.flat_map(|(node, _)| units().map(|unit| LinkId::wireless(&node.id, unit))).collect()
}

/// Adds delay wherever the schedule sets that of these links.
fn delay_schedule(testbed: &mut Testbed, links: &BTreeSet<LinkId>, more: Duration) {
    reschedule(testbed, links, |set| set.delay_ms = set.delay_ms.map(|delay_ms| delay_ms + millis::of(more)));
}

/// Adds loss wherever the schedule sets that of these links.
fn thin_schedule(testbed: &mut Testbed, links: &BTreeSet<LinkId>, more: f64) {
    reschedule(testbed, links, |set| set.loss = set.loss.map(|loss| with_more(loss, more)));
}

/// Returns a loss that also loses a share `more` of what it lets pass.
fn with_more(loss: Loss, more: f64) -> Loss {
    let rate = |before: Probability| {
        let rate = 1.0 - (1.0 - before.get()) * (1.0 - more);
        Probability::new(rate.clamp(0.0, 1.0)).expect("a share")
    };
    match loss {
        Loss::None => Loss::Independent { rate: rate(Probability::ZERO) },
        Loss::Independent { rate: before } => Loss::Independent { rate: rate(before) },
        Loss::Bursty { rate: before, .. } if rate(before).get() >= 1.0 => {
            Loss::Independent { rate: Probability::ONE }
        }
        Loss::Bursty { rate: before, mean_burst } => Loss::Bursty { rate: rate(before), mean_burst },
    }
}

/// Changes what the schedule sets for these links; other links of the same entries keep theirs.
fn reschedule(testbed: &mut Testbed, links: &BTreeSet<LinkId>, change: impl Fn(&mut ConditionChange)) {
    let entries = std::mem::take(&mut testbed.script.schedule);
    testbed.script.schedule = entries
        .into_iter()
        .flat_map(|entry| {
            let (own, others): (Vec<_>, Vec<_>) =
                entry.links.iter().cloned().partition(|link| links.contains(link));
            let mut changed = Scheduled { links: own, ..entry.clone() };
            change(&mut changed.set);
            let others = Scheduled { links: others, ..entry };
            [others, changed].into_iter().filter(|entry| !entry.links.is_empty())
        })
        .collect();
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn testbed() -> Testbed {
        let text = "name: x\nwireless: { w: { delay: 1 ms } }\nnodes:\n  U: { kind: radio_unit, position: [0, 0], channel: 1 }\n  \
                    r: { kind: robot, position: [1, 0] }\n  \
                    a: { kind: server, tier: edge, cpus: 1, memory: 1 GB }\n  b: { kind: switch }\n\
                    links:\n  - { ends: [a, b], delay: 1 ms, loss: 50 % }\n  - { ends: [b, U], delay: 2 ms }\n\
                    schedule:\n  - { at: 1 s, links: [a-b, b-U], set: { delay: 8 ms, loss: 20 % } }\n  \
                    - { at: 2 s, links: a-b, set: { delay_scale: 2 } }\n  \
                    - { at: 3 s, links: [r~U, b-U], set: { delay: 4 ms, loss: 10 % } }\n";
        cotorra_testbed_file::parse("x.yaml", text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
    }

    fn changed(dimension: Dimension, amount: u64) -> (Testbed, Altered) {
        let mut testbed = testbed();
        let altered = Change { worse: Some((dimension, amount)), down: None }.apply(&mut testbed);
        (testbed, altered)
    }

    fn link(name: &str) -> LinkId {
        name.parse().unwrap()
    }

    #[test]
    fn delay_is_added_at_the_start_and_in_the_schedule_of_that_link_only() {
        let (testbed, _) = changed(Dimension::Delay(link("a-b")), 3_100_000);
        let delays = |link: &cotorra_graph::Link| [link.forward.delay, link.backward.delay].map(millis::of);
        assert_eq!(delays(&testbed.graph.links[0]), [4.1, 4.1]);
        assert_eq!(delays(&testbed.graph.links[1]), [2.0, 2.0]);
        let set: Vec<_> = testbed
            .script
            .schedule
            .iter()
            .map(|entry| (entry.links[0].as_str(), entry.set.delay_ms, entry.set.delay_scale))
            .collect();
        let expected = [
            ("b-U", Some(8.0), None),
            ("a-b", Some(11.1), None),
            ("a-b", None, Some(2.0)),
            ("r~U", Some(4.0), None),
        ];
        assert_eq!(set, expected);
    }

    fn share(loss: Option<Loss>) -> f64 {
        match loss {
            Some(Loss::Independent { rate }) => rate.get(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn loss_is_added_to_what_passes() {
        let (testbed, _) = changed(Dimension::Loss(link("a-b")), LOSS_UNITS / 10);
        assert!((share(Some(testbed.graph.links[0].forward.loss)) - 0.55).abs() < 1e-12);
        assert_eq!(testbed.graph.links[1].forward.loss, Loss::None);
        assert!((share(testbed.script.schedule[1].set.loss) - 0.28).abs() < 1e-12);
        let bursty = Loss::Bursty { rate: Probability::new(0.5).unwrap(), mean_burst: 4.0 };
        let more = Loss::Bursty { rate: Probability::new(0.75).unwrap(), mean_burst: 4.0 };
        assert_eq!(with_more(bursty, 0.5), more);
        assert_eq!(with_more(bursty, 1.0), Loss::Independent { rate: Probability::ONE });
    }

    #[test]
    fn the_air_gets_worse_at_the_start_and_in_the_schedule_of_its_links_only() {
        let at_3_s = |testbed: &Testbed| -> Vec<_> {
            let entries = testbed.script.schedule.iter().filter(|entry| entry.set.delay_ms < Some(8.0));
            let entries = entries.filter(|entry| entry.set.loss.is_some());
            entries.map(|entry| (entry.links.clone(), entry.set.clone())).collect()
        };
        let (slow, _) = changed(Dimension::AirDelay("w".to_owned()), 2_000_000);
        assert_eq!(slow.graph.wireless["w"].delay, Duration::from_millis(3));
        let [(others, unchanged), (own, worse)] = &at_3_s(&slow)[..] else { panic!("{slow:?}") };
        assert_eq!((&others[..], &own[..]), (&[link("b-U")][..], &[link("r~U")][..]));
        assert_eq!((unchanged.delay_ms, worse.delay_ms), (Some(4.0), Some(6.0)));
        assert_eq!(slow.graph.links, testbed().graph.links);

        let (lossy, _) = changed(Dimension::AirLoss("w".to_owned()), LOSS_UNITS / 2);
        assert_eq!(share(Some(lossy.graph.wireless["w"].loss)), 0.5);
        let [(_, unchanged), (_, worse)] = &at_3_s(&lossy)[..] else { panic!("{lossy:?}") };
        assert_eq!((share(unchanged.loss), share(worse.loss)), (0.1, 0.55));
        assert_eq!(lossy.graph.links, testbed().graph.links);
        // Links of another network stay.
        let (other, _) = changed(Dimension::AirLoss("x".to_owned()), LOSS_UNITS / 2);
        assert_eq!(other, testbed());
    }

    #[test]
    fn servers_and_radio_units_get_worse_too() {
        let (unchanged, altered) = changed(Dimension::Answers("a".parse().unwrap()), 2_000_000);
        assert_eq!(unchanged, testbed());
        let slow: Vec<_> = altered.slow.into_iter().collect();
        assert_eq!(slow, [("a".parse().unwrap(), Duration::from_millis(2))]);
        let mut testbed = testbed();
        Change { worse: None, down: Some("U".parse().unwrap()) }.apply(&mut testbed);
        assert!(!testbed.graph.radio_units().next().unwrap().1.serving);
    }

    #[test]
    fn changes_have_names() {
        let worse = Some((Dimension::Delay(link("a-b")), 3_100_000));
        let down: Option<NodeId> = Some("U".parse().unwrap());
        let name = |worse: &Option<_>, down: &Option<_>| {
            Change { worse: worse.clone(), down: down.clone() }.to_string()
        };
        assert_eq!(name(&worse, &down), "delay a-b +3.1 ms, U down");
        assert_eq!(name(&worse, &None), "delay a-b +3.1 ms");
        assert_eq!(name(&None, &down), "U down");
        assert_eq!(name(&None, &None), "unchanged");
        assert_eq!(Dimension::Loss(link("a-b")).amount(1500), "+0.15 %");
    }
}
