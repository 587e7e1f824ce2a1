//! Prices of runs.

use cotorra_testbed::Bill;
use serde::{Deserialize, Serialize};

/// A price of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Price {
    /// What costs it: `everything`, `service …`, `link …` or `domain …`.
    pub of: String,
    /// The currency.
    pub currency: String,
    /// The price.
    pub price: f64,
    /// The same for each hour of the run.
    pub per_hour: f64,
}

impl Price {
    /// Returns the prices of a bill over that many hours: that of everything first.
    pub(super) fn all(bill: &Bill, hours: f64) -> Vec<Self> {
        let services = bill.services.iter().map(|its| (format!("service {}", its.service), its.taken.price));
        let links = bill.links.iter().map(|its| (format!("link {}", its.link), its.price));
        let domains = bill.domains.iter().map(|its| (format!("domain {}", its.domain), its.price));
        // With a single domain, it is paid everything.
        let domains = domains.filter(|_| bill.domains.len() > 1);
        let all = [("everything".to_owned(), bill.total_price)].into_iter().chain(services).chain(links);
        let per_hour = |price: f64| if hours > 0.0 { price / hours } else { 0.0 };
        let price =
            |(of, price)| Self { of, currency: bill.currency.clone(), price, per_hour: per_hour(price) };
        all.chain(domains).map(price).collect()
    }
}
