//! The error of everything that opens a ledger.

use std::time::Duration;

/// A ledger that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LedgerError {
    /// Real ledgers are left out of this build.
    #[error(
        "this cotorra knows only the modelled ledger: build it with `--features ethereum` for anvil and for Ethereum \
         networks"
    )]
    LeftOut,
    /// Real ledgers have real time.
    #[error("virtual time has only a modelled ledger: set `ledger: modelled`, or run it in real time")]
    VirtualTime,
    /// A ledger with two periods.
    #[error(
        "a ledger has one block period: another domain's is {other:?}, this one's {this:?}; give all domains the same"
    )]
    Periods {
        /// Of the domain that came first.
        other: Duration,
        /// Of this one.
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
