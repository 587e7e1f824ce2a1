//! The plug-in. It passes the domain's events and the ledger's notices to the journeys of its robots and to the
//! services that it hosts, and carries out their decisions.

use std::{
    collections::{BTreeMap, BTreeSet},
    mem,
    net::SocketAddr,
};

use cotorra_graph::{AccessPoint, DomainId, Event, NodeId, Testbed, Timestamp, VnfState};
use cotorra_ledger::{
    Call, Event as LedgerEvent, Ledger, Notice, Secret, ServiceId,
    negotiation::{Creator, CreatorStep, Policy, Record, Request},
};
use cotorra_plugin::{Actions, Noted, Plugin, coverage::Coverage, settings::InvalidSettings};

use crate::{
    context::{DomainContext, Unit},
    error::LedgerError,
    hosting::Hosting,
    journey::{Journey, creator_steps},
    ledgers::Ledgers,
    settings::Settings,
    steps::Step,
};

/// Most announcement numbers to try, after the last known one, to recognise an own announcement.
const UNKNOWN: u64 = 1000;

/// An orchestrator that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum FederationError {
    /// The settings are invalid.
    #[error(transparent)]
    Settings(#[from] InvalidSettings),
    /// The ledger cannot be opened.
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    /// The plug-in is bound to no domain.
    #[error("it orchestrates one domain: add `domain:` with its name")]
    NoDomain,
}

/// The orchestrator of one domain.
pub struct Federation {
    settings: Settings,
    ledger: Box<dyn Ledger>,
    secret: Secret,
    /// The domain's name, under which it registers.
    name: String,
    /// The frame of positions. All domains of a testbed use one name for it.
    map: String,
    coverage: Coverage,
    /// Address at which this core takes the robots of others.
    core: Option<SocketAddr>,
    units: BTreeMap<NodeId, Unit>,
    journeys: BTreeMap<NodeId, Journey>,
    hosting: Hosting,
    closing: Vec<Creator>,
    /// Own services on the chain from before this orchestrator was restarted.
    resumed: Vec<Creator>,
    /// Notes from before it was restarted.
    noted: BTreeSet<Noted>,
    /// Record of how others served its robots.
    record: Record,
    /// Number of services announced.
    announced: u64,
    /// Whether all past events of the chain have been received.
    caught_up: bool,
}

impl Federation {
    /// Reads the settings of a testbed file, and opens the domain's ledger.
    ///
    /// # Errors
    /// [`FederationError`].
    pub fn open(
        settings: &serde_json::Map<String, serde_json::Value>,
        domain: Option<&DomainId>,
        seed: u64,
        ledgers: &mut Ledgers,
    ) -> Result<Self, FederationError> {
        let domain = domain.ok_or(FederationError::NoDomain)?;
        let settings = Settings::decode(settings)?;
        let (ledger, secret) = ledgers.open(&settings.ledger, domain, seed)?;
        Ok(Self::new(settings, domain, ledger, secret))
    }

    /// Makes the orchestrator of a domain on a ledger.
    pub fn new(settings: Settings, domain: &DomainId, ledger: Box<dyn Ledger>, secret: Secret) -> Self {
        Self {
            coverage: Coverage::of(&empty(), settings.edge),
            core: None,
            settings,
            record: Record::new(ledger.account()),
            ledger,
            secret,
            name: domain.to_string(),
            map: String::new(),
            units: BTreeMap::new(),
            journeys: BTreeMap::new(),
            hosting: Hosting::default(),
            closing: Vec::new(),
            resumed: Vec::new(),
            noted: BTreeSet::new(),
            announced: 0,
            caught_up: false,
        }
    }

    /// Calls a role with its state.
    fn with<R>(
        &mut self,
        now: Timestamp,
        actions: &mut Actions,
        call: impl FnOnce(
            &mut BTreeMap<NodeId, Journey>,
            &mut Hosting,
            &mut dyn Ledger,
            &mut DomainContext<'_>,
        ) -> R,
    ) -> R {
        let mut domain_context = DomainContext {
            now,
            settings: &self.settings,
            secret: &self.secret,
            coverage: &self.coverage,
            core: self.core,
            units: &mut self.units,
            closing: &mut self.closing,
            noted: &self.noted,
            actions,
        };
        call(&mut self.journeys, &mut self.hosting, &mut *self.ledger, &mut domain_context)
    }

    /// Handles the ledger's notices and acts on them.
    fn turn(&mut self, now: Timestamp, actions: &mut Actions) {
        while let Some(notice) = self.ledger.poll(now) {
            self.handle_notice(now, &notice);
        }
        if !self.caught_up {
            return;
        }
        self.announce(now);
        while self.work(now, actions) {}
        self.closing.retain(|creator| !creator.is_over());
    }

    fn handle_notice(&mut self, now: Timestamp, notice: &Notice) {
        self.record.handle(notice);
        match notice {
            Notice::Head { .. } => self.caught_up = true,
            Notice::Event(announced @ LedgerEvent::ServiceAnnounced { creator, .. }) => {
                if *creator == self.ledger.account() {
                    self.resume(now, announced);
                } else {
                    let account = self.ledger.account();
                    let (units, coverage) = (&self.units, &self.coverage);
                    self.hosting.consider(
                        announced,
                        account,
                        &self.secret,
                        &self.settings,
                        &self.map,
                        units,
                        coverage,
                    );
                }
            }
            _ => {}
        }
        let journeys = self.journeys.values_mut().filter_map(Journey::creator);
        for creator in journeys.chain(&mut self.closing).chain(&mut self.resumed) {
            creator.handle(now, notice);
        }
        self.hosting.handle_notice(now, notice);
    }

    /// Resumes an own service from before a restart, recognised by being unknown.
    fn resume(&mut self, now: Timestamp, announced: &LedgerEvent) {
        let LedgerEvent::ServiceAnnounced { id, requirements, terms, .. } = announced else { return };
        let journeys = self.journeys.values_mut().filter_map(Journey::creator).map(|creator| &*creator);
        // Searching for the number of a known service would compute a thousand hashes in vain.
        if journeys.chain(&self.closing).chain(&self.resumed).any(|creator| creator.id() == *id) {
            return;
        }
        let account = self.ledger.account();
        let is_it = |number: &u64| {
            ServiceId::of(self.secret.deployment(), account, self.secret.announcement_salt(*number)) == *id
        };
        let Some(number) = (self.announced..self.announced + UNKNOWN).find(is_it) else { return };
        self.announced = number + 1;
        let (requirements, policy, record) = (requirements.clone(), self.policy(), self.record.clone());
        let request = Request { requirements, terms: *terms, policy, record };
        let salt = self.secret.announcement_salt(number);
        self.resumed.push(Creator::new(now, account, self.secret.clone(), salt, request));
    }

    fn policy(&self) -> Policy {
        Policy {
            highest: self.settings.highest_price.unwrap_or(cotorra_ledger::Price::MAX),
            collect: self.settings.collect(),
            enough: self.settings.enough,
            patience: self.settings.patience,
        }
    }

    /// Announces the services that robots need.
    fn announce(&mut self, now: Timestamp) {
        self.resumed.retain(|creator| !creator.is_over());
        // Assign resumed services to the robots that need them, and end the others.
        let all_known = self.journeys.values().all(Journey::is_known);
        for mut creator in mem::take(&mut self.resumed) {
            match self.journeys.values_mut().find(|journey| journey.is_lost()) {
                Some(journey) => journey.resume(creator),
                None if !all_known => self.resumed.push(creator),
                None => {
                    creator.release();
                    self.closing.push(creator);
                }
            }
        }
        let policy = self.policy();
        for journey in self.journeys.values_mut() {
            let Some(mut requirements) = journey.wanted_requirements() else { continue };
            requirements.map.clone_from(&self.map);
            let salt = self.secret.announcement_salt(self.announced);
            self.announced += 1;
            let (terms, record) = (self.settings.terms(), self.record.clone());
            let request = Request { requirements, terms, policy, record };
            let account = self.ledger.account();
            journey.begin(Creator::new(now, account, self.secret.clone(), salt, request));
        }
    }

    /// Submits pending calls and handles the steps that were reached. Returns whether there were any.
    fn work(&mut self, now: Timestamp, actions: &mut Actions) -> bool {
        let mut closing = mem::take(&mut self.closing);
        let worked = self.with(now, actions, |journeys, hosting, ledger, domain_context| {
            let mut worked = hosting.work(ledger, domain_context);
            for journey in journeys.values_mut() {
                worked |= journey.work(ledger, domain_context);
            }
            for creator in &mut closing {
                for step in creator_steps(creator, ledger, domain_context.now) {
                    worked = true;
                    if let CreatorStep::Ended(outcome) = step {
                        domain_context.note(creator.id(), Step::Ended, format!("{outcome:?}"));
                        // The deposit that was not charged.
                        ledger.submit(domain_context.now, Call::Withdraw { to: ledger.account() });
                    }
                }
            }
            worked
        });
        closing.append(&mut self.closing);
        self.closing = closing;
        worked
    }
}

fn empty() -> cotorra_graph::HardwareGraph {
    cotorra_graph::HardwareGraph {
        domains: Vec::new(),
        nodes: Vec::new(),
        links: Vec::new(),
        wireless: BTreeMap::new(),
    }
}

impl Plugin for Federation {
    fn resume(&mut self, noted: Vec<Noted>) {
        self.noted = noted.into_iter().collect();
    }

    fn start(&mut self, now: Timestamp, testbed: &Testbed, actions: &mut Actions) {
        let graph = &testbed.graph;
        self.map.clone_from(&testbed.name);
        let takes_visitors = |border: &&cotorra_graph::Border| !border.visitors.is_empty();
        self.core = testbed.border.as_ref().filter(takes_visitors).map(|border| border.address);
        self.coverage = Coverage::of(graph, self.settings.edge);
        let units = graph.radio_units().filter_map(|(node, unit)| {
            let network = graph.wireless.get(&unit.network)?;
            let ours = Unit {
                ssid: unit.network.clone(),
                mobility_domain: network.mobility_domain,
                frequency_mhz: network.standard.frequency_mhz(unit.channel),
                on: unit.serving,
            };
            Some((node.id.clone(), ours))
        });
        self.units = units.collect();
        if self.settings.highest_price.is_some() {
            let journeys = graph.robots().filter_map(|(node, robot)| {
                let network = graph.wireless.get(&robot.network)?;
                let journey = Journey::new(
                    testbed.walk(&node.id)?.clone(),
                    robot.network.clone(),
                    network.mobility_domain,
                );
                Some((node.id.clone(), journey))
            });
            self.journeys = journeys.collect();
        }
        self.ledger.submit(now, Call::Register { name: self.name.clone() });
        self.turn(now, actions);
    }

    fn handle(&mut self, now: Timestamp, event: &Event, actions: &mut Actions) {
        if let Event::Vnf(life) = event
            && let Some(unit) = self.units.get_mut(&life.node)
            && life.vnf == AccessPoint::vnf(&life.node)
        {
            unit.on = life.state == VnfState::Started;
        }
        self.with(now, actions, |journeys, hosting, _, domain_context| {
            hosting.observe(event, domain_context);
            let others: Vec<_> = journeys
                .iter()
                .filter_map(|(robot, journey)| Some((robot.clone(), journey.attached_to()?.clone())))
                .collect();
            for (robot, journey) in journeys {
                journey.observe(robot, event, &others, domain_context);
            }
        });
        self.turn(now, actions);
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        let creators = self.journeys.values().filter_map(Journey::next_deadline);
        creators.chain(self.hosting.next_deadline()).chain(self.ledger.next_deadline()).min()
    }

    fn expire(&mut self, now: Timestamp, actions: &mut Actions) {
        self.turn(now, actions);
    }
}
