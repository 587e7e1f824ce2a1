//! The steps of a federation, which both domains note in the history under the service's name.

use std::fmt;

use cotorra_ledger::ServiceId;

macro_rules! steps {
    ($($(#[$doc:meta])* $step:ident = $name:literal,)*) => {
        /// A step of a federation.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Step { $($(#[$doc])* $step,)* }

        impl Step {
            /// All steps, in their order without failures.
            pub const ALL: [Self; [$(Self::$step),*].len()] = [$(Self::$step),*];

            /// Returns its name in notes.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$step => $name),* }
            }
        }
    };
}

steps! {
    /// The creator handed the announcement to the ledger.
    Announced = "announced",
    /// A provider that can serve the announcement received it.
    AnnouncementReceived = "announcement received",
    /// The provider handed its bid to the ledger.
    BidSent = "bid sent",
    /// The creator received an eligible bid.
    BidReceived = "bid received",
    /// The creator received an ineligible bid.
    BidRejected = "bid rejected",
    /// The creator handed its choice to the ledger.
    WinnerChosen = "winner chosen",
    /// The provider was notified that it won.
    WinnerReceived = "winner received",
    /// The provider began to deploy the vAP.
    DeploymentStarted = "deployment started",
    /// The vAP sends beacons.
    DeploymentFinished = "deployment finished",
    /// The vAP could not be deployed.
    DeploymentFailed = "deployment failed",
    /// The provider handed the confirmation to the ledger.
    ConfirmationSent = "confirmation sent",
    /// The creator received the confirmation, with the data needed to attach.
    ConfirmationReceived = "confirmation received",
    /// The robot is attached to the vAP.
    Attached = "attached",
    /// The creator's radio unit is off: a(R) = {}.
    OwnRadioUnitReleased = "own radio unit released",
    /// The acceptance is on the chain: use is charged.
    InUse = "in use",
    /// The robot is attached to its own domain again.
    Returned = "returned",
    /// The service failed.
    Failed = "failed",
    /// The robot was halted before leaving coverage.
    Halted = "halted",
    /// The robot continues.
    WentOn = "went on",
    /// The service has ended on the chain.
    Ended = "ended",
    /// The creator chose another provider, because the first was late or could not be attached to.
    Replaced = "replaced",
    /// The provider took the vAP down: a(R) = {}.
    TakenDown = "taken down",
    /// The provider learned the payment for the use.
    Paid = "paid",
}

impl Step {
    /// Whether a service has this step once with the same detail, however often its orchestrator is restarted.
    pub(crate) const fn is_reached_once(self) -> bool {
        !matches!(self, Self::Halted | Self::WentOn)
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Returns the name of a service in notes: `service-` and the first eight bytes of its ID.
pub(crate) fn process(id: ServiceId) -> String {
    id.0[..8].iter().fold("service-".to_owned(), |name, byte| name + &format!("{byte:02x}"))
}
