//! Radio units that a service covers.

use cotorra_graph::DomainId;

/// Radio units covered by a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Scope {
    /// The whole testbed.
    Testbed,
    /// One domain's, with the stations associated with them.
    Domain(DomainId),
}

impl Scope {
    /// Whether it covers a domain.
    pub fn covers(&self, domain: &DomainId) -> bool {
        match self {
            Self::Testbed => true,
            Self::Domain(own) => own == domain,
        }
    }
}
