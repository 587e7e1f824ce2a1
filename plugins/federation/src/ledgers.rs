//! The ledgers of a run. State that domains share is created once, and ends with the run.

use std::time::Duration;

use cotorra_graph::{DomainId, Timestamp};
use cotorra_ledger::{Account, Deployment, Ledger, ModelledChain, Secret};
use sha3::{Digest, Keccak256};

use crate::{error::LedgerError, settings::LedgerChoice};

/// The ledgers of a run. It must outlive the run's orchestrators.
#[derive(Debug, Default)]
pub struct Ledgers {
    modelled: Option<(Duration, ModelledChain)>,
    virtual_time: bool,
    #[cfg(feature = "ethereum")]
    anvil: Option<crate::ethereum::Node>,
}

impl Ledgers {
    /// Makes the ledgers of a run in virtual time, which has only modelled ones.
    pub fn in_virtual_time() -> Self {
        Self { virtual_time: true, ..Self::default() }
    }

    /// Opens a domain's access to a ledger, and returns it with the secret that its keys derive from.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn open(
        &mut self,
        choice: &LedgerChoice,
        domain: &DomainId,
        seed: u64,
    ) -> Result<(Box<dyn Ledger>, Secret), LedgerError> {
        match choice {
            LedgerChoice::Modelled { block_period, outage } => {
                let chain = self.modelled(*block_period)?;
                let secret = modelled_secret(domain, seed, chain.deployment());
                let ledger = chain.ledger(account(domain));
                let ledger = match outage {
                    Some([from, until]) => {
                        ledger.with_outage(Timestamp::ZERO + *from..Timestamp::ZERO + *until)
                    }
                    None => ledger,
                };
                Ok((Box::new(ledger), secret))
            }
            _ if self.virtual_time => Err(LedgerError::VirtualTime),
            #[cfg(not(feature = "ethereum"))]
            LedgerChoice::Anvil { .. } | LedgerChoice::Ethereum(_) => Err(LedgerError::LeftOut),
            #[cfg(feature = "ethereum")]
            LedgerChoice::Anvil { block_period, program } => {
                let node = match self.anvil.take() {
                    Some(node) => node,
                    None => crate::ethereum::Node::start(*block_period, program.clone())?,
                };
                let node = self.anvil.insert(node);
                check_periods(node.block_period(), *block_period)?;
                node.open()
            }
            #[cfg(feature = "ethereum")]
            LedgerChoice::Ethereum(network) => crate::ethereum::open(network),
        }
    }

    fn modelled(&mut self, period: Duration) -> Result<&ModelledChain, LedgerError> {
        let (other, chain) = self.modelled.get_or_insert_with(|| (period, ModelledChain::new(period)));
        check_periods(*other, period)?;
        Ok(chain)
    }

    /// Returns the modelled chain, if a domain uses one.
    pub fn chain(&self) -> Option<&ModelledChain> {
        self.modelled.as_ref().map(|(_, chain)| chain)
    }
}

fn check_periods(other: Duration, this: Duration) -> Result<(), LedgerError> {
    if other == this { Ok(()) } else { Err(LedgerError::Periods { other, this }) }
}

/// Returns a domain's address on the modelled ledger.
fn account(domain: &DomainId) -> Account {
    let hash: [u8; 32] = Keccak256::digest(domain.as_str()).into();
    let mut account = Account::default();
    account.0.copy_from_slice(&hash[12..]);
    account
}

/// Returns a domain's secret on the modelled ledger. It need not be secret, because the model has no outsiders.
fn modelled_secret(domain: &DomainId, seed: u64, deployment: Deployment) -> Secret {
    let hash = Keccak256::new().chain_update(seed.to_be_bytes()).chain_update(domain.as_str());
    Secret::new(hash.finalize().into(), deployment)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn domain(name: &str) -> DomainId {
        name.parse().unwrap()
    }

    #[test]
    fn domains_share_a_chain_and_agree_on_its_period() {
        let mut ledgers = Ledgers::default();
        let modelled =
            |seconds| LedgerChoice::Modelled { block_period: Duration::from_secs(seconds), outage: None };
        let (one, _) = ledgers.open(&modelled(5), &domain("one"), 1).unwrap();
        let (two, _) = ledgers.open(&modelled(5), &domain("two"), 1).unwrap();
        assert_ne!(one.account(), two.account());
        let Err(refused) = ledgers.open(&modelled(2), &domain("three"), 1) else { panic!("two periods") };
        assert!(refused.to_string().contains("another domain's is 5s, this one's 2s"), "{refused}");
    }

    #[test]
    fn real_ledgers_are_refused_where_they_cannot_be() {
        let anvil = LedgerChoice::Anvil { block_period: Duration::from_secs(5), program: None };
        let refused = |ledgers: &mut Ledgers| match ledgers.open(&anvil, &domain("one"), 1) {
            Ok(_) => panic!("it was opened"),
            Err(refused) => refused.to_string(),
        };
        assert!(
            refused(&mut Ledgers::in_virtual_time()).starts_with("virtual time has only a modelled ledger")
        );
        #[cfg(not(feature = "ethereum"))]
        assert!(refused(&mut Ledgers::default()).contains("--features ethereum"));
    }
}
