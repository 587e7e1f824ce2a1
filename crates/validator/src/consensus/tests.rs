//! Networks in virtual time: messages are delayed and lost, and validators lose all but what they noted, at any moment.

use std::collections::{BTreeMap, VecDeque};

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::*;
use crate::block::tests::{GENESIS, block};

const PERIOD: Duration = Duration::from_secs(1);

/// What happens to whom.
enum Happening {
    Hears(usize, Message),
    Judged(BlockId, bool),
    Built(Order, Block),
}

/// What a validator has on its disk.
#[derive(Default)]
struct Disk {
    notes: Vec<Note>,
    blocks: Vec<Decided>,
}

struct World {
    now: Timestamp,
    random: Xoshiro256PlusPlus,
    settings: Vec<Settings>,
    running: Vec<Option<Consensus>>,
    disks: Vec<Disk>,
    /// In order of time; the number keeps apart what happens at once.
    happenings: BTreeMap<(Timestamp, u64), (usize, Happening)>,
    count: u64,
    /// Of a thousand messages, so many are lost.
    lost: u32,
    /// Of a thousand things that a validator does, so many are its last for the time being.
    crashes: u32,
    /// What each said of each step of each round.
    said: BTreeMap<(usize, String), String>,
    /// When each height was decided first.
    decided: BTreeMap<u64, Timestamp>,
    /// Proposes what nobody finds valid.
    bad: Option<usize>,
}

impl World {
    fn new(count: usize, seed: u64) -> Self {
        let key = |index: usize| SigningKey::from_bytes(&[index as u8 + 1; 32]);
        let keys: Vec<_> = (0..count).map(|index| key(index).verifying_key()).collect();
        let validators = Validators::new(&keys);
        let network = NetworkId::new(&GENESIS.hash, &validators);
        let settings =
            |me| Settings { validators: validators.clone(), me, key: key(me), network, period: PERIOD };
        let mut world = Self {
            now: Timestamp::ZERO + Duration::from_secs(1_000),
            random: Xoshiro256PlusPlus::seed_from_u64(seed),
            settings: (0..count).map(settings).collect(),
            running: (0..count).map(|_| None).collect(),
            disks: (0..count).map(|_| Disk::default()).collect(),
            happenings: BTreeMap::new(),
            count: 0,
            lost: 0,
            crashes: 0,
            said: BTreeMap::new(),
            decided: BTreeMap::new(),
            bad: None,
        };
        (0..count).for_each(|index| world.start(index));
        world
    }

    fn start(&mut self, index: usize) {
        let disk = &self.disks[index];
        let last = disk.blocks.last().map_or(GENESIS, |decided| decided.block.position());
        let mut consensus = Consensus::new(self.settings[index].clone(), last, self.now);
        consensus.start(self.now, disk.notes.clone()).unwrap();
        self.running[index] = Some(consensus);
        self.perform(index);
    }

    fn crash(&mut self, index: usize) {
        self.running[index] = None;
        self.happenings
            .retain(|_, (of, happening)| *of != index || matches!(happening, Happening::Hears(..)));
    }

    fn soon(&mut self, whom: usize, most_ms: u64, happening: Happening) {
        let delay = Duration::from_micros(self.random.random_range(100..most_ms * 1000));
        self.count += 1;
        self.happenings.insert((self.now + delay, self.count), (whom, happening));
    }

    fn perform(&mut self, index: usize) {
        while let Some(output) = self.running[index].as_mut().and_then(Consensus::poll) {
            match output {
                Output::Note(note) => {
                    // As it is on a disk.
                    let text = serde_json::to_string(&note).unwrap();
                    self.disks[index].notes.push(serde_json::from_str(&text).unwrap());
                }
                Output::Say(to, message) => self.say(index, to, &message),
                Output::Judge(block) => {
                    let is_valid = !self.is_bad(&block);
                    self.soon(index, 20, Happening::Judged(block.id(), is_valid));
                }
                Output::Build(order) => {
                    let is_bad = self.bad == Some(index);
                    let extra = [index as u8, order.round as u8, u8::from(is_bad), self.random.random()];
                    let block = block(&order.parent, order.timestamp, &extra);
                    self.soon(index, 20, Happening::Built(order, block));
                }
                Output::Decided(decided) => {
                    let disk = &mut self.disks[index];
                    assert_eq!(decided.height().0, disk.blocks.len() as u64 + 1);
                    self.decided.entry(decided.height().0).or_insert(self.now);
                    disk.blocks.push(decided);
                    disk.notes.clear();
                }
                Output::Serve(to, Height(from)) => {
                    let blocks = &self.disks[index].blocks;
                    let decided: Vec<_> = blocks.iter().skip(from as usize - 1).take(3).cloned().collect();
                    if !decided.is_empty() {
                        self.say(index, Some(to), &Message::Decided(decided));
                    }
                }
            }
            if self.random.random_range(0..1000) < self.crashes {
                self.crash(index);
            }
        }
    }

    fn is_bad(&self, block: &Block) -> bool {
        serde_json::to_value(block).unwrap()["extraData"].as_str().unwrap()[6..8] == *"01"
    }

    fn say(&mut self, from: usize, to: Option<usize>, message: &Message) {
        self.watch(from, message);
        let text = serde_json::to_string(message).unwrap();
        for index in
            (0..self.running.len()).filter(|index| *index != from && to.is_none_or(|to| to == *index))
        {
            if self.random.random_range(0..1000) >= self.lost {
                self.soon(index, 50, Happening::Hears(from, serde_json::from_str(&text).unwrap()));
            }
        }
    }

    /// Nobody says two things of one step of a round, whatever it forgets.
    fn watch(&mut self, who: usize, message: &Message) {
        let (step, value) = match message {
            Message::Vote(vote) => {
                let vote = serde_json::to_value(vote).unwrap();
                (format!("{}{}{}", vote["kind"], vote["height"], vote["round"]), vote["value"].to_string())
            }
            Message::Proposal(proposal) => {
                let proposal = serde_json::to_value(proposal).unwrap();
                (format!("{}{}", proposal["height"], proposal["round"]), proposal["value"].to_string())
            }
            _ => return,
        };
        let before = self.said.entry((who, step.clone())).or_insert_with(|| value.clone());
        assert_eq!(*before, value, "{who} said two things of {step}");
    }

    /// Lets time go by.
    fn run(&mut self, time: Duration) {
        let until = self.now + time;
        loop {
            let due = |index: usize| Some((self.running[index].as_ref()?.next_deadline(), index));
            let deadline = (0..self.running.len()).filter_map(due).min();
            let happening = self.happenings.first_key_value().map(|(at, _)| *at);
            let next = deadline.map(|(at, _)| at).into_iter().chain(happening.map(|(at, _)| at)).min();
            let Some(next) = next.filter(|next| *next <= until) else { break };
            self.now = self.now.max(next);
            if let Some(at) = happening.filter(|(at, _)| *at <= self.now) {
                let (index, happening) = self.happenings.remove(&at).unwrap();
                let now = self.now;
                if let Some(consensus) = &mut self.running[index] {
                    match happening {
                        Happening::Hears(from, message) => consensus.hear(now, from, message),
                        Happening::Judged(block, is_valid) => consensus.judged(now, block, is_valid),
                        Happening::Built(order, block) => consensus.built(now, &order, block),
                    }
                    self.perform(index);
                }
            } else if let Some((_, index)) = deadline {
                self.running[index].as_mut().unwrap().expire(self.now);
                self.perform(index);
            }
        }
        self.now = until;
        self.check();
    }

    fn check(&self) {
        let longest = self.disks.iter().map(|disk| &disk.blocks).max_by_key(|blocks| blocks.len()).unwrap();
        let ids = |blocks: &[Decided]| -> Vec<BlockId> {
            blocks.iter().map(|decided| decided.block.id()).collect()
        };
        for disk in &self.disks {
            assert_eq!(ids(&disk.blocks), ids(&longest[..disk.blocks.len()]));
        }
    }

    fn heights(&self) -> Vec<usize> {
        self.disks.iter().map(|disk| disk.blocks.len()).collect()
    }
}

#[test]
fn a_block_is_decided_each_period() {
    let mut world = World::new(4, 1);
    world.run(Duration::from_secs(20));
    for (height, at) in &world.decided {
        let after = at.since(Timestamp::ZERO + Duration::from_secs(1_000)).as_secs_f64();
        // Three messages of at most 50 ms each, and at most 20 ms for the block to be made and 20 ms to be executed.
        let round = after - (height - 1) as f64;
        assert!(round > 0.0 && round < 0.25, "height {height} after {after} s");
    }
    assert_eq!(world.heights(), [20; 4]);
    let times: Vec<_> =
        world.disks[0].blocks.iter().map(|decided| decided.block.position().timestamp).collect();
    assert!(times.windows(2).all(|pair| pair[1] == pair[0] + 1), "{times:?}");
}

#[test]
fn one_alone_decides() {
    let mut world = World::new(1, 1);
    world.run(Duration::from_secs(10));
    assert_eq!(world.heights(), [10]);
}

#[test]
fn four_go_on_without_one_and_it_catches_up() {
    let mut world = World::new(4, 2);
    world.crash(3);
    world.run(Duration::from_secs(60));
    let heights = world.heights();
    // Each fourth height, its round comes to nothing within a second and votes.
    assert!(heights[..3].iter().all(|height| *height >= 40), "{heights:?}");
    world.start(3);
    world.run(Duration::from_secs(20));
    let heights = world.heights();
    assert!(heights.iter().max().unwrap() - heights.iter().min().unwrap() <= 1, "{heights:?}");
    let before = heights[0];
    world.run(Duration::from_secs(20));
    assert!(world.heights()[0] >= before + 19, "all take part again: {:?}", world.heights());
}

#[test]
fn without_two_of_four_nothing_is_decided_until_they_are_back() {
    for (count, gone) in [(2, 1), (3, 1), (4, 2), (7, 3)] {
        let mut world = World::new(count, 3);
        world.run(Duration::from_secs(5));
        (0..gone).for_each(|index| world.crash(index));
        world.run(Duration::from_secs(1));
        let halted = world.heights();
        world.run(Duration::from_secs(60));
        assert_eq!(world.heights(), halted, "of {count} {gone} are gone");
        (0..gone).for_each(|index| world.start(index));
        world.run(Duration::from_secs(30));
        let heights = world.heights();
        assert!(
            heights.iter().all(|height| *height > halted[gone] + 10),
            "{count}: {halted:?}, then {heights:?}"
        );
    }
}

#[test]
fn what_is_not_valid_is_not_decided() {
    let mut world = World::new(4, 4);
    world.bad = Some(2);
    world.run(Duration::from_secs(30));
    assert!(world.heights().iter().all(|height| *height > 20), "{:?}", world.heights());
    assert!(world.disks[0].blocks.iter().all(|decided| !world.is_bad(&decided.block)));
}

#[test]
fn who_says_that_it_is_ahead_hurries_nobody() {
    let mut world = World::new(4, 5);
    for _ in 0..20 {
        let ahead = Message::Status { decided: Height(u64::MAX) };
        (0..3).for_each(|index| world.soon(index, 10, Happening::Hears(3, ahead.clone())));
        world.run(Duration::from_secs(1));
    }
    assert!(world.heights().iter().all(|height| (19..=20).contains(height)), "{:?}", world.heights());
}

#[test]
fn a_forged_decision_is_none() {
    let mut world = World::new(4, 6);
    world.run(Duration::from_secs(3));
    let mut other = World::new(4, 7);
    other
        .settings
        .iter_mut()
        .for_each(|settings| settings.network = NetworkId::new(&[9; 32], &settings.validators));
    (0..4).for_each(|index| other.start(index));
    other.run(Duration::from_secs(10));
    // Four blocks of another network with the same validators, from the genesis on; the next here is the fourth.
    world.crash(0);
    world.disks[0] = Disk::default();
    world.start(0);
    world.soon(0, 10, Happening::Hears(3, Message::Decided(other.disks[0].blocks.clone())));
    world.run(Duration::from_secs(10));
    assert!(world.heights().iter().all(|height| *height >= 10), "{:?}", world.heights());
}

#[test]
fn notes_of_another_validator_are_refused() {
    let mut world = World::new(4, 8);
    world.run(Duration::from_millis(60));
    let mut notes = VecDeque::from(world.disks[1].notes.clone());
    while let Some(note) = notes.pop_back() {
        let mut consensus = Consensus::new(world.settings[0].clone(), GENESIS, world.now);
        // Whatever of another's it knows, it says only what is its own.
        if consensus.start(world.now, notes.iter().cloned().collect()).is_ok() {
            while let Some(output) = consensus.poll() {
                if let Output::Say(_, Message::Vote(vote)) = output {
                    let mine = serde_json::to_value(world.settings[0].validators.address(0)).unwrap();
                    assert_eq!(serde_json::to_value(vote).unwrap()["validator"], mine);
                }
            }
        }
        drop(note);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10))]

    /// Whatever is lost, and whoever crashes whenever: no two blocks at one height, nobody says two things, and when it is over
    /// the network goes on.
    #[test]
    fn nothing_that_is_lost_makes_two_chains(seed: u64, count in 1_usize..=5, lost in 0_u32..300, crashes in 0_u32..20) {
        let mut world = World::new(count, seed);
        (world.lost, world.crashes) = (lost, crashes);
        for _ in 0..15 {
            world.run(Duration::from_secs(2));
            for index in 0..count {
                if world.running[index].is_none() && world.random.random_range(0..2) == 0 {
                    world.start(index);
                }
            }
        }
        (world.lost, world.crashes) = (0, 0);
        for index in 0..count {
            if world.running[index].is_none() {
                world.start(index);
            }
        }
        let before = world.heights().into_iter().max().unwrap();
        // Rounds may have become long meanwhile.
        for _ in 0..18 {
            if world.heights().iter().any(|height| *height <= before + 3) {
                world.run(Duration::from_secs(5));
            }
        }
        let heights = world.heights();
        prop_assert!(heights.iter().all(|height| *height > before + 3), "{before}, then {heights:?}");
    }
}
