//! Consumers of the service, and what each of them may use.

use cotorra_graph::{DomainId, Reservations, VnfId};

/// A consumer of the service, and the owner of allocations.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Consumer {
    /// The operator of the testbed.
    Operator,
    /// The orchestrator of a domain.
    Domain(DomainId),
    /// An application of a domain.
    Application(DomainId, VnfId),
}

impl Consumer {
    /// Whether it sees the allocations of an owner. The operator sees all, a domain its own and those of its applications, and
    /// an application its own.
    pub(crate) fn sees(&self, owner: &Self) -> bool {
        match self {
            Self::Operator => true,
            Self::Domain(own) => owner.domain() == Some(own),
            Self::Application(..) => self == owner,
        }
    }

    /// Returns the domain that its allocations count for; `None` for the operator's.
    pub(crate) fn domain(&self) -> Option<&DomainId> {
        match self {
            Self::Operator => None,
            Self::Domain(domain) | Self::Application(domain, _) => Some(domain),
        }
    }

    /// Returns the application that it is.
    pub(crate) fn application(&self) -> Option<&VnfId> {
        match self {
            Self::Application(_, application) => Some(application),
            Self::Operator | Self::Domain(_) => None,
        }
    }

    /// Returns how links keep its allocations. The packets between two nodes may be those of several applications, and none
    /// may slow another's.
    pub(crate) fn kept(&self) -> Reservations {
        match self {
            Self::Application(..) => Reservations::Guaranteed,
            Self::Operator | Self::Domain(_) => Reservations::Limited,
        }
    }
}
