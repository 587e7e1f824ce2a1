//! The choice of modes to sample. At each update, it looks for modes that may be better than those in use. Of six samples,
//! three try the next faster mode, two try any faster mode, and one tries a mode between those in use.

use cotorra_numbers::Draws;

use super::{super::phy::MAX_MODES, ModeStatistics, ONE};

/// Modes of a group in Linux, and columns of its table of random orders.
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

const _: () = assert!(MAX_MODES <= GROUP);

/// Modes to sample until the next update.
#[derive(Debug)]
pub(super) struct Samples {
    /// Random orders of the modes, and the place in them.
    orders: [[usize; GROUP]; COLUMNS],
    place: usize,
    turn: usize,
    /// By [`Kind`].
    waiting: [Waiting; 3],
}

impl Samples {
    pub(super) fn new(mut rng: Draws) -> Self {
        let orders = std::array::from_fn(|_| {
            let mut order = [None; GROUP];
            for mode in 0..GROUP {
                let mut place = (mode + (rng.unit() * 256.0) as usize) % GROUP;
                while order[place].is_some() {
                    place = (place + 1) % GROUP;
                }
                order[place] = Some(mode);
            }
            order.map(|mode| mode.expect("each place has a mode"))
        });
        Self { orders, place: 0, turn: 0, waiting: Default::default() }
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
            let faster = (0..modes.len()).find(|mode| ns(*mode) < ns(best[0]));
            next.0[kept] = faster.filter(|mode| !next.contains(*mode));
            if next.0[kept].is_none() {
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

    /// Draws a mode at random. Returns it if it is faster than all in use, keeps it if it is between them, and drops it
    /// otherwise.
    fn draw(
        &mut self,
        modes: &[ModeStatistics],
        fast: u32,
        slow: u32,
        kept_slow: &mut usize,
    ) -> Option<usize> {
        let has_room = *kept_slow < WAITING;
        let slowest = if has_room { slow } else { fast };
        let least = modes.iter().position(|mode| mode.duration_ns < slowest)?;
        let mode = self.next_in_order(least, modes.len())?;
        if modes[mode].duration_ns < fast {
            return Some(mode).filter(|mode| !self.waiting[Kind::Jump as usize].contains(*mode));
        }
        let waiting = &mut self.waiting[Kind::Slow as usize];
        if has_room && !waiting.contains(mode) && modes[mode].probability <= 95 * ONE / 100 {
            waiting.0[*kept_slow] = Some(mode);
            *kept_slow += 1;
        }
        None
    }

    /// Returns the next mode of the random orders within `least..modes`, if one of the next ten is.
    fn next_in_order(&mut self, least: usize, modes: usize) -> Option<usize> {
        for _ in 0..GROUP {
            let mode = self.orders[self.place / GROUP][self.place % GROUP];
            self.place = (self.place + 1) % (COLUMNS * GROUP);
            if (least..modes).contains(&mode) {
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
