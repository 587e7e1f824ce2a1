//! Calls to the contract, and its events and errors, as in `contracts/Federation.sol`.

use crate::values::{Account, ChainTime, Commitment, Price, PublicKey, Salt, ServiceId, Wei};

/// Longest sealed message, bytes.
pub const MAX_SEALED: usize = 1024;
/// Longest name of an operator, a VNF or a map, bytes.
pub const MAX_NAME: usize = 64;
/// Longest SSID, bytes (IEEE 802.11-2020, 9.4.2.2).
pub const MAX_SSID: usize = 32;

/// Requirements of a creator: the VNF, its place, and its radio.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Requirements {
    /// The VNF to deploy, such as `vAP`.
    pub vnf: String,
    /// The frame of positions.
    pub map: String,
    /// x of the place, millimetres in that frame.
    pub x_mm: i32,
    /// y of the place, millimetres in that frame.
    pub y_mm: i32,
    /// Radius to cover around the place, millimetres.
    pub radius_mm: u32,
    /// Name of the network.
    pub ssid: String,
    /// Mobility domain of fast transition (IEEE 802.11r), as in the beacon.
    pub mobility_domain: u16,
    /// Frequency of the channel's centre, MHz; 0 leaves it to the provider.
    pub frequency_mhz: u16,
    /// Width of the channel, MHz; 0 leaves it to the provider.
    pub width_mhz: u16,
    /// Least signal at the place, dBm.
    pub signal_dbm: i16,
}

/// The longest duration of each step, in seconds of the chain, over zero; and the bond.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Terms {
    /// Time for bids, and for each choice among them.
    pub open_for: u32,
    /// Time from the choice to the deployment.
    pub deploy_within: u32,
    /// Time from the deployment to the acceptance.
    pub accept_within: u32,
    /// Longest use from the deployment on; the deposit pays for all of it.
    pub use_for: u32,
    /// Bond of each bid, wei. A chosen provider that does not deploy in time loses it to the creator.
    pub bond: u64,
}

impl Terms {
    /// Returns the bond of a bid.
    pub fn bond(&self) -> Wei {
        Wei(self.bond.into())
    }
}

/// A call of the contract.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Call {
    /// Registers the caller as an operator.
    Register {
        /// The operator's name, 1 to [`MAX_NAME`] bytes.
        name: String,
    },
    /// Announces a service, open for bids.
    Announce {
        /// Salt of the service's ID.
        salt: Salt,
        /// The one-time key that bids and the attachment are sealed to.
        key: PublicKey,
        requirements: Requirements,
        terms: Terms,
    },
    /// Bids for a service.
    Bid {
        id: ServiceId,
        /// Commitment to the price.
        commitment: Commitment,
        /// Price, salt and endpoint, sealed.
        sealed: Vec<u8>,
        /// The bond of the terms.
        bond: Wei,
    },
    /// The creator chooses a bid, and deposits the cost of the longest use. It may choose another if the winner is
    /// late or its deployment cannot be used.
    Choose {
        id: ServiceId,
        provider: Account,
        /// The price that the bid commits to.
        price: Price,
        /// The salt that the bid commits with.
        salt: Salt,
        /// `price` times the terms' `use_for`.
        deposit: Wei,
    },
    /// The winner confirms that the service runs.
    Deploy {
        id: ServiceId,
        /// The data needed to attach, sealed.
        sealed: Vec<u8>,
    },
    /// The creator has attached, and agrees to pay.
    Accept { id: ServiceId },
    /// The creator cancels a service that it has not accepted.
    Cancel { id: ServiceId },
    /// The winner declines a service that was not accepted.
    Decline { id: ServiceId },
    /// Either party ends the use of a service, which is charged until then.
    Release { id: ServiceId },
    /// Anyone ends a service whose deadline has passed.
    Expire { id: ServiceId },
    /// A bidder that was not chosen reclaims its bond, once the time to choose is over.
    Reclaim { id: ServiceId },
    /// Pays out the caller's balance.
    Withdraw {
        /// The receiver. A contract that cannot receive money names another address.
        to: Account,
    },
}

impl Call {
    /// Returns the money sent with the call.
    pub fn value(&self) -> Wei {
        match self {
            Self::Choose { deposit, .. } => *deposit,
            Self::Bid { bond, .. } => *bond,
            _ => Wei(0),
        }
    }
}

/// State of a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// Not announced.
    None,
    /// Accepts bids.
    Open,
    /// A winner was chosen, and deploys.
    Closed,
    /// The winner has confirmed the deployment.
    Deployed,
    /// The creator has accepted; use is charged.
    InUse,
    /// Ended, for whatever reason.
    Ended,
}

/// Outcome of a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// The creator cancelled it.
    Cancelled,
    /// The winner declined it.
    Declined,
    /// No bidder was chosen in time.
    NoWinner,
    /// The winner did not deploy in time.
    NotDeployed,
    /// The creator did not accept in time.
    NotAccepted,
    /// One of the parties ended its use.
    Released,
    /// It was used for as long as was paid.
    Completed,
}

/// A public event of the contract.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// A new operator registered.
    OperatorRegistered { operator: Account, name: String },
    /// A service is open for bids.
    ServiceAnnounced {
        id: ServiceId,
        creator: Account,
        /// The key to seal bids and the attachment to.
        key: PublicKey,
        requirements: Requirements,
        terms: Terms,
        /// Deadline for bids and the choice.
        deadline: ChainTime,
    },
    /// A bid was placed.
    BidPlaced {
        id: ServiceId,
        provider: Account,
        /// Commitment to the price.
        commitment: Commitment,
        /// Price, salt and endpoint, sealed.
        sealed: Vec<u8>,
    },
    /// A bid was chosen.
    ProviderChosen {
        id: ServiceId,
        provider: Account,
        price: Price,
        /// Number of choices so far, including this one.
        choice: u32,
        /// Deadline for the deployment.
        deadline: ChainTime,
    },
    /// The winner confirmed the deployment.
    ServiceDeployed {
        id: ServiceId,
        /// The winner.
        provider: Account,
        /// The data needed to attach, sealed.
        sealed: Vec<u8>,
        /// Deadline for the acceptance.
        deadline: ChainTime,
    },
    /// The creator accepted.
    ServiceAccepted {
        id: ServiceId,
        /// The winner.
        provider: Account,
        /// End of the paid use.
        deadline: ChainTime,
    },
    /// The winner declined or was late: another can be chosen.
    ServiceReopened {
        id: ServiceId,
        /// The former winner.
        provider: Account,
        /// Deadline for the choice.
        deadline: ChainTime,
    },
    /// A bidder that was not chosen has reclaimed its bond.
    BondReclaimed { id: ServiceId, provider: Account, bond: Wei },
    /// A service has ended.
    ServiceEnded {
        id: ServiceId,
        /// The winner; all zero if there was none.
        provider: Account,
        outcome: Outcome,
        /// The provider's earnings.
        charge: Wei,
    },
    /// An operator was paid.
    Withdrawn {
        operator: Account,
        /// The receiver that it named.
        to: Account,
        amount: Wei,
    },
}

impl Event {
    /// Returns the service that the event belongs to.
    pub fn service(&self) -> Option<ServiceId> {
        match self {
            Self::OperatorRegistered { .. } | Self::Withdrawn { .. } => None,
            Self::ServiceAnnounced { id, .. }
            | Self::BidPlaced { id, .. }
            | Self::ProviderChosen { id, .. }
            | Self::ServiceDeployed { id, .. }
            | Self::ServiceAccepted { id, .. }
            | Self::ServiceReopened { id, .. }
            | Self::BondReclaimed { id, .. }
            | Self::ServiceEnded { id, .. } => Some(*id),
        }
    }
}

/// Reason for which the contract rejects a call.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ContractError {
    /// The caller is not an operator.
    #[error("the caller is not registered as an operator")]
    NotRegistered,
    /// The caller is an operator already.
    #[error("the caller is registered already")]
    AlreadyRegistered,
    /// An operator's name is empty or too long.
    #[error("a name has 1 to {MAX_NAME} bytes")]
    BadName,
    /// A name in the requirements is empty or too long.
    #[error("names of VNFs and maps have 1 to {MAX_NAME} bytes, names of networks at most {MAX_SSID}")]
    BadRequirements,
    /// A step has no time.
    #[error("each step needs at least a second")]
    BadTerms,
    /// The key is zero.
    #[error("a public key must not be zero")]
    BadKey,
    /// A sealed message is empty or too long.
    #[error("a sealed message has 1 to {MAX_SEALED} bytes")]
    BadSealed,
    /// The commitment is zero.
    #[error("a commitment must not be zero")]
    BadCommitment,
    /// The amount of money is wrong.
    #[error("the deposit must be {0}")]
    BadDeposit(
        /// The amount due.
        Wei,
    ),
    /// The ID is taken.
    #[error("the caller has announced a service with this salt already")]
    AlreadyAnnounced,
    /// The caller has a bid already.
    #[error("the caller has a bid for this service already")]
    AlreadyBid,
    /// The chosen provider has no bid.
    #[error("the chosen provider has no bid for this service")]
    NoSuchBid,
    /// Price and salt differ from those of the bid.
    #[error("the bid commits to another price or salt")]
    CommitmentDiffers,
    /// The bid's price is zero.
    #[error("a price must be more than zero")]
    PriceIsZero,
    /// The caller bids for its own service.
    #[error("an operator cannot bid for its own service")]
    OwnService,
    /// Only the creator may do this.
    #[error("only the service's creator may do this")]
    OnlyCreator,
    /// Only the winner may do this.
    #[error("only the chosen provider may do this")]
    OnlyProvider,
    /// Only the creator and the winner may do this.
    #[error("only the service's creator and its provider may do this")]
    OnlyParties,
    /// The service is in another state.
    #[error("this cannot be done while the service is {0:?}")]
    WrongState(
        /// Its state.
        State,
    ),
    /// The deadline has passed.
    #[error("the deadline for this was {}", .0.0)]
    TooLate(
        /// The deadline.
        ChainTime,
    ),
    /// The deadline has not passed.
    #[error("the deadline {} has not passed", .0.0)]
    TooEarly(
        /// The deadline.
        ChainTime,
    ),
    /// Somebody may still be chosen.
    #[error("a bond is held until nobody can be chosen any more")]
    BondBound,
    /// There is no receiver.
    #[error("money cannot be paid to the zero address or to the contract")]
    BadReceiver,
    /// There is no balance.
    #[error("the caller has nothing to withdraw")]
    NothingToWithdraw,
    /// The caller could not be paid.
    #[error("the receiver did not accept the money")]
    TransferFailed,
}
