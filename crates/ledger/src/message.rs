//! What is said to the contract and what it says: calls, events and refusals, as `contracts/Federation.sol` has them.

use crate::values::{Account, ChainTime, Commitment, Price, PublicKey, Salt, ServiceId, Wei};

/// Longest sealed message, in bytes.
pub const MAX_SEALED: usize = 1024;
/// Longest name of an operator, of a VNF or of a map, in bytes.
pub const MAX_NAME: usize = 64;
/// Longest SSID, in bytes (IEEE 802.11-2020, 9.4.2.2).
pub const MAX_SSID: usize = 32;

/// What a creator needs, where, and how it is to be reached by radio.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Requirements {
    /// What to deploy, such as `vAP`.
    pub vnf: String,
    /// The frame that positions are in.
    pub map: String,
    /// Where it is needed, millimetres in that frame.
    pub x_mm: i32,
    /// Where it is needed, millimetres in that frame.
    pub y_mm: i32,
    /// How far around, millimetres.
    pub radius_mm: u32,
    /// The network's name.
    pub ssid: String,
    /// Of fast transition (IEEE 802.11r), as in the beacon.
    pub mobility_domain: u16,
    /// Of the channel's centre; 0 leaves it to the provider.
    pub frequency_mhz: u16,
    /// Of the channel; 0 leaves it to the provider.
    pub width_mhz: u16,
    /// At least, where it is needed.
    pub signal_dbm: i16,
}

/// How long each step may take, in seconds of the chain, none of which may be zero; and the bond.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Terms {
    /// For bids, and for each choice among them.
    pub open_for: u32,
    /// From the choice.
    pub deploy_within: u32,
    /// From the deployment.
    pub accept_within: u32,
    /// At most, from the deployment; the deposit pays for all of it.
    pub use_for: u32,
    /// What goes with a bid, wei: whoever is chosen and does not deploy in time loses it to the creator.
    pub bond: u64,
}

impl Terms {
    /// What goes with a bid.
    pub fn bond(&self) -> Wei {
        Wei(self.bond.into())
    }
}

/// A transaction's content.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Call {
    /// The caller becomes an operator.
    Register {
        /// What it is called, 1 to [`MAX_NAME`] bytes.
        name: String,
    },
    /// Announces a service, open for bids.
    Announce {
        /// Makes the service's id.
        salt: Salt,
        /// The one-time key that bids and the attachment are sealed to.
        key: PublicKey,
        /// What is needed.
        requirements: Requirements,
        /// How long each step may take.
        terms: Terms,
    },
    /// Bids for a service.
    Bid {
        /// For which.
        id: ServiceId,
        /// To the price.
        commitment: Commitment,
        /// Price, salt and endpoint, sealed.
        sealed: Vec<u8>,
        /// As the terms say.
        bond: Wei,
    },
    /// The creator chooses a bid, and deposits what the longest use would cost. It may choose another when the winner is
    /// late, or what it deployed cannot be used.
    Choose {
        /// For which service.
        id: ServiceId,
        /// Whose bid.
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
        /// Which.
        id: ServiceId,
        /// What is needed to attach, sealed.
        sealed: Vec<u8>,
    },
    /// The creator attached, and agrees to pay.
    Accept {
        /// To which.
        id: ServiceId,
    },
    /// The creator no longer wants a service that it has not accepted.
    Cancel {
        /// Which.
        id: ServiceId,
    },
    /// The winner gives back a service that was not accepted.
    Decline {
        /// Which.
        id: ServiceId,
    },
    /// One of the two ends the use of a service; it is charged until then.
    Release {
        /// Of which.
        id: ServiceId,
    },
    /// Anyone ends a service whose deadline has passed.
    Expire {
        /// Which.
        id: ServiceId,
    },
    /// A bidder that was not chosen takes its bond back, once nobody can be chosen any more.
    Reclaim {
        /// Of which service.
        id: ServiceId,
    },
    /// Pays out the caller's balance.
    Withdraw {
        /// To which address: a contract that takes no money names another.
        to: Account,
    },
}

impl Call {
    /// The money that goes with it.
    pub fn value(&self) -> Wei {
        match self {
            Self::Choose { deposit, .. } => *deposit,
            Self::Bid { bond, .. } => *bond,
            _ => Wei(0),
        }
    }
}

/// Where a service stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// Nobody announced it.
    None,
    /// Bids are taken.
    Open,
    /// A winner was chosen, and deploys.
    Closed,
    /// The winner says that it runs.
    Deployed,
    /// The creator says so, too; use is charged.
    InUse,
    /// Over, for whatever reason.
    Ended,
}

/// How a service ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// The creator no longer wanted it.
    Cancelled,
    /// The winner gave it back.
    Declined,
    /// Nobody was chosen in time.
    NoWinner,
    /// The winner did not deploy in time.
    NotDeployed,
    /// The creator did not accept in time.
    NotAccepted,
    /// One of the two ended its use.
    Released,
    /// It was used for as long as was paid.
    Completed,
}

/// What the contract tells everybody.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// There is a new operator.
    OperatorRegistered {
        /// Who.
        operator: Account,
        /// What it is called.
        name: String,
    },
    /// A service is open for bids.
    ServiceAnnounced {
        /// Which.
        id: ServiceId,
        /// Whose.
        creator: Account,
        /// What bids and the attachment are to be sealed to.
        key: PublicKey,
        /// What is needed.
        requirements: Requirements,
        /// How long each step may take.
        terms: Terms,
        /// For bids and the choice.
        deadline: ChainTime,
    },
    /// There is a bid.
    BidPlaced {
        /// For which service.
        id: ServiceId,
        /// Whose.
        provider: Account,
        /// To the price.
        commitment: Commitment,
        /// Price, salt and endpoint, sealed.
        sealed: Vec<u8>,
    },
    /// A bid was chosen.
    ProviderChosen {
        /// For which service.
        id: ServiceId,
        /// Whose.
        provider: Account,
        /// What it costs.
        price: Price,
        /// How often somebody was chosen by then.
        choice: u32,
        /// For the deployment.
        deadline: ChainTime,
    },
    /// The winner says that the service runs.
    ServiceDeployed {
        /// Which.
        id: ServiceId,
        /// The winner.
        provider: Account,
        /// What is needed to attach, sealed.
        sealed: Vec<u8>,
        /// For the acceptance.
        deadline: ChainTime,
    },
    /// The creator says so, too.
    ServiceAccepted {
        /// Which.
        id: ServiceId,
        /// The winner.
        provider: Account,
        /// Until when it is paid for.
        deadline: ChainTime,
    },
    /// The winner gave it back, or was late: another can be chosen.
    ServiceReopened {
        /// Which.
        id: ServiceId,
        /// Who was the winner.
        provider: Account,
        /// For the choice.
        deadline: ChainTime,
    },
    /// A bidder that was not chosen has its bond again.
    BondReclaimed {
        /// Of which service.
        id: ServiceId,
        /// Who.
        provider: Account,
        /// How much.
        bond: Wei,
    },
    /// A service is over.
    ServiceEnded {
        /// Which.
        id: ServiceId,
        /// The winner; all zero if there was none.
        provider: Account,
        /// How.
        outcome: Outcome,
        /// What the provider gets.
        charge: Wei,
    },
    /// An operator was paid.
    Withdrawn {
        /// Who.
        operator: Account,
        /// To whom, as it said.
        to: Account,
        /// How much.
        amount: Wei,
    },
}

impl Event {
    /// The service that it is about.
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

/// Why the contract takes a call for nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ContractError {
    /// The caller is no operator.
    #[error("the caller is not registered as an operator")]
    NotRegistered,
    /// The caller is an operator already.
    #[error("the caller is registered already")]
    AlreadyRegistered,
    /// An operator's name is empty or too long.
    #[error("a name has 1 to {MAX_NAME} bytes")]
    BadName,
    /// Requirements have an empty name, or one that is too long.
    #[error("a VNF and a map have names of 1 to {MAX_NAME} bytes, a network one of at most {MAX_SSID}")]
    BadRequirements,
    /// A step has no time.
    #[error("each step needs a second at least")]
    BadTerms,
    /// The key is zero.
    #[error("zero is no public key")]
    BadKey,
    /// A sealed message is empty or too long.
    #[error("a sealed message has 1 to {MAX_SEALED} bytes")]
    BadSealed,
    /// The commitment is zero.
    #[error("zero is no commitment")]
    BadCommitment,
    /// Too little or too much money.
    #[error("the deposit is to be {0}")]
    BadDeposit(
        /// What is due.
        Wei,
    ),
    /// The id is taken.
    #[error("the caller has announced a service with this salt already")]
    AlreadyAnnounced,
    /// The caller has a bid.
    #[error("the caller has a bid for this service already")]
    AlreadyBid,
    /// The chosen one has no bid.
    #[error("the chosen provider has no bid for this service")]
    NoSuchBid,
    /// Price and salt are not those of the bid.
    #[error("the bid commits to another price or salt")]
    CommitmentDiffers,
    /// The bid was for nothing.
    #[error("a price is more than zero")]
    PriceIsZero,
    /// The caller's own service.
    #[error("nobody bids for a service of its own")]
    OwnService,
    /// Something that only the creator may do.
    #[error("only the service's creator may do this")]
    OnlyCreator,
    /// Something that only the winner may do.
    #[error("only the chosen provider may do this")]
    OnlyProvider,
    /// Something that only the two may do.
    #[error("only the service's creator and its provider may do this")]
    OnlyParties,
    /// Not what can be done now.
    #[error("this cannot be done while the service is {0:?}")]
    WrongState(
        /// Where it stands.
        State,
    ),
    /// The deadline has passed.
    #[error("the time for this was over at {}", .0.0)]
    TooLate(
        /// When it was.
        ChainTime,
    ),
    /// The deadline has not passed.
    #[error("there is time until {}", .0.0)]
    TooEarly(
        /// When it is.
        ChainTime,
    ),
    /// Somebody may still be chosen.
    #[error("a bond is bound until nobody can be chosen any more")]
    BondBound,
    /// Nobody could have the money there.
    #[error("nobody has the money that is paid to zero, or to the contract")]
    BadReceiver,
    /// There is no balance.
    #[error("the caller has nothing to withdraw")]
    NothingToWithdraw,
    /// The caller could not be paid.
    #[error("the caller does not take the money")]
    TransferFailed,
}
