//! The steps of a federation, as they are noted in the history, by both domains under the service's name.

use std::fmt;

use cotorra_ledger::ServiceId;

macro_rules! steps {
    ($($(#[$doc:meta])* $step:ident = $name:literal,)*) => {
        /// A step of a federation.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Step { $($(#[$doc])* $step,)* }

        impl Step {
            /// All of them, in the order in which they come where nothing goes wrong.
            pub const ALL: [Self; [$(Self::$step),*].len()] = [$(Self::$step),*];

            /// Its name in notes.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$step => $name),* }
            }
        }
    };
}

steps! {
    /// The creator handed the announcement to the ledger.
    Announced = "announced",
    /// A provider heard it that can serve it.
    AnnouncementReceived = "announcement received",
    /// The provider handed its bid to the ledger.
    BidSent = "bid sent",
    /// The creator heard a bid that can be chosen.
    BidReceived = "bid received",
    /// The creator heard a bid that cannot be chosen.
    BidRejected = "bid rejected",
    /// The creator handed its choice to the ledger.
    WinnerChosen = "winner chosen",
    /// The provider heard that it won.
    WinnerReceived = "winner received",
    /// The provider began to deploy the vAP.
    DeploymentStarted = "deployment started",
    /// The vAP beacons.
    DeploymentFinished = "deployment finished",
    /// The vAP could not be deployed.
    DeploymentFailed = "deployment failed",
    /// The provider handed the confirmation to the ledger.
    ConfirmationSent = "confirmation sent",
    /// The creator heard it, with what is needed to attach.
    ConfirmationReceived = "confirmation received",
    /// The robot is attached to the vAP.
    Attached = "attached",
    /// The creator's radio unit is off: a(R) = {}.
    OwnRadioUnitReleased = "own radio unit released",
    /// The acceptance is on the chain: use is charged.
    InUse = "in use",
    /// The robot is attached to its own domain again.
    Returned = "returned",
    /// It came to nothing.
    Failed = "failed",
    /// The robot was halted, before it leaves coverage.
    Halted = "halted",
    /// The robot goes on.
    WentOn = "went on",
    /// The service is over on the chain.
    Ended = "ended",
    /// The creator chose another in the provider's place, for it was late or could not be attached to.
    Replaced = "replaced",
    /// The provider took the vAP down: a(R) = {}.
    TakenDown = "taken down",
    /// The provider heard what the use is paid with.
    Paid = "paid",
}

impl Step {
    /// Whether a service has it once with the same detail, however often its orchestrator is started.
    pub(crate) const fn is_reached_once(self) -> bool {
        !matches!(self, Self::Halted | Self::WentOn)
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// What a service is called in notes: `service-` and its id's first eight bytes.
pub(crate) fn process(id: ServiceId) -> String {
    id.0[..8].iter().fold("service-".to_owned(), |name, byte| name + &format!("{byte:02x}"))
}
