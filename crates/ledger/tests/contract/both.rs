//! The compiled contract and its rules in Rust, side by side. Each call goes to both, and they must agree.

use cotorra_ledger::{
    Account, Call, ChainTime, Commitment, Contract, ContractError, Event, Price, PublicKey, Requirements,
    Salt, ServiceId, State, Terms, Wei,
};

use crate::chain::{Chain, START, account};

pub const CREATOR: Account = Account([1; 20]);
pub const PROVIDER: Account = Account([2; 20]);
pub const OTHER: Account = Account([3; 20]);

pub const TERMS: Terms =
    Terms { open_for: 60, deploy_within: 30, accept_within: 20, use_for: 600, bond: 1000 };
pub const PRICE: Price = Price::new(7).unwrap();

pub struct Both {
    pub chain: Chain,
    rules: Contract,
    /// Time of the next call.
    pub now: ChainTime,
    /// Gas of the last successful call.
    pub gas: u64,
}

impl Both {
    /// On a new chain; `None` without anvil.
    pub fn new() -> Option<Self> {
        let chain = Chain::new()?;
        let rules = Contract::new(chain.deployment());
        Some(Self { chain, rules, now: START, gas: 0 })
    }

    /// Replaces the contract by a new one on the same chain.
    pub fn renew(&mut self) {
        self.chain.renew();
        self.rules = Contract::new(self.chain.deployment());
    }

    /// Makes both, with three registered operators.
    pub fn with_operators() -> Option<Self> {
        let mut both = Self::new()?;
        for operator in [CREATOR, PROVIDER, OTHER] {
            both.does(operator, Call::Register { name: format!("operator {operator}") });
        }
        Some(both)
    }

    /// Calls both, a second after the last call.
    pub fn call(&mut self, caller: Account, call: Call) -> Result<Event, ContractError> {
        self.now = self.now.after(1);
        let by_rules = self.rules.apply(self.now, caller, &call);
        let by_chain = self.chain.call(self.now, caller, &call);
        let by_chain = by_chain.map(|receipt| {
            self.gas = receipt.gas;
            receipt.events
        });
        assert_eq!(
            by_chain,
            by_rules.clone().map(|event| vec![event]),
            "{caller} at {:?}: {call:?}",
            self.now
        );
        assert_eq!(Wei(self.chain.wealth(self.chain.contract())), self.rules.holds(), "behind {call:?}");
        by_rules
    }

    /// Makes a call that must succeed.
    #[track_caller]
    pub fn does(&mut self, caller: Account, call: Call) -> Event {
        self.call(caller, call.clone()).unwrap_or_else(|refusal| panic!("{call:?}: {refusal}"))
    }

    /// Makes a call that must be rejected.
    #[track_caller]
    pub fn refuses(&mut self, refusal: ContractError, caller: Account, call: Call) {
        assert_eq!(self.call(caller, call.clone()), Err(refusal), "{call:?}");
    }

    /// ID of a creator's service.
    pub fn id(&self, creator: Account, salt: Salt) -> ServiceId {
        ServiceId::of(self.rules.deployment(), creator, salt)
    }

    /// State of a service.
    pub fn state(&self, id: ServiceId) -> State {
        self.rules.state(id)
    }

    /// Amount that an operator may withdraw.
    pub fn balance(&self, operator: Account) -> Wei {
        self.rules.balance(operator)
    }

    /// Lets time pass.
    pub fn wait(&mut self, seconds: u32) {
        self.now = self.now.after(seconds);
    }

    /// Makes a service of the creator with a bid of the provider.
    pub fn bid_for(&mut self, salt: Salt) -> ServiceId {
        let id = self.id(CREATOR, salt);
        self.does(CREATOR, announce(salt));
        self.does(PROVIDER, bid(id, PROVIDER));
        id
    }

    /// Makes a service that the provider must deploy.
    pub fn closed(&mut self, salt: Salt) -> ServiceId {
        let id = self.bid_for(salt);
        self.does(CREATOR, choose(id, PROVIDER));
        id
    }

    /// Makes a service whose deployment the provider confirmed.
    pub fn deployed(&mut self, salt: Salt) -> ServiceId {
        let id = self.closed(salt);
        self.does(PROVIDER, deploy(id));
        id
    }

    /// Makes a service in use.
    pub fn in_use(&mut self, salt: Salt) -> ServiceId {
        let id = self.deployed(salt);
        self.does(CREATOR, Call::Accept { id });
        id
    }
}

pub fn requirements() -> Requirements {
    Requirements {
        vnf: "vAP".to_owned(),
        map: "corridor".to_owned(),
        x_mm: 25_500,
        y_mm: -24_300,
        radius_mm: 5_000,
        ssid: "robots".to_owned(),
        mobility_domain: 0xa1b2,
        frequency_mhz: 5_180,
        width_mhz: 20,
        signal_dbm: -70,
    }
}

pub fn announce(salt: Salt) -> Call {
    Call::Announce { salt, key: PublicKey([9; 32]), requirements: requirements(), terms: TERMS }
}

/// Salt of a provider's bid.
pub fn salt_of(provider: Account) -> Salt {
    Salt([provider.0[0]; 32])
}

pub fn bid(id: ServiceId, provider: Account) -> Call {
    let commitment = Commitment::to(id, provider, PRICE, salt_of(provider));
    Call::Bid { id, commitment, sealed: vec![0xab; 128], bond: TERMS.bond() }
}

pub fn choose(id: ServiceId, provider: Account) -> Call {
    let deposit = PRICE.times(TERMS.use_for);
    Call::Choose { id, provider, price: PRICE, salt: salt_of(provider), deposit }
}

pub fn deploy(id: ServiceId) -> Call {
    Call::Deploy { id, sealed: vec![0xcd; 192] }
}

/// An account that is not an operator.
pub fn stranger() -> Account {
    account(77)
}
