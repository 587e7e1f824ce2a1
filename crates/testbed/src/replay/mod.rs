//! A recorded run, played through the API as if it went on: so that a plug-in can be developed against it. What was
//! decided is played, too; what anyone asks for now is refused and told, and changes nothing.

use std::{
    collections::{BTreeMap, VecDeque},
    net::{Ipv4Addr, SocketAddr},
    ops::Bound,
    path::Path,
    sync::{Arc, mpsc},
    time::Duration,
};

use cotorra_graph::{Decision, Event, Stamped, Testbed, Timestamp};
use cotorra_measurements::{GraphState, History, PageRequest, RunId, Sample};
use cotorra_network_control::Refused;
use cotorra_recording::{Pace, Recording, RecordingError, Tap, Wanted};
use tokio::sync::broadcast;

use crate::{
    api::{self, ApiError, Follower, Listener, Lockstep, Server, Tokens, Told},
    core_loop::Message,
    live::Live,
    run::{about, epoch},
};

/// Events that wait for a reader that nobody waits for; one that is further behind misses the oldest.
const STREAM: usize = 4096;
/// How often it is asked whether to go on.
const LOOK: Duration = Duration::from_millis(50);
/// A follower that says nothing for so long while time waits for it is left behind.
const PATIENCE: Duration = Duration::from_secs(60);
/// Events between two questions to the history.
const STEP: usize = 1000;
const REFUSAL: &str = "this is a replay: what was recorded is played, and nothing can change it";

/// How fast a run is played.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Speed {
    /// So many seconds of the run in one.
    Times(f64),
    /// As fast as those who follow take it in, by the marks of virtual time.
    Max {
        /// So many must follow, each under a name, before it begins.
        followers: usize,
    },
}

/// How a run is to be played.
#[derive(Debug, Clone)]
pub struct ReplayOptions {
    /// Where the API listens; by default on 127.0.0.1:7700, or the next free port if that is taken.
    pub api: Option<SocketAddr>,
    /// What callers of the API must show.
    pub tokens: Tokens,
    /// How fast.
    pub speed: Speed,
    /// From here on; what was before is known at the beginning.
    pub from: Timestamp,
    /// Up to here, this excluded.
    pub to: Option<Timestamp>,
    /// Where what is played is served to Foxglove, too.
    pub foxglove: Option<SocketAddr>,
}

/// What happens in a replay.
#[derive(Debug)]
pub enum Played<'a> {
    /// It is this time of the run.
    Time(Timestamp),
    /// Somebody asked for something, which is refused.
    Refused(&'a Stamped),
    /// A follower was silent for too long, and is not waited for any more.
    LeftBehind(&'a str),
}

/// How a replay ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReplayEnd {
    /// All was played.
    Played,
    /// All who followed went away.
    Alone,
    /// It was not to go on.
    Stopped,
}

/// A run that is ready to be played.
pub struct Replay {
    server: Server,
    inbox: mpsc::Receiver<Message>,
    history: Arc<History>,
    run: RunId,
    live: Live,
    stream: broadcast::Sender<Arc<Stamped>>,
    options: ReplayOptions,
    watched: Option<Recording>,
    tap: Option<Tap>,
    followers: Vec<Following>,
    marks: u64,
    now: Timestamp,
}

/// Somebody whom time waits for.
struct Following {
    follower: Follower,
    untold: Vec<Arc<Stamped>>,
    owes: Option<u64>,
    wake_at: Option<Timestamp>,
    due: bool,
}

impl Replay {
    /// Serves the API of a run that is about to be played.
    ///
    /// # Errors
    /// [`ApiError`] when it cannot be served; the history's errors.
    pub fn new(
        testbed: Testbed,
        history: History,
        run: RunId,
        options: ReplayOptions,
    ) -> Result<Self, ReplayError> {
        let default = SocketAddr::from((Ipv4Addr::LOCALHOST, 7700));
        let address = options.api.unwrap_or(default);
        let listener = Listener::bind(address, options.api.is_none(), &options.tokens)?;
        let (history, live) = (Arc::new(history), Live::default());
        let testbed = Arc::new(testbed);
        let wanted = Wanted { file: None, foxglove: options.foxglove };
        let info = history.run(run)?.info;
        let watched = Recording::begin(&wanted, Path::new(""), &testbed, about(&info), Pace::Live)?;
        let tap = watched.as_ref().map(Recording::tap);
        let before = Timestamp::from_nanos(options.from.as_nanos().saturating_sub(1));
        if options.from > Timestamp::ZERO {
            know(&live, tap.as_ref(), history.state_at(run, before)?);
        }
        let (core, inbox) = mpsc::channel();
        let (stream, _) = broadcast::channel(STREAM);
        let epoch = epoch(&history.run(run)?.info);
        let waits = matches!(options.speed, Speed::Max { .. });
        let context = api::Context {
            testbed,
            live: live.clone(),
            history: Arc::clone(&history),
            run,
            events: stream.clone(),
            core,
            namespaces: Arc::new(BTreeMap::new()),
            lockstep: waits.then_some(Lockstep { plugins: None, recorder: None }),
            replay: true,
            wais: api::WaisOptions { epoch, ..Default::default() },
        };
        let server = Server::start(listener, context, options.tokens.clone())?;
        let (followers, now) = (Vec::new(), options.from);
        let marks = 0;
        Ok(Self { server, inbox, history, run, live, stream, options, watched, tap, followers, marks, now })
    }

    /// Where the API listens.
    pub fn api_address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Where it serves Foxglove, if it does.
    pub fn foxglove_address(&self) -> Option<SocketAddr> {
        self.watched.as_ref().and_then(Recording::foxglove)
    }

    /// Plays the run. `tell` is told what happens, at least several times a second, and says whether to go on.
    ///
    /// # Errors
    /// The history's.
    #[allow(clippy::disallowed_types, reason = "a replay at a speed goes by the wall clock")]
    pub fn play(mut self, mut tell: impl FnMut(Played<'_>) -> bool) -> Result<ReplayEnd, ReplayError> {
        let awaited = match self.options.speed {
            Speed::Max { followers } => followers,
            Speed::Times(_) => 0,
        };
        while self.followers.len() < awaited {
            if !self.listen(LOOK, &mut tell) {
                return Ok(ReplayEnd::Stopped);
            }
        }
        let began = std::time::Instant::now();
        let end = self.options.to.map_or(Bound::Unbounded, Bound::Excluded);
        let mut request = PageRequest::first(STEP);
        let mut moment: VecDeque<Stamped> = VecDeque::new();
        loop {
            let range = (Bound::Included(self.options.from), end);
            let page = self.history.events(self.run, &[], range, request)?;
            moment.extend(page.items);
            // The last moment of a page may go on in the next one.
            let open = page.next.and(moment.back().map(|last| last.at));
            while let Some(at) = moment.front().map(|event| event.at).filter(|at| Some(*at) != open) {
                if let Speed::Times(speed) = self.options.speed {
                    let due = began + at.since(self.options.from).div_f64(speed);
                    while let Some(left) = due.checked_duration_since(std::time::Instant::now())
                        && !left.is_zero()
                    {
                        if !self.listen(left.min(LOOK), &mut tell) {
                            return Ok(ReplayEnd::Stopped);
                        }
                    }
                }
                while let Some(wake) =
                    self.followers.iter().filter_map(|f| f.wake_at).min().filter(|w| *w < at)
                {
                    self.now = self.now.max(wake);
                    if let Some(end) = self.settle(awaited, &mut tell) {
                        return Ok(end);
                    }
                }
                self.now = at;
                while let Some(event) = moment.pop_front_if(|event| event.at == at) {
                    self.publish(event);
                }
                if let Some(end) = self.settle(awaited, &mut tell) {
                    return Ok(end);
                }
            }
            let Some(next) = page.next else { return Ok(ReplayEnd::Played) };
            request = PageRequest::after(next, STEP);
        }
    }

    fn publish(&mut self, event: Stamped) {
        self.live.absorb(&event);
        let event = Arc::new(event);
        for following in &mut self.followers {
            following.untold.extend(following.follower.sees(&event));
        }
        if let Some(tap) = &self.tap {
            tap.event(Arc::clone(&event));
        }
        // Nobody may be listening.
        let _ = self.stream.send(event);
    }

    /// Lets those who follow take in what happened up to now, one after the other; gives the end if this is it.
    #[allow(clippy::disallowed_types, reason = "followers run on the wall clock, and may hang there")]
    fn settle(&mut self, awaited: usize, tell: &mut impl FnMut(Played<'_>) -> bool) -> Option<ReplayEnd> {
        let now = self.now;
        for following in &mut self.followers {
            following.due |= following.wake_at.take_if(|at| *at <= now).is_some();
        }
        if !self.listen(Duration::ZERO, tell) {
            return Some(ReplayEnd::Stopped);
        }
        while let Some(place) = self.followers.iter().position(|f| f.due || !f.untold.is_empty()) {
            self.marks += 1;
            let following = &mut self.followers[place];
            (following.owes, following.due) = (Some(self.marks), false);
            let (follower, mark) = (&following.follower, Told::Mark { number: self.marks, now });
            let mut told = following.untold.drain(..).map(Told::Event).chain([mark]);
            let mut is_there = told.all(|told| follower.tell(told));
            drop(told);
            let asked = std::time::Instant::now();
            while is_there && self.followers[place].owes.is_some() {
                if !self.listen(LOOK, tell) {
                    return Some(ReplayEnd::Stopped);
                }
                is_there = !self.followers[place].follower.is_gone();
                if asked.elapsed() > PATIENCE {
                    is_there = false;
                    tell(Played::LeftBehind(self.followers[place].follower.plugin.as_str()));
                }
            }
            if !is_there {
                self.followers.remove(place);
            }
        }
        self.followers.retain(|following| !following.follower.is_gone());
        (awaited > 0 && self.followers.is_empty()).then_some(ReplayEnd::Alone)
    }

    /// Hears what is said within a time, at least what was said already; gives whether to go on.
    fn listen(&mut self, within: Duration, tell: &mut impl FnMut(Played<'_>) -> bool) -> bool {
        let mut next = self.inbox.recv_timeout(within).ok();
        while let Some(message) = next {
            match message {
                Message::Follow(follower) => {
                    let (untold, owes, wake_at) = (Vec::new(), None, None);
                    self.followers.push(Following { follower, untold, owes, wake_at, due: true });
                }
                Message::Done { mark, wake_at } => {
                    let following = self.followers.iter_mut().find(|f| f.owes == Some(mark));
                    if let Some(following) = following {
                        (following.owes, following.wake_at) = (None, wake_at);
                    }
                }
                Message::Instruct { plugin, instruction, reason, reply } => {
                    let refused = Some(REFUSAL.to_owned());
                    let event = Event::Decision(Decision { plugin, instruction, reason, refused });
                    let goes_on = tell(Played::Refused(&Stamped { at: self.now, event }));
                    if let Some(reply) = reply {
                        reply(Err(Refused(REFUSAL.to_owned())));
                    }
                    if !goes_on {
                        return false;
                    }
                }
                _ => {}
            }
            next = self.inbox.try_recv().ok();
        }
        tell(Played::Time(self.now))
    }
}

/// Makes a state known as what happened last.
fn know(live: &Live, tap: Option<&Tap>, state: GraphState) {
    let told = |event: Stamped| {
        live.absorb(&event);
        if let Some(tap) = tap {
            tap.event(Arc::new(event));
        }
    };
    fn each<T>(told: impl Fn(Stamped), samples: Vec<Sample<T>>, event: impl Fn(T) -> Event) {
        for Sample { at, value } in samples {
            told(Stamped { at, event: event(value) });
        }
    }
    each(told, state.placements, Event::Placement);
    each(told, state.virtual_links, Event::VirtualLink);
    each(told, state.robots, Event::Robot);
    each(told, state.radio_units, Event::Radio);
    each(told, state.links, Event::Link);
}

/// Why a run cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The API.
    #[error(transparent)]
    Api(#[from] ApiError),
    /// Who watches.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The history.
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
}
