//! The choice of modes to sample. At each update, it looks for modes that may be better than those in use. Of six samples,
//! three try the next faster mode, two try any faster mode, and one tries a mode between those in use.

use cotorra_numbers::Draws;

use super::{ModeStatistics, ONE};

/// Modes of a group in Linux, and columns of its table of random orders. Groups of 802.11ax are larger.
const GROUP: usize = 10;
const COLUMNS: usize = 10;

/// Modes that wait to be sampled, of one kind.
const WAITING: usize = 5;

/// Kinds of samples.
#[derive(Debug, Clone, Copy)]
enum Kind {
    /// The slowest mode that is faster than the best one.
    Next,
    /// A random mode that is faster than all in use.
    Jump,
    /// A random mode between the fastest and the slowest in use.
    Slow,
}

/// Kinds of samples in turn.
const TURNS: [Kind; 6] = [Kind::Next, Kind::Jump, Kind::Next, Kind::Jump, Kind::Next, Kind::Slow];

/// Modes to sample until the next update.
#[derive(Debug)]
pub(super) struct Samples {
    /// Random orders of the modes of a group.
    orders: Vec<Vec<usize>>,
    /// Modes of a group.
    group: usize,
    /// By group, the place in the orders.
    places: Vec<usize>,
    /// The groups that sampled last.
    next: usize,
    jump: usize,
    turn: usize,
    /// By [`Kind`].
    waiting: [Waiting; 3],
}

impl Samples {
    /// Creates it for so many modes in groups of equal size.
    pub(super) fn new(mut rng: Draws, modes: usize, groups: usize) -> Self {
        let group = modes / groups;
        let size = group.max(GROUP);
        let mut order = || {
            let mut order = vec![None; size];
            for mode in 0..size {
                let mut place = (mode + (rng.unit() * 256.0) as usize) % size;
                while order[place].is_some() {
                    place = (place + 1) % size;
                }
                order[place] = Some(mode);
            }
            order.into_iter().flatten().collect()
        };
        let orders = (0..COLUMNS).map(|_| order()).collect();
        Self {
            orders,
            group,
            places: vec![0; groups],
            next: 0,
            jump: 0,
            turn: 0,
            waiting: Default::default(),
        }
    }

    /// Returns the mode to sample now; `None` if none of the kind whose turn it is waits.
    pub(super) fn next(&mut self) -> Option<usize> {
        let kind = TURNS[self.turn];
        self.turn = (self.turn + 1) % TURNS.len();
        self.waiting[kind as usize].0.iter_mut().find_map(Option::take)
    }

    /// Looks for modes to sample, given the two modes with the highest throughputs and the most reliable one.
    pub(super) fn refill(&mut self, modes: &[ModeStatistics], best: [usize; 2], reliable: usize) {
        let ns = |mode: usize| modes[mode].duration_ns;
        let in_use = [best[0], best[1], reliable].map(ns);
        let fast = *in_use.iter().min().expect("three modes");
        let slow = *in_use.iter().max().expect("three modes");

        let next = &mut self.waiting[Kind::Next as usize];
        let mut kept = next.retain(|mode| ns(mode) < fast);
        while kept < WAITING {
            let groups = self.places.len();
            let found = (0..groups).find_map(|_| {
                self.next = (self.next + 1) % groups;
                let mut of_group = self.next * self.group..(self.next + 1) * self.group;
                let faster = of_group.find(|mode| ns(*mode) < ns(best[0]));
                faster.filter(|mode| !next.contains(*mode))
            });
            next.0[kept] = found;
            if found.is_none() {
                break;
            }
            kept += 1;
        }

        let mut kept = self.waiting[Kind::Jump as usize].retain(|mode| ns(mode) < fast);
        let mut kept_slow =
            self.waiting[Kind::Slow as usize].retain(|mode| (fast + 1..slow).contains(&ns(mode)));
        while kept < WAITING {
            let jump = self.draw(modes, fast, slow, &mut kept_slow);
            self.waiting[Kind::Jump as usize].0[kept] = jump;
            if jump.is_none() {
                break;
            }
            kept += 1;
        }
    }

    /// Draws a mode of each group at random, up to one that is faster than all in use, which it returns. It keeps those that
    /// are between them, and drops the others.
    fn draw(
        &mut self,
        modes: &[ModeStatistics],
        fast: u32,
        slow: u32,
        kept_slow: &mut usize,
    ) -> Option<usize> {
        let slowest = if *kept_slow < WAITING { slow } else { fast };
        let groups = self.places.len();
        for _ in 0..groups {
            self.jump = (self.jump + 1) % groups;
            let first = self.jump * self.group;
            let of_group = &modes[first..first + self.group];
            let least = of_group.iter().position(|mode| mode.duration_ns < slowest);
            let mode = least.and_then(|least| self.next_in_order(self.jump, least));
            let Some(mode) = mode.map(|mode| first + mode) else { continue };
            if modes[mode].duration_ns < fast {
                if !self.waiting[Kind::Jump as usize].contains(mode) {
                    return Some(mode);
                }
                continue;
            }
            let waiting = &mut self.waiting[Kind::Slow as usize];
            let has_room = *kept_slow < WAITING;
            if has_room && !waiting.contains(mode) && modes[mode].probability <= 95 * ONE / 100 {
                waiting.0[*kept_slow] = Some(mode);
                *kept_slow += 1;
            }
        }
        None
    }

    /// Returns the next mode of a group's random orders from `least` on, if one of the next is, counted from the group's
    /// first.
    fn next_in_order(&mut self, group: usize, least: usize) -> Option<usize> {
        let size = self.orders[0].len();
        for _ in 0..size {
            let place = self.places[group];
            let mode = self.orders[place / size][place % size];
            self.places[group] = (place + 1) % (COLUMNS * size);
            if (least..self.group).contains(&mode) {
                return Some(mode);
            }
        }
        None
    }
}

/// Modes that wait to be sampled. Sampled ones leave a gap until the next update.
#[derive(Debug, Default)]
struct Waiting([Option<usize>; WAITING]);

impl Waiting {
    fn contains(&self, mode: usize) -> bool {
        self.0.iter().map_while(|waiting| *waiting).any(|waiting| waiting == mode)
    }

    /// Removes modes and closes the gaps. Returns where to go on filling. As in Linux, a first mode without a gap before it
    /// does not count, so that the next one replaces it.
    fn retain(&mut self, keep: impl Fn(usize) -> bool) -> usize {
        let mut kept = 0;
        for i in 0..WAITING {
            let Some(mode) = self.0[i] else { continue };
            if !keep(mode) {
                self.0[i] = None;
            } else if i != kept {
                self.0[i] = None;
                self.0[kept] = Some(mode);
                kept += 1;
            }
        }
        kept
    }
}
