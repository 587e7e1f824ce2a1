// SPDX-License-Identifier: MIT OR Apache-2.0
pragma solidity 0.8.37;

/// @title Federation of administrative domains
/// @notice Operators that do not trust each other announce services that they need, bid for those of others, and pay
/// for what they used. The contract keeps the order of steps, the deadlines and the money; whether a service works is
/// for the parties to see, and neither owes the other anything until both have said that it does.
///
///     announce        choose         deploy          accept         release
///     ───────▶ Open ─────────▶ Closed ─────▶ Deployed ─────▶ InUse ─────────▶ Ended
///               │ ▲              │              │             │              ▲
///               │ └── decline, expire, choose ──┤             │              │
///               └──── cancel, expire ───────────┴── expire ───┴──────────────┘
///
/// A bond goes with each bid. Whoever is chosen and does not deploy in time loses it to the creator, which then chooses
/// among the other bids, without another auction.
///
/// Nothing on a public ledger is secret. Bids, and what is needed to attach, are therefore sealed: encrypted by their
/// senders to the one-time key of the announcement. The contract sees of a bid only a commitment to its price, which
/// the creator opens for the winner alone.
///
/// Times are the chain's (`block.timestamp`), in seconds; prices are in wei for a second of use.
contract Federation {
    /// Where a service stands.
    enum State {
        None, // nobody announced it
        Open, // bids are taken
        Closed, // a winner was chosen, and deploys
        Deployed, // the winner says that it runs
        InUse, // the creator says so, too; use is charged
        Ended
    }

    /// How a service ended.
    enum Outcome {
        Cancelled, // the creator no longer wanted it
        Declined, // the winner gave it back
        NoWinner, // nobody was chosen in time
        NotDeployed, // the winner did not deploy in time
        NotAccepted, // the creator did not accept in time
        Released, // one of the two ended its use
        Completed // it was used for as long as was paid
    }

    /// What a creator needs.
    struct Requirements {
        string vnf; // what to deploy, such as "vAP"
        string map; // the frame that positions are in
        int32 xMm; // where it is needed, millimetres in that frame
        int32 yMm;
        uint32 radiusMm; // and how far around, millimetres
        string ssid; // the network's name, at most 32 bytes (IEEE 802.11)
        uint16 mobilityDomain; // of fast transition (IEEE 802.11r), as in the beacon
        uint16 frequencyMhz; // of the channel's centre; 0 leaves it to the provider
        uint16 widthMhz; // of the channel; 0 leaves it to the provider
        int16 signalDbm; // at least, where it is needed
    }

    /// How long each step may take, in seconds.
    struct Terms {
        uint32 openFor; // for bids, and for each choice among them
        uint32 deployWithin; // from the choice
        uint32 acceptWithin; // from the deployment
        uint32 useFor; // at most, from the deployment; the deposit pays for all of it
        uint64 bond; // goes with each bid, in wei; 64 bits are 18 ether
    }

    /// What is kept of a service.
    struct Service {
        address creator;
        State state;
        uint40 deadline; // of the state: behind it, anyone may call `expire`
        uint40 chooseBy; // behind it, nobody is chosen any more
        uint32 choices; // how often somebody was chosen
        address provider; // the winner, while there is one
        uint40 deployedAt;
        uint96 price; // of the winner; 96 bits, so that no deposit overflows 128
        uint32 deployWithin;
        uint32 acceptWithin;
        uint32 useFor;
        uint64 bond;
    }

    /// Longest sealed message, in bytes.
    uint256 public constant MAX_SEALED = 1024;
    /// Longest name of an operator, of a VNF or of a map, in bytes.
    uint256 public constant MAX_NAME = 64;
    /// Longest SSID, in bytes (IEEE 802.11-2020, 9.4.2.2).
    uint256 public constant MAX_SSID = 32;

    /// The names of registered operators; empty for all others.
    mapping(address operator => string) public nameOf;
    /// What operators may withdraw, in wei.
    mapping(address operator => uint256) public balanceOf;
    mapping(bytes32 id => Service) private services;
    mapping(bytes32 id => mapping(address provider => bytes32)) private commitments;
    /// In place of a commitment: the bid was chosen, or its bond taken back.
    bytes32 private constant SPENT = bytes32(uint256(1));

    event OperatorRegistered(address indexed operator, string name);
    event ServiceAnnounced(
        bytes32 indexed id,
        address indexed creator,
        bytes32 key,
        Requirements requirements,
        Terms terms,
        uint40 deadline
    );
    event BidPlaced(bytes32 indexed id, address indexed provider, bytes32 commitment, bytes sealedBid);
    event ProviderChosen(
        bytes32 indexed id, address indexed provider, uint96 price, uint32 choice, uint40 deadline
    );
    event ServiceDeployed(
        bytes32 indexed id, address indexed provider, bytes sealedAttachment, uint40 deadline
    );
    event ServiceAccepted(bytes32 indexed id, address indexed provider, uint40 deadline);
    event ServiceReopened(bytes32 indexed id, address indexed provider, uint40 deadline);
    event BondReclaimed(bytes32 indexed id, address indexed provider, uint64 bond);
    event ServiceEnded(bytes32 indexed id, address indexed provider, Outcome outcome, uint256 charge);
    event Withdrawn(address indexed operator, address indexed to, uint256 amount);

    error NotRegistered();
    error AlreadyRegistered();
    error BadName();
    error BadRequirements();
    error BadTerms();
    error BadKey();
    error BadSealed();
    error BadCommitment();
    error BadDeposit(uint256 due);
    error AlreadyAnnounced();
    error AlreadyBid();
    error NoSuchBid();
    error CommitmentDiffers();
    error PriceIsZero();
    error OwnService();
    error OnlyCreator();
    error OnlyProvider();
    error OnlyParties();
    error WrongState(State state);
    error TooLate(uint40 deadline);
    error TooEarly(uint40 deadline);
    error BondBound();
    error BadReceiver();
    error NothingToWithdraw();
    error TransferFailed();

    modifier onlyRegistered() {
        require(bytes(nameOf[msg.sender]).length != 0, NotRegistered());
        _;
    }

    /// @notice The caller becomes an operator.
    function register(string calldata name) external {
        require(bytes(nameOf[msg.sender]).length == 0, AlreadyRegistered());
        require(_isName(name), BadName());
        nameOf[msg.sender] = name;
        emit OperatorRegistered(msg.sender, name);
    }

    /// @notice The id of the service that `creator` announces with `salt`. It has the creator in it, so that nobody can
    /// take another's id by being faster, and a repeated transaction announces nothing twice. It has the chain and this
    /// contract in it, so that no id, and nothing that was signed, sealed or derived for one, is of use anywhere else.
    /// The chain is asked each time: one that splits has two.
    function idOf(address creator, bytes32 salt) public view returns (bytes32) {
        return keccak256(abi.encode(keccak256("cotorra federation"), block.chainid, address(this), creator, salt));
    }

    /// @notice Announces a service, open for bids.
    /// @param key the one-time public key that bids and the attachment are sealed to
    function announce(bytes32 salt, bytes32 key, Requirements calldata requirements, Terms calldata terms)
        external
        onlyRegistered
    {
        bytes32 id = idOf(msg.sender, salt);
        Service storage service = services[id];
        require(service.state == State.None, AlreadyAnnounced());
        require(key != 0, BadKey());
        require(
            _isName(requirements.vnf) && _isName(requirements.map)
                && bytes(requirements.ssid).length <= MAX_SSID,
            BadRequirements()
        );
        require(
            terms.openFor != 0 && terms.deployWithin != 0 && terms.acceptWithin != 0 && terms.useFor != 0,
            BadTerms()
        );
        service.creator = msg.sender;
        service.state = State.Open;
        service.deadline = _in(terms.openFor);
        service.chooseBy = service.deadline;
        service.deployWithin = terms.deployWithin;
        service.acceptWithin = terms.acceptWithin;
        service.useFor = terms.useFor;
        service.bond = terms.bond;
        emit ServiceAnnounced(id, msg.sender, key, requirements, terms, service.deadline);
    }

    /// @notice What a bid commits to. The salt keeps others from trying prices.
    function commitmentOf(bytes32 id, address provider, uint96 price, bytes32 salt)
        public
        pure
        returns (bytes32)
    {
        return keccak256(abi.encode(id, provider, price, salt));
    }

    /// @notice Bids for a service, once, with its bond. The bidder has the bond again when it has deployed, or by
    /// `reclaim`.
    /// @param commitment see `commitmentOf`
    /// @param sealedBid price, salt and endpoint, sealed to the announcement's key
    function bid(bytes32 id, bytes32 commitment, bytes calldata sealedBid) external payable onlyRegistered {
        Service storage service = _inTime(id, State.Open);
        require(service.creator != msg.sender, OwnService());
        require(commitments[id][msg.sender] == 0, AlreadyBid());
        require(commitment != 0 && commitment != SPENT, BadCommitment());
        require(_isSealed(sealedBid), BadSealed());
        require(msg.value == service.bond, BadDeposit(service.bond));
        commitments[id][msg.sender] = commitment;
        emit BidPlaced(id, msg.sender, commitment, sealedBid);
    }

    /// @notice The creator chooses a bid, opens its price, and deposits what the longest use would cost. It may choose
    /// another when the winner is late, or what it deployed cannot be used.
    function choose(bytes32 id, address provider, uint96 price, bytes32 salt) external payable {
        Service storage service = services[id];
        State state = service.state;
        require(
            state == State.Open || state == State.Deployed || (state == State.Closed && _isLate(service)),
            WrongState(state)
        );
        require(block.timestamp <= service.chooseBy, TooLate(service.chooseBy));
        require(service.creator == msg.sender, OnlyCreator());
        bytes32 commitment = commitments[id][provider];
        require(commitment != 0 && commitment != SPENT, NoSuchBid());
        require(commitment == commitmentOf(id, provider, price, salt), CommitmentDiffers());
        require(price != 0, PriceIsZero());
        uint256 due = uint256(price) * service.useFor;
        require(msg.value == due, BadDeposit(due));
        _settle(service, 0);
        commitments[id][provider] = SPENT;
        service.state = State.Closed;
        service.deadline = _in(service.deployWithin);
        service.provider = provider;
        service.price = price;
        service.choices += 1;
        emit ProviderChosen(id, provider, price, service.choices, service.deadline);
    }

    /// @notice The winner confirms that the service runs, and has its bond again.
    /// @param sealedAttachment what is needed to attach, sealed to the announcement's key
    function deploy(bytes32 id, bytes calldata sealedAttachment) external {
        Service storage service = _inTime(id, State.Closed);
        require(service.provider == msg.sender, OnlyProvider());
        require(_isSealed(sealedAttachment), BadSealed());
        _credit(msg.sender, service.bond);
        service.state = State.Deployed;
        service.deployedAt = _in(0);
        service.deadline = _in(service.acceptWithin);
        emit ServiceDeployed(id, msg.sender, sealedAttachment, service.deadline);
    }

    /// @notice The creator attached, and agrees to pay for the use from the deployment on.
    function accept(bytes32 id) external {
        Service storage service = _inTime(id, State.Deployed);
        require(service.creator == msg.sender, OnlyCreator());
        service.state = State.InUse;
        service.deadline = service.deployedAt + service.useFor;
        emit ServiceAccepted(id, service.provider, service.deadline);
    }

    /// @notice The creator no longer wants a service that it has not accepted. It owes nothing.
    function cancel(bytes32 id) external {
        Service storage service = services[id];
        require(service.creator == msg.sender, OnlyCreator());
        _requireUnaccepted(service);
        bool isFailed = service.state == State.Closed && _isLate(service);
        _end(id, service, isFailed ? Outcome.NotDeployed : Outcome.Cancelled, 0);
    }

    /// @notice The winner gives back a service that was not accepted, such as after a failed deployment. In time it keeps
    /// its bond: nothing keeps a liar from saying that it has deployed, and one that says the truth is not to fare worse.
    function decline(bytes32 id) external {
        Service storage service = services[id];
        require(service.provider == msg.sender, OnlyProvider());
        _requireUnaccepted(service);
        _leave(id, service, Outcome.Declined);
    }

    /// @notice The creator or the provider ends the use of a service; it is charged until now.
    function release(bytes32 id) external {
        Service storage service = services[id];
        require(service.creator == msg.sender || service.provider == msg.sender, OnlyParties());
        require(service.state == State.InUse, WrongState(service.state));
        bool over = block.timestamp > service.deadline;
        uint256 used = (over ? service.deadline : block.timestamp) - service.deployedAt;
        _end(id, service, over ? Outcome.Completed : Outcome.Released, used * service.price);
    }

    /// @notice Ends a service whose deadline has passed, or opens it again while there is time to choose another winner.
    /// Anyone may call it.
    function expire(bytes32 id) external {
        Service storage service = services[id];
        State state = service.state;
        require(state != State.None && state != State.Ended, WrongState(state));
        require(block.timestamp > service.deadline, TooEarly(service.deadline));
        if (state == State.Open) {
            _end(id, service, Outcome.NoWinner, 0);
        } else if (state == State.Closed) {
            _leave(id, service, Outcome.NotDeployed);
        } else if (state == State.Deployed) {
            _leave(id, service, Outcome.NotAccepted);
        } else {
            _end(id, service, Outcome.Completed, uint256(service.price) * service.useFor);
        }
    }

    /// @notice A bidder that was not chosen has its bond again, once nobody can be chosen any more.
    function reclaim(bytes32 id) external {
        Service storage service = services[id];
        bytes32 commitment = commitments[id][msg.sender];
        require(commitment != 0 && commitment != SPENT, NoSuchBid());
        State state = service.state;
        require(
            state == State.InUse || state == State.Ended || block.timestamp > service.chooseBy, BondBound()
        );
        commitments[id][msg.sender] = SPENT;
        _credit(msg.sender, service.bond);
        emit BondReclaimed(id, msg.sender, service.bond);
    }

    /// @notice Pays out the caller's balance to `to`: a caller that takes no money itself, such as a contract, loses none.
    /// What cannot be paid stays the caller's.
    function withdraw(address to) external {
        require(to != address(0) && to != address(this), BadReceiver());
        uint256 amount = balanceOf[msg.sender];
        require(amount != 0, NothingToWithdraw());
        // First the books, then the call, which is the only one in this contract: whoever is called finds no more to take.
        balanceOf[msg.sender] = 0;
        emit Withdrawn(msg.sender, to, amount);
        (bool sent,) = to.call{value: amount}("");
        require(sent, TransferFailed());
    }

    /// @notice What is kept of a service; its announcement and its bids are in the events.
    function serviceOf(bytes32 id) external view returns (Service memory) {
        return services[id];
    }

    /// @notice The commitment of a provider's bid; zero if it has none, one if it was chosen or its bond taken back.
    function commitmentOfBid(bytes32 id, address provider) external view returns (bytes32) {
        return commitments[id][provider];
    }

    function _end(bytes32 id, Service storage service, Outcome outcome, uint256 charge) private {
        _settle(service, charge);
        service.state = State.Ended;
        emit ServiceEnded(id, service.provider, outcome, charge);
    }

    /// Drops the winner: another can be chosen, unless it is too late for that. So nobody but the creator ends a service
    /// that the creator could still have of another.
    function _leave(bytes32 id, Service storage service, Outcome outcome) private {
        if (block.timestamp > service.chooseBy) {
            _end(id, service, outcome, 0);
            return;
        }
        _settle(service, 0);
        address provider = service.provider;
        service.state = State.Open;
        service.deadline = service.chooseBy;
        service.provider = address(0);
        emit ServiceReopened(id, provider, service.chooseBy);
    }

    /// Deposit and bond become the parties' balances. Nobody is called here: a party that cannot be paid holds up nobody.
    function _settle(Service storage service, uint256 charge) private {
        State state = service.state;
        if (state == State.Open) return;
        _credit(service.provider, charge);
        _credit(service.creator, uint256(service.price) * service.useFor - charge);
        // A winner that has deployed has its bond already.
        if (state == State.Closed) _credit(_isLate(service) ? service.creator : service.provider, service.bond);
    }

    function _credit(address operator, uint256 amount) private {
        if (amount != 0) balanceOf[operator] += amount;
    }

    function _isLate(Service storage service) private view returns (bool) {
        return block.timestamp > service.deadline;
    }

    function _inTime(bytes32 id, State state) private view returns (Service storage service) {
        service = services[id];
        require(service.state == state, WrongState(service.state));
        require(block.timestamp <= service.deadline, TooLate(service.deadline));
    }

    function _requireUnaccepted(Service storage service) private view {
        State state = service.state;
        require(
            state == State.Open || state == State.Closed || state == State.Deployed, WrongState(state)
        );
    }

    function _in(uint32 seconds_) private view returns (uint40) {
        return uint40(block.timestamp + seconds_);
    }

    function _isName(string calldata name) private pure returns (bool) {
        return bytes(name).length != 0 && bytes(name).length <= MAX_NAME;
    }

    function _isSealed(bytes calldata message) private pure returns (bool) {
        return message.length != 0 && message.length <= MAX_SEALED;
    }
}
