//! Error of opening a ledger or joining its network.

use std::time::Duration;

/// A ledger that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LedgerError {
    /// Real ledgers are not part of this build.
    #[error(
        "this cotorra knows only the modelled ledger: build it with `--features ethereum` for anvil and for Ethereum \
         networks"
    )]
    LeftOut,
    /// Virtual time supports only the modelled ledger.
    #[error("virtual time has only a modelled ledger: set `ledger: modelled`, or run it in real time")]
    VirtualTime,
    /// Domains set different block periods for one ledger.
    #[error(
        "a ledger has one block period: another domain's is {other:?}, this one's {this:?}; give all domains the same"
    )]
    Periods {
        /// Period of the domain that came first.
        other: Duration,
        /// Period of this domain.
        this: Duration,
    },
    /// A real ledger cannot be used.
    #[error("{0}")]
    Real(String),
}

#[cfg(feature = "ethereum")]
impl LedgerError {
    /// Wraps an error of a real ledger.
    pub(crate) fn real(reason: impl ToString) -> Self {
        Self::Real(reason.to_string())
    }
}
