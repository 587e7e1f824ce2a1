//! Tasks of a run's real Wi-Fi software.

use cotorra_graph::Testbed;
use cotorra_wifi::DomainKey;

use crate::{
    error::RunError,
    wifi::{Plan, WifiError, check_programs},
};

/// Returns what the Wi-Fi software of a testbed is to do; `None` if it needs none.
///
/// # Errors
/// [`RunError::Wifi`] if the programs are not installed, or cannot serve the testbed.
pub(super) fn plan(testbed: &Testbed) -> Result<Option<Plan>, RunError> {
    let plan = Plan::new(&testbed.graph, &domain_key()).map_err(WifiError::from)?;
    if plan.is_some() {
        check_programs()?;
    }
    Ok(plan)
}

/// Returns a key of mobility domains, for this run alone.
pub(super) fn domain_key() -> DomainKey {
    let mut key = [0; 32];
    getrandom::fill(&mut key).expect("the system has random numbers");
    DomainKey::new(key)
}
