//! The provider's role: answers announcements that one of the domain's radio units can serve, deploys the vAP of a
//! won service, and takes it down at the end.

use std::collections::BTreeMap;

use cotorra_graph::{
    AccessPoint, Decision, Event, FtKey, Instruction, NodeId, Position, Timestamp, VnfState,
};
use cotorra_ledger::{
    Account, Attachment, Call, Event as LedgerEvent, Ledger, Notice, Requirements, Secret, ServiceId, Wei,
    negotiation::{Offer, Provider, ProviderStep},
};

use crate::{
    context::{DomainContext, Unit},
    coverage::Coverage,
    settings::{Behaviour, Settings},
    steps::Step,
};

/// The services that the domain bids for or provides.
#[derive(Debug, Default)]
pub(crate) struct Hosting {
    services: Vec<Service>,
}

#[derive(Debug)]
struct Service {
    provider: Provider,
    /// Radio unit for the service.
    unit: NodeId,
    frequency_mhz: u16,
    ssid: String,
    mobility_domain: u16,
    vap: Vap,
    /// Whether the announcement was noted.
    noted: bool,
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
        let LedgerEvent::ServiceAnnounced { id, requirements, .. } = announced else { return };
        let Some(price) = settings.price.filter(|_| settings.behaviour != Behaviour::Silent) else { return };
        if self.services.iter().any(|service| service.provider.id() == *id) || requirements.map != map {
            return;
        }
        let Some((unit, serves)) = self.unit_for(requirements, units, coverage) else { return };
        let (endpoint, deploys_within) = (settings.endpoint.clone(), settings.deploy_within());
        let offer = Offer { price, endpoint, deploys_within };
        // A key that cannot be encrypted to is the creator's mistake, which nobody can be told about.
        let Ok(Some(provider)) = Provider::new(account, secret.clone(), announced, offer) else { return };
        self.services.push(Service {
            provider,
            unit: unit.clone(),
            frequency_mhz: serves.frequency_mhz,
            ssid: requirements.ssid.clone(),
            mobility_domain: requirements.mobility_domain,
            vap: Vap::None,
            noted: false,
        });
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
                    self.take_down(domain_context);
                    if charge > Wei(0) {
                        domain_context.note(self.id(), Step::Paid, charge.to_string());
                    }
                    // Also the bond.
                    ledger.submit(domain_context.now, Call::Withdraw { to: ledger.account() });
                }
                ProviderStep::Replaced => {
                    domain_context.note(self.id(), Step::Replaced, "");
                    self.take_down(domain_context);
                    ledger.submit(domain_context.now, Call::Withdraw { to: ledger.account() });
                }
                ProviderStep::Reclaimed => {
                    ledger.submit(domain_context.now, Call::Withdraw { to: ledger.account() });
                }
                ProviderStep::Overdue => self.take_down(domain_context),
                ProviderStep::Won
                | ProviderStep::BidPlaced
                | ProviderStep::Lost
                | ProviderStep::Deployed
                | ProviderStep::InUse => {}
            }
        }
        worked
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
