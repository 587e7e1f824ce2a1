//! The sending end of a TCP connection: what is under way, what of it is lost, and when it is sent again.
//!
//! Loss is found by SACK (RFC 6675) and by timeout (RFC 6298). A segment that was sent again counts as lost if one that was sent
//! later arrived (RFC 8985).

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{CongestionControl, Timestamp};
use cotorra_numbers::Draws;

use crate::{
    bbr::{Bbr, Delivery},
    receiver,
    rtt::{RoundTrips, milliseconds},
    segment::{Block, MSS, Segment, unwrap_near},
    window::{Acknowledgement, Window},
};

/// Segments that must arrive beyond one before it is lost (RFC 6675, DupThresh).
const DUPLICATES: usize = 3;

/// The sending end.
#[derive(Debug, Clone)]
pub(crate) struct Sender {
    control: Control,
    trips: RoundTrips,
    state: State,
    /// First position that is not acknowledged. Position 0 opens the connection.
    acknowledged: u64,
    /// Position of the next new byte.
    next: u64,
    /// End of the data; `None` without one.
    end: Option<u64>,
    flying: VecDeque<Flying>,
    /// Bytes under way: neither arrived nor lost.
    in_flight: u64,
    /// Number of segments in `flying` that arrived.
    arrived: usize,
    /// Number of segments to send again.
    lost: usize,
    /// Whether the next of them is sent whatever the window is (RFC 6675, section 5, 4.3).
    sends_first: bool,
    reduction: Reduction,
    /// When the oldest segment counts as lost.
    timer: Option<Timestamp>,
    /// When pacing allows the next segment.
    paced: Timestamp,
    delivered: u64,
    delivered_at: Timestamp,
    /// When the latest segment that arrived was sent.
    latest_sent: Timestamp,
    /// Time of the receiver, which segments answer.
    answered: u32,
    counts: Counts,
}

/// What a sender did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Counts {
    /// Segments with data, those that were sent again included.
    pub sent: u64,
    /// Segments with data that were sent again.
    pub retransmitted: u64,
    /// Timeouts.
    pub timeouts: u64,
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.sent += other.sent;
        self.retransmitted += other.retransmitted;
        self.timeouts += other.timeouts;
    }
}

#[derive(Debug, Clone)]
enum Control {
    Window(Window),
    Bbr(Box<Bbr>),
}

/// Whether the sender recovers from a loss. It does until all that was sent before is acknowledged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Open,
    /// From one that was found by SACK.
    Recovery(u64),
    /// From a timeout.
    Timeout(u64),
}

/// Proportional rate reduction (RFC 6937): what a sender with a window sends while it recovers, so that it neither bursts nor
/// sends more than arrives.
#[derive(Debug, Clone, Copy, Default)]
struct Reduction {
    /// Bytes under way when recovery began (RecoverFS).
    before: u64,
    /// Bytes that arrived since (prr_delivered).
    arrived: u64,
    /// Bytes that were sent since (prr_out).
    sent: u64,
    /// Bytes that may be sent now (sndcnt).
    allowed: u64,
}

impl Reduction {
    /// Takes bytes that newly arrived, with so many under way and so many aimed at (ssthresh). `is_safe` says whether the
    /// acknowledgement advanced, and found no more losses.
    fn acknowledged(&mut self, bytes: u64, in_flight: u64, aim: u64, is_safe: bool) {
        self.arrived += bytes;
        self.allowed = if in_flight > aim {
            (self.arrived * aim).div_ceil(self.before.max(1)).saturating_sub(self.sent)
        } else {
            let conserved = self.arrived.saturating_sub(self.sent);
            let limit = if is_safe { conserved.max(bytes) + MSS } else { conserved };
            limit.min(aim - in_flight)
        };
    }

    fn send(&mut self, bytes: u64) {
        self.sent += bytes;
        self.allowed = self.allowed.saturating_sub(bytes);
    }
}

/// A segment that is not acknowledged.
#[derive(Debug, Clone, Copy)]
struct Flying {
    start: u64,
    end: u64,
    sent: Timestamp,
    tries: u32,
    arrived: bool,
    lost: bool,
    /// State of the connection when it was sent (draft-cheng-iccrg-delivery-rate-estimation-00).
    delivered: u64,
    delivered_at: Timestamp,
    latest_sent: Timestamp,
    is_limited: bool,
}

impl Flying {
    fn bytes(&self) -> u64 {
        self.end - self.start
    }
}

/// What an acknowledgement newly told.
#[derive(Debug, Default)]
struct News {
    bytes: u64,
    /// The segment that was sent last of those that arrived.
    latest: Option<Flying>,
    /// When the latest that was sent once was sent.
    once: Option<Timestamp>,
}

impl News {
    fn add(&mut self, segment: &Flying) {
        self.bytes += segment.bytes();
        if self
            .latest
            .is_none_or(|latest| (latest.delivered, latest.sent) <= (segment.delivered, segment.sent))
        {
            self.latest = Some(*segment);
        }
        if segment.tries == 1 {
            self.once = self.once.max(Some(segment.sent));
        }
    }
}

impl Sender {
    /// Creates the end of a connection that sends so many bytes, or without an end. `draws` serve BBR.
    pub(crate) fn new(congestion_control: CongestionControl, bytes: Option<u64>, draws: Draws) -> Self {
        let control = match congestion_control {
            CongestionControl::Reno => Control::Window(Window::reno()),
            CongestionControl::Cubic => Control::Window(Window::cubic()),
            CongestionControl::Bbr => Control::Bbr(Box::new(Bbr::new(draws))),
        };
        Self {
            control,
            trips: RoundTrips::default(),
            state: State::Open,
            acknowledged: 0,
            next: 0,
            end: bytes.map(|bytes| 1 + bytes),
            flying: VecDeque::new(),
            in_flight: 0,
            arrived: 0,
            lost: 0,
            sends_first: false,
            reduction: Reduction::default(),
            timer: None,
            paced: Timestamp::ZERO,
            delivered: 0,
            delivered_at: Timestamp::ZERO,
            latest_sent: Timestamp::ZERO,
            answered: 0,
            counts: Counts::default(),
        }
    }

    pub(crate) fn counts(&self) -> Counts {
        self.counts
    }

    pub(crate) fn round_trips(&self) -> &RoundTrips {
        &self.trips
    }

    /// Sends no new data any more.
    pub(crate) fn stop(&mut self) {
        self.end = Some(self.end.unwrap_or(u64::MAX).min(self.next.max(1)));
    }

    /// Sends so many more bytes, if their number is bounded.
    pub(crate) fn add(&mut self, bytes: u64) {
        self.end = self.end.map(|end| end.saturating_add(bytes));
    }

    /// Whether so many bytes are acknowledged.
    pub(crate) fn has_delivered(&self, bytes: u64) -> bool {
        self.acknowledged > bytes
    }

    /// Returns when [`Self::poll`] has something to send.
    pub(crate) fn deadline(&self, now: Timestamp) -> Option<Timestamp> {
        let next = self.has_room().then(|| self.paced.max(now));
        next.into_iter().chain(self.timer).min()
    }

    /// Returns the next segment to send now. Call it until there is none.
    pub(crate) fn poll(&mut self, now: Timestamp) -> Option<Segment> {
        if self.timer.is_some_and(|at| at <= now) {
            self.time_out(now);
        }
        if !self.has_room() || self.paced > now {
            return None;
        }
        self.sends_first = false;
        let place = match self.lost {
            0 => self.append(),
            _ => self.flying.iter().position(|segment| segment.lost)?,
        };
        Some(self.send(now, place))
    }

    /// Takes an acknowledgement. Returns the round trip that it measures.
    pub(crate) fn handle(&mut self, now: Timestamp, segment: &Segment) -> Option<Duration> {
        let ack = segment.ack.and_then(|ack| unwrap_near(self.acknowledged, ack))?;
        if ack > self.next {
            return None;
        }
        self.answered = segment.times.0;
        let before = self.acknowledged;
        let news = self.mark_arrived(ack, &segment.sacked);
        self.delivered += news.bytes;
        if news.bytes > 0 {
            self.delivered_at = now;
        }
        let mut rate = None;
        if let Some(latest) = news.latest {
            rate = self.rate(now, &latest);
            // An original may have arrived after its copy was sent.
            let is_copy =
                latest.tries == 1 || self.trips.least().is_none_or(|least| now.since(latest.sent) >= least);
            if is_copy {
                self.latest_sent = self.latest_sent.max(latest.sent);
            }
        }
        let round_trip = news.once.map(|sent| now.since(sent));
        if let Some(sample) = round_trip {
            self.trips.add(sample);
        }
        let lost = self.find_lost();
        if matches!(self.state, State::Recovery(point) | State::Timeout(point) if ack >= point) {
            self.state = State::Open;
            if let Control::Bbr(bbr) = &mut self.control {
                bbr.recovered();
            }
        }
        if lost > 0 && self.state == State::Open {
            self.recover(self.in_flight + lost + news.bytes);
        }
        self.steer(now, &news, lost, rate, round_trip);
        if let (State::Recovery(_), Control::Window(window)) = (self.state, &self.control) {
            let aim = (window.size() * MSS as f64) as u64;
            let is_safe = self.acknowledged > before && lost == 0;
            self.reduction.acknowledged(news.bytes, self.in_flight, aim, is_safe);
        }
        // RFC 6298, 5.2 and 5.3.
        if self.acknowledged > before {
            self.timer = (!self.flying.is_empty()).then(|| now + self.trips.timeout());
        }
        round_trip
    }

    /// Lets the congestion control react.
    fn steer(
        &mut self,
        now: Timestamp,
        news: &News,
        lost: u64,
        rate: Option<(f64, bool)>,
        round_trip: Option<Duration>,
    ) {
        match &mut self.control {
            Control::Window(window) => {
                let segments = news.bytes as f64 / MSS as f64;
                let ack = Acknowledgement {
                    segments,
                    used: self.in_flight as f64 / MSS as f64 + segments,
                    round_trip: self.trips.smoothed().unwrap_or_default(),
                    sample: round_trip,
                    positions: [self.acknowledged, self.next],
                };
                if !matches!(self.state, State::Recovery(_)) {
                    window.acknowledged(now, &ack);
                }
            }
            Control::Bbr(bbr) => {
                let Some(latest) = news.latest else { return };
                let delivery = Delivery {
                    bytes: news.bytes as f64,
                    lost: lost as f64,
                    in_flight: self.in_flight as f64,
                    delivered: self.delivered,
                    delivered_before: latest.delivered,
                    rate,
                    round_trip,
                };
                bbr.acknowledged(now, &delivery);
            }
        }
    }

    /// Whether the window has room for a segment that is there to send.
    fn has_room(&self) -> bool {
        let length = match self.lost {
            0 if self.next == 0 => 1,
            // Data follows the opened connection.
            0 if self.acknowledged == 0 => return false,
            0 => self.end.map_or(MSS, |end| end.saturating_sub(self.next).min(MSS)),
            _ => MSS,
        };
        let window = match &self.control {
            Control::Window(_) if matches!(self.state, State::Recovery(_)) => {
                self.in_flight + self.reduction.allowed
            }
            Control::Window(window) => (window.size() * MSS as f64) as u64,
            Control::Bbr(bbr) => bbr.window() as u64,
        };
        let is_received = self.lost > 0 || self.next + length <= self.acknowledged + receiver::WINDOW;
        let fits = self.in_flight + length <= window || self.in_flight == 0;
        length > 0 && is_received && (fits || (self.sends_first && self.lost > 0))
    }

    /// Adds new data to what is under way, and returns its place.
    fn append(&mut self) -> usize {
        let start = self.next;
        let end = match start {
            0 => 1,
            _ => self.end.unwrap_or(u64::MAX).min(start + MSS),
        };
        self.next = end;
        self.flying.push_back(Flying {
            start,
            end,
            sent: Timestamp::ZERO,
            tries: 0,
            arrived: false,
            lost: false,
            delivered: 0,
            delivered_at: Timestamp::ZERO,
            latest_sent: Timestamp::ZERO,
            is_limited: false,
        });
        self.flying.len() - 1
    }

    fn send(&mut self, now: Timestamp, place: usize) -> Segment {
        if self.in_flight == 0 {
            (self.delivered_at, self.latest_sent) = (now, now);
        }
        let has_no_more = self.lost == 0 && self.end.is_some_and(|end| self.next >= end);
        let is_limited =
            has_no_more || matches!(&self.control, Control::Bbr(bbr) if bbr.leaves_queue_empty());
        let segment = &mut self.flying[place];
        self.lost -= usize::from(segment.lost);
        segment.lost = false;
        segment.tries += 1;
        (segment.sent, segment.is_limited) = (now, is_limited);
        (segment.delivered, segment.delivered_at) = (self.delivered, self.delivered_at);
        segment.latest_sent = self.latest_sent;
        let (start, bytes, tries) = (segment.start, segment.bytes(), segment.tries);
        self.in_flight += bytes;
        self.reduction.send(bytes);
        let syn = start == 0;
        if !syn {
            self.counts.sent += 1;
            self.counts.retransmitted += u64::from(tries > 1);
        }
        if let Control::Bbr(bbr) = &self.control {
            self.paced = now + Duration::from_secs_f64(bytes as f64 / bbr.rate().max(1.0));
        }
        let due = now + self.trips.timeout();
        match place == 0 && tries > 1 {
            // A copy of the first segment has a round trip of its own, as in Linux (`tcp_xmit_retransmit_queue`).
            true => self.timer = Some(due),
            false => _ = self.timer.get_or_insert(due),
        }
        Segment {
            syn,
            sequence: start as u32,
            ack: (!syn).then_some(1),
            times: (milliseconds(now), self.answered),
            payload: if syn { 0 } else { bytes as usize },
            ..Segment::default()
        }
    }

    /// Marks what arrived, and returns what is new of it.
    fn mark_arrived(&mut self, ack: u64, sacked: &[Block]) -> News {
        let mut news = News::default();
        while let Some(segment) = self.flying.front().filter(|segment| segment.end <= ack).copied() {
            self.flying.pop_front();
            if segment.arrived {
                self.arrived -= 1;
            } else {
                news.add(&segment);
                self.settle(&segment);
            }
        }
        self.acknowledged = self.acknowledged.max(ack);
        for &(start, end) in sacked {
            let near = |bits| unwrap_near(self.acknowledged, bits);
            let (Some(start), Some(end)) = (near(start), near(end)) else { continue };
            let first = self.flying.partition_point(|segment| segment.start < start);
            for place in first..self.flying.len() {
                let segment = self.flying[place];
                if segment.end > end {
                    break;
                }
                if !segment.arrived {
                    news.add(&segment);
                    self.settle(&segment);
                    (self.flying[place].arrived, self.flying[place].lost) = (true, false);
                    self.arrived += 1;
                }
            }
        }
        news
    }

    /// Takes a segment that arrived out of the counts.
    fn settle(&mut self, segment: &Flying) {
        match segment.lost {
            true => self.lost -= 1,
            false => self.in_flight -= segment.bytes(),
        }
    }

    /// Returns the rate of delivery until now, bytes/s, and whether something else than the path limited it.
    fn rate(&self, now: Timestamp, latest: &Flying) -> Option<(f64, bool)> {
        let sending = latest.sent.since(latest.latest_sent);
        let arriving = now.since(latest.delivered_at);
        let interval = sending.max(arriving);
        let is_long = !interval.is_zero() && self.trips.least().is_none_or(|least| interval >= least);
        let bytes = (self.delivered - latest.delivered) as f64;
        // The segment that opens the connection tells nothing of the rate.
        (is_long && latest.start > 0).then(|| (bytes / interval.as_secs_f64(), latest.is_limited))
    }

    /// Finds segments that are newly lost, and returns their bytes.
    fn find_lost(&mut self) -> u64 {
        // Position from which fewer than three segments arrived.
        let mut cut = 0;
        if self.arrived >= DUPLICATES {
            let mut beyond = 0;
            cut = self.flying.len();
            while beyond < DUPLICATES {
                cut -= 1;
                beyond += usize::from(self.flying[cut].arrived);
            }
        } else if self.state == State::Open {
            return 0;
        }
        let reordered = self.trips.least().unwrap_or_default() / 4;
        let latest_sent = self.latest_sent;
        let (mut bytes, mut number) = (0, 0);
        for (place, segment) in self.flying.iter_mut().enumerate() {
            let is_lost = match segment.tries {
                1 => place < cut,
                _ => latest_sent > segment.sent + reordered,
            };
            if is_lost && !segment.arrived && !segment.lost {
                segment.lost = true;
                bytes += segment.bytes();
                number += 1;
            }
        }
        self.in_flight -= bytes;
        self.lost += number;
        bytes
    }

    /// Begins to recover from a loss, with so many bytes under way before it.
    fn recover(&mut self, before: u64) {
        let flight = self.flight();
        self.reduction = Reduction { before, ..Reduction::default() };
        self.state = State::Recovery(self.next);
        self.sends_first = true;
        match &mut self.control {
            Control::Window(window) => window.lost(flight),
            Control::Bbr(bbr) => bbr.lost(self.in_flight as f64),
        }
    }

    /// Returns the segments outstanding (RFC 5681, FlightSize).
    fn flight(&self) -> f64 {
        (self.next - self.acknowledged) as f64 / MSS as f64
    }

    fn time_out(&mut self, now: Timestamp) {
        self.timer = None;
        self.trips.back_off();
        if self.flying.is_empty() {
            return;
        }
        self.counts.timeouts += 1;
        let flight = self.flight();
        let is_first = !matches!(self.state, State::Timeout(_));
        self.state = State::Timeout(self.next);
        for segment in &mut self.flying {
            if !segment.arrived && !segment.lost {
                segment.lost = true;
                self.lost += 1;
            }
        }
        self.in_flight = 0;
        self.paced = now;
        match &mut self.control {
            Control::Window(window) => window.timed_out(flight, is_first),
            Control::Bbr(bbr) => bbr.timed_out(),
        }
    }
}
