//! What runs spent: prices and energies.

use cotorra_testbed::Summary;
use serde::{Deserialize, Serialize};

/// A price or an energy of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spent {
    /// What spent it: `everything`, `service …`, `server …`, `robot …`, `link …`, `domain …` or `energy`.
    pub of: String,
    /// The currency, or `Wh`.
    #[serde(alias = "currency")]
    pub unit: String,
    /// The amount.
    #[serde(alias = "price")]
    pub amount: f64,
    /// The same for each hour of the run: of an energy, the mean power in watts.
    pub per_hour: f64,
}

impl Spent {
    /// Returns the prices of a run, that of everything first; none without a currency.
    pub fn prices(summary: &Summary) -> Vec<Self> {
        let Some(bill) = &summary.bill else { return Vec::new() };
        let services = bill.services.iter().map(|its| (format!("service {}", its.service), its.taken.price));
        let links = bill.links.iter().map(|its| (format!("link {}", its.link), its.price));
        let energy = (!bill.energy.is_empty()).then(|| bill.energy.iter().map(|its| its.price).sum());
        let energy = energy.map(|price| ("energy".to_owned(), price));
        let domains = bill.domains.iter().map(|its| (its.domain.as_str(), its.price));
        let all = services.chain(links).chain(energy).chain(by_domain(domains.collect()));
        Self::all(summary, &bill.currency, bill.total_price, all)
    }

    /// Returns the energies of a run, that of everything first; none if no node has a power. Those of services that are not known
    /// are left out.
    pub fn energies(summary: &Summary) -> Vec<Self> {
        let Some(energy) = &summary.energy else { return Vec::new() };
        let services = energy.services.iter();
        let services = services.filter_map(|its| Some((format!("service {}", its.service), its.energy_wh?)));
        let servers = energy.servers.iter().map(|its| (format!("server {}", its.server), its.energy_wh));
        let robots = energy.robots.iter().map(|its| (format!("robot {}", its.robot), its.energy_wh));
        let domains = energy.domains.iter().map(|its| (its.domain.as_str(), its.energy_wh));
        let all = servers.chain(by_domain(domains.collect())).chain(services).chain(robots);
        Self::all(summary, "Wh", energy.total_energy_wh, all)
    }

    /// Returns the currency, or `W`: watt hours per hour are watts.
    pub fn unit_per_hour(&self) -> &str {
        unit_per_hour(&self.unit)
    }

    fn all(
        summary: &Summary,
        unit: &str,
        total: f64,
        parts: impl Iterator<Item = (String, f64)>,
    ) -> Vec<Self> {
        let hours = summary.duration_ms / 3_600_000.0;
        let per_hour = |amount: f64| if hours > 0.0 { amount / hours } else { 0.0 };
        let spent = |(of, amount)| Self { of, unit: unit.to_owned(), amount, per_hour: per_hour(amount) };
        [("everything".to_owned(), total)].into_iter().chain(parts).map(spent).collect()
    }
}

pub(super) fn unit_per_hour(unit: &str) -> &str {
    if unit == "Wh" { "W" } else { unit }
}

/// Returns what domains spent. A single one spends everything.
fn by_domain(domains: Vec<(&str, f64)>) -> impl Iterator<Item = (String, f64)> {
    let several = domains.len() > 1;
    domains.into_iter().filter(move |_| several).map(|(domain, amount)| (format!("domain {domain}"), amount))
}
