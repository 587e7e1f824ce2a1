//! The provider's role: answers announcements that one of the domain's radio units can serve, deploys the vAP of a
//! won service, and takes it down at the end.

use std::{collections::BTreeMap, mem};

use cotorra_graph::{
    AccessPoint, Decision, Event, FtKey, Instruction, NodeId, Position, Timestamp, VnfState,
};
use cotorra_ledger::{
    Account, Attachment, Call, Event as LedgerEvent, Ledger, Notice, Requirements, Secret, ServiceId, Wei,
    negotiation::{Offer, Provider, ProviderStep},
};
use cotorra_plugin::coverage::Coverage;

use crate::{
    context::{DomainContext, Unit},
    settings::{Behaviour, Settings},
    steps::Step,
};

/// Most services that the domain bids for at a time.
const MOST_SERVICES: usize = 128;
/// Most of these of one creator.
const MOST_OF_CREATOR: usize = 32;
/// Number of deployments in a row that a creator may leave without acceptance before the domain bids for none of it any more.
const MOST_UNACCEPTED: u32 = 3;
/// Most creators that are remembered for that.
const MOST_REMEMBERED: usize = 1000;

/// The services that the domain bids for or provides.
#[derive(Debug, Default)]
pub(crate) struct Hosting {
    services: Vec<Service>,
    /// Number of the last deployments in a row that each creator did not accept. It follows from the chain, so that a restart
    /// forgets nothing.
    unaccepted: BTreeMap<Account, u32>,
}

#[derive(Debug)]
struct Service {
    provider: Provider,
    creator: Account,
    acceptance: Acceptance,
    /// Radio unit for the service.
    unit: NodeId,
    frequency_mhz: u16,
    ssid: String,
    mobility_domain: u16,
    vap: Vap,
    /// Whether the announcement was noted.
    noted: bool,
}

/// Outcome of a deployment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Acceptance {
    /// There is none on the chain.
    None,
    Awaited,
    Given,
    /// The service ended, or went to another, without it.
    Denied,
    /// It is remembered.
    Noted,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Vap {
    None,
    Deploying,
    Deployed,
}

impl Hosting {
    /// Bids for an announced service if a radio unit can serve it.
    #[allow(clippy::too_many_arguments, reason = "a bid depends on state from the whole domain")]
    pub(crate) fn consider(
        &mut self,
        announced: &LedgerEvent,
        account: Account,
        secret: &Secret,
        settings: &Settings,
        map: &str,
        units: &BTreeMap<NodeId, Unit>,
        coverage: &Coverage,
    ) {
        let LedgerEvent::ServiceAnnounced { id, creator, requirements, .. } = announced else { return };
        let Some(price) = settings.price.filter(|_| settings.behaviour != Behaviour::Silent) else { return };
        if self.services.iter().any(|service| service.provider.id() == *id) || requirements.map != map {
            return;
        }
        if !self.takes(*creator) {
            return;
        }
        let Some((unit, serves)) = self.unit_for(requirements, units, coverage) else { return };
        let (endpoint, deploys_within) = (settings.endpoint.clone(), settings.deploy_within());
        let offer = Offer { price, endpoint, deploys_within, accepted_within: settings.accepted_within() };
        // A key that cannot be encrypted to is the creator's mistake, which cannot be reported to it.
        let Ok(Some(provider)) = Provider::new(account, secret.clone(), announced, offer) else { return };
        self.services.push(Service {
            provider,
            creator: *creator,
            acceptance: Acceptance::None,
            unit: unit.clone(),
            frequency_mhz: serves.frequency_mhz,
            ssid: requirements.ssid.clone(),
            mobility_domain: requirements.mobility_domain,
            vap: Vap::None,
            noted: false,
        });
    }

    /// Whether there is room for a service of a creator that accepts what is deployed for it.
    fn takes(&self, creator: Account) -> bool {
        let of_it = self.services.iter().filter(|service| service.creator == creator).count();
        self.services.len() < MOST_SERVICES
            && of_it < MOST_OF_CREATOR
            && self.unaccepted.get(&creator).is_none_or(|unaccepted| *unaccepted < MOST_UNACCEPTED)
    }

    /// Remembers whether creators accepted.
    fn remember(&mut self) {
        for service in &mut self.services {
            match mem::replace(&mut service.acceptance, Acceptance::Noted) {
                Acceptance::Given => drop(self.unaccepted.remove(&service.creator)),
                Acceptance::Denied => {
                    if self.unaccepted.len() >= MOST_REMEMBERED
                        && !self.unaccepted.contains_key(&service.creator)
                    {
                        self.unaccepted.pop_first();
                    }
                    *self.unaccepted.entry(service.creator).or_default() += 1;
                }
                other => service.acceptance = other,
            }
        }
    }

    /// Returns the radio unit that serves these requirements best, among those that are off and not promised.
    fn unit_for<'a>(
        &self,
        wanted: &Requirements,
        units: &'a BTreeMap<NodeId, Unit>,
        coverage: &Coverage,
    ) -> Option<(&'a NodeId, &'a Unit)> {
        let metres = |mm: i32| f64::from(mm) / 1e3;
        let (at, radius) =
            (Position::new(metres(wanted.x_mm), metres(wanted.y_mm)), f64::from(wanted.radius_mm) / 1e3);
        let fits = |(id, unit): &(&NodeId, &Unit)| {
            wanted.vnf == "vAP"
                && !unit.on
                && unit.ssid == wanted.ssid
                && (wanted.frequency_mhz == 0 || wanted.frequency_mhz == unit.frequency_mhz)
                && self.services.iter().all(|service| service.unit != **id || service.vap == Vap::None)
        };
        let signal = |id: &NodeId| coverage.weakest_around(id, at, radius).map(|signal| signal.0);
        let strong = units.iter().filter(fits).filter_map(|(id, unit)| Some((signal(id)?, id, unit)));
        let strong = strong.filter(|(signal, ..)| *signal >= f64::from(wanted.signal_dbm));
        strong.max_by(|(a, ..), (b, ..)| a.total_cmp(b)).map(|(_, id, unit)| (id, unit))
    }

    /// Handles a notice from the ledger.
    pub(crate) fn handle_notice(&mut self, now: Timestamp, notice: &Notice) {
        self.services.iter_mut().for_each(|service| service.provider.handle(now, notice));
    }

    pub(crate) fn next_deadline(&self) -> Option<Timestamp> {
        self.services.iter().filter_map(|service| service.provider.next_deadline()).min()
    }

    /// Handles an event of the domain.
    pub(crate) fn observe(&mut self, event: &Event, domain_context: &mut DomainContext<'_>) {
        match event {
            Event::Vnf(life) => {
                let deploying = |service: &&mut Service| {
                    service.vap == Vap::Deploying && AccessPoint::vnf(&service.unit) == life.vnf
                };
                let Some(service) = self.services.iter_mut().find(deploying) else { return };
                match life.state {
                    VnfState::Started => service.deployed(domain_context),
                    VnfState::Failed => {
                        service.failed(life.detail.as_deref().unwrap_or_default(), domain_context)
                    }
                    VnfState::Stopped | VnfState::Died => {}
                }
            }
            Event::Decision(Decision {
                instruction: Instruction::Deploy { radio_unit, .. },
                refused: Some(reason),
                ..
            }) => {
                let deploying =
                    |service: &&mut Service| service.vap == Vap::Deploying && service.unit == *radio_unit;
                if let Some(service) = self.services.iter_mut().find(deploying) {
                    service.failed(reason, domain_context);
                }
            }
            _ => {}
        }
    }

    /// Submits pending calls and handles the steps that were reached. Returns whether there were any.
    pub(crate) fn work(&mut self, ledger: &mut dyn Ledger, domain_context: &mut DomainContext<'_>) -> bool {
        let mut worked = false;
        let mut taken: Vec<NodeId> =
            self.services.iter().filter(|s| s.vap != Vap::None).map(|s| s.unit.clone()).collect();
        for service in &mut self.services {
            worked |= service.work(ledger, &mut taken, domain_context);
        }
        self.remember();
        self.services.retain(|service| service.vap != Vap::None || !service.provider.is_over());
        worked
    }
}

impl Service {
    fn id(&self) -> ServiceId {
        self.provider.id()
    }

    fn work(
        &mut self,
        ledger: &mut dyn Ledger,
        taken: &mut Vec<NodeId>,
        domain_context: &mut DomainContext<'_>,
    ) -> bool {
        if !std::mem::replace(&mut self.noted, true) && !self.provider.is_over() {
            domain_context.note(self.id(), Step::AnnouncementReceived, "");
        }
        if self.provider.next_deadline().is_some_and(|deadline| deadline <= domain_context.now) {
            self.provider.expire(domain_context.now);
        }
        // A service whose attachment cannot be sealed is given back automatically.
        let _ = self.provider.submit(domain_context.now, ledger);
        let mut worked = false;
        while let Some(step) = self.provider.poll_step() {
            worked = true;
            match step {
                ProviderStep::Bidding => domain_context.note(self.id(), Step::BidSent, ""),
                ProviderStep::Won if self.provider.is_winner() => self.won(taken, domain_context),
                ProviderStep::Confirming => domain_context.note(self.id(), Step::ConfirmationSent, ""),
                ProviderStep::Ended { charge, .. } => {
                    self.unaccepted();
                    self.take_down(domain_context);
                    if charge > Wei(0) {
                        domain_context.note(self.id(), Step::Paid, charge.to_string());
                    }
                    // Also the bond.
                    ledger.submit(domain_context.now, Call::Withdraw { to: ledger.account() });
                }
                ProviderStep::Replaced => {
                    self.unaccepted();
                    domain_context.note(self.id(), Step::Replaced, "");
                    self.take_down(domain_context);
                    ledger.submit(domain_context.now, Call::Withdraw { to: ledger.account() });
                }
                ProviderStep::Reclaimed => {
                    ledger.submit(domain_context.now, Call::Withdraw { to: ledger.account() });
                }
                ProviderStep::Overdue => self.take_down(domain_context),
                ProviderStep::Deployed if self.acceptance == Acceptance::None => {
                    self.acceptance = Acceptance::Awaited;
                }
                ProviderStep::InUse => self.acceptance = Acceptance::Given,
                ProviderStep::Won | ProviderStep::BidPlaced | ProviderStep::Lost | ProviderStep::Deployed => {
                }
            }
        }
        worked
    }

    /// Records that the deployment is not wanted any more, accepted or not.
    fn unaccepted(&mut self) {
        if self.acceptance == Acceptance::Awaited {
            self.acceptance = Acceptance::Denied;
        }
    }

    fn won(&mut self, taken: &mut Vec<NodeId>, domain_context: &mut DomainContext<'_>) {
        // The chain retracted its choice and made it again.
        if self.vap != Vap::None {
            return;
        }
        domain_context.note(self.id(), Step::WinnerReceived, "");
        match domain_context.settings.behaviour {
            Behaviour::Idle | Behaviour::Silent => return,
            Behaviour::Lying => return self.confirm(domain_context),
            Behaviour::Honest => {}
        }
        if taken.contains(&self.unit) {
            return self.failed("its radio unit serves another by now", domain_context);
        }
        taken.push(self.unit.clone());
        self.vap = Vap::Deploying;
        let access_point = AccessPoint {
            ssid: self.ssid.clone(),
            mobility_domain: self.mobility_domain,
            key: Some(FtKey(domain_context.secret.ft_key(self.id()))),
            core: None,
        };
        domain_context.note(self.id(), Step::DeploymentStarted, format!("a({}) = {{vAP}}", self.unit));
        domain_context.actions.instruct(Instruction::Deploy { radio_unit: self.unit.clone(), access_point });
    }

    fn deployed(&mut self, domain_context: &mut DomainContext<'_>) {
        self.vap = Vap::Deployed;
        domain_context.note(self.id(), Step::DeploymentFinished, "");
        self.confirm(domain_context);
    }

    fn confirm(&mut self, domain_context: &DomainContext<'_>) {
        let key = domain_context.secret.ft_key(self.id());
        let [a, b, c, d, e, ..] = self.id().0;
        self.provider.deployed(Attachment {
            radio_unit: self.unit.to_string(),
            ssid: self.ssid.clone(),
            // A virtual access point has its own address: locally administered, and one for each service.
            bssid: [0x02, a, b, c, d, e],
            frequency_mhz: self.frequency_mhz,
            pmk_r1: key,
            core: domain_context.core,
        });
    }

    fn failed(&mut self, reason: &str, domain_context: &mut DomainContext<'_>) {
        self.vap = Vap::None;
        domain_context.note(self.id(), Step::DeploymentFailed, reason);
        self.provider.give_back();
    }

    fn take_down(&mut self, domain_context: &mut DomainContext<'_>) {
        if std::mem::replace(&mut self.vap, Vap::None) != Vap::None {
            domain_context.actions.instruct(Instruction::Remove { radio_unit: self.unit.clone() });
            domain_context.note(self.id(), Step::TakenDown, format!("a({}) = {{}}", self.unit));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_ledger::{ChainTime, Deployment, Price, Salt, Terms};

    use super::*;

    const TESTBED: &str = "
name: edge
wireless: { lab: {} }
nodes:
  A: { kind: radio_unit, position: [0, 0], channel: 1, serving: false }
";

    /// An announcement of a creator that waits so long with its acceptance.
    fn announced(creator: u8, number: u8, accept_within: u32) -> LedgerEvent {
        let mut id = [creator; 32];
        id[0] = number;
        let secret = Secret::new([creator; 32], Deployment::default());
        LedgerEvent::ServiceAnnounced {
            id: ServiceId(id),
            creator: Account([creator; 20]),
            key: secret.public_key(Salt([number; 32])),
            requirements: Requirements {
                vnf: "vAP".to_owned(),
                map: "edge".to_owned(),
                x_mm: 1000,
                y_mm: 0,
                radius_mm: 1000,
                ssid: "lab".to_owned(),
                mobility_domain: 1,
                frequency_mhz: 0,
                width_mhz: 20,
                signal_dbm: -70,
            },
            terms: Terms { open_for: 60, deploy_within: 30, accept_within, use_for: 600, bond: 0 },
            deadline: ChainTime(60),
        }
    }

    /// Lets a provider hear of announcements. Returns the number of its services.
    fn considered(hosting: &mut Hosting, announcements: impl IntoIterator<Item = LedgerEvent>) -> usize {
        let testbed = cotorra_testbed_file::parse("test", TESTBED, Path::new("")).unwrap();
        let settings = Settings { price: Price::new(100), ..Settings::default() };
        let coverage = Coverage::of(&testbed.graph, settings.edge);
        let unit = Unit { ssid: "lab".to_owned(), mobility_domain: 1, frequency_mhz: 2412, on: false };
        let units = BTreeMap::from([("A".parse().unwrap(), unit)]);
        let (own, secret) = (Account([0; 20]), Secret::new([0; 32], Deployment::default()));
        for announced in announcements {
            hosting.consider(&announced, own, &secret, &settings, "edge", &units, &coverage);
        }
        hosting.services.len()
    }

    #[test]
    fn creators_choose_no_wait_beyond_the_settings() {
        assert_eq!(considered(&mut Hosting::default(), [announced(1, 1, 120)]), 1);
        assert_eq!(considered(&mut Hosting::default(), [announced(1, 1, 121), announced(1, 2, 3500)]), 0);
    }

    #[test]
    fn no_creator_fills_the_services_of_a_provider() {
        let mut hosting = Hosting::default();
        let flood = (0..200).map(|number| announced(1, number, 60));
        assert_eq!(considered(&mut hosting, flood), MOST_OF_CREATOR);
        assert_eq!(considered(&mut hosting, [announced(2, 1, 60)]), MOST_OF_CREATOR + 1);
        let others = (3..10).flat_map(|creator| (0..200).map(move |number| announced(creator, number, 60)));
        assert_eq!(considered(&mut hosting, others), MOST_SERVICES);
    }

    #[test]
    fn creators_that_accept_nothing_get_no_more_bids() {
        let mut hosting = Hosting::default();
        let mut ends = |number: u8, is_accepted: bool| {
            let before = considered(&mut hosting, [announced(1, number, 60)]);
            if let Some(service) = hosting.services.first_mut() {
                service.acceptance = if is_accepted { Acceptance::Given } else { Acceptance::Awaited };
                service.unaccepted();
            }
            hosting.remember();
            hosting.services.clear();
            before == 1
        };
        assert!(ends(1, false) && ends(2, false) && ends(3, true), "it accepted the third");
        assert!(ends(4, false) && ends(5, false) && ends(6, false));
        assert!(!ends(7, true), "it accepted none of the last three");
        assert_eq!(considered(&mut hosting, [announced(2, 1, 60)]), 1, "another creator");
    }
}
