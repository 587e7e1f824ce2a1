//! The attachment of one station, as a state machine: its radio unit, and the phases of scans and handovers off the
//! channel.

use std::time::Duration;

use cotorra_graph::{Frames, HandoverTimes, ScanVisits, Timestamp, WirelessNetwork};
use cotorra_numbers::Draws;

use super::exchange::{Fate, Message};
use crate::port::RadioUnitIndex;

/// Waits for the radio unit's answer to a management frame (`IEEE80211_AUTH_TIMEOUT` and `IEEE80211_ASSOC_TIMEOUT` in Linux's
/// `net/mac80211/mlme.c`), and after the frame was acknowledged (`…_TIMEOUT_SHORT`).
const ANSWER: Duration = Duration::from_millis(200);
const ANSWER_ONCE_ACKNOWLEDGED: Duration = Duration::from_millis(100);
/// Wait of the radio unit for the station's next key message (hostapd's `eapol_key_timeout_subseq`).
const KEY_ANSWER: Duration = Duration::from_secs(1);
/// Sendings of a frame without an answer, before the handover is given up (`IEEE80211_AUTH_MAX_TRIES`).
const SENDINGS: u32 = 3;
/// Time that the kernel of a radio unit needs at the least to forget what it knew of a station that comes by fast
/// transition, before hostapd answers at the next tick. Measured with Linux 6.1 and hostapd 2.10: answers came 2.6 to 6.4 ms
/// after the request.
const FORGETTING: Duration = Duration::from_micros(2300);

/// Age of a scan's result up to which a station associates by it (wpa_supplicant's `scan_res_valid_for_connect`).
const VALID: Duration = Duration::from_secs(5);

/// The purpose of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// To update the signals.
    Look,
    /// To attach to the radio unit that the station chooses then, if it is another one.
    Roam,
    /// To attach to a radio unit, as requested during the scan.
    Attach(RadioUnitIndex),
}

/// The activity of a busy station.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// On other channels, and then this much more of the scan.
    Scan(Purpose, Duration),
    /// Back on its channel, and then this much more of the scan.
    Pause(Purpose, Duration),
    HandOver(Stage, RadioUnitIndex),
    /// Waiting for a frame of a handover.
    Exchange(Exchange, RadioUnitIndex),
}

/// A stage of a handover.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Authenticate,
    Reassociate,
    Handshake,
}

/// Phase of a station in a handover whose frames are on the air.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Exchange {
    /// The frame to send when the phase ends: the next one, or once more the one without an answer.
    next: Message,
    /// Times that it was sent.
    sendings: u32,
    /// A frame that the other side sends, and when.
    reply: Option<(Timestamp, Message)>,
    /// Whether all is done, by fast transition or not.
    done: Option<bool>,
}

/// A phase under way.
#[derive(Debug, Clone, Copy)]
struct Activity {
    /// When the station left its channel.
    left: Timestamp,
    phase: Phase,
    ends: Timestamp,
}

/// The result of a finished phase.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// The next phase has begun, perhaps back on the channel.
    Underway,
    /// All channels were scanned. The station is back, or goes on to attach.
    Scanned,
    /// The station is attached to another radio unit now.
    Attached(Joined),
    /// A frame of a handover is sent, to or from this radio unit.
    Send(Message, RadioUnitIndex),
    /// Frames of the handover were lost again and again.
    Failed,
}

/// A finished handover.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Joined {
    pub(super) from: Option<RadioUnitIndex>,
    pub(super) to: RadioUnitIndex,
    pub(super) fast: bool,
    /// Time since the station left its channel.
    pub(super) gap: Duration,
}

/// The current activity, which rejects another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Busy {
    Scanning,
    HandingOver(RadioUnitIndex),
}

/// A station's attachment.
///
/// A handover is authentication and reassociation (IEEE 802.11-2020, 11.3), followed by the key handshakes (12.7.6)
/// unless it is a fast transition (13.5). A fast transition needs a former radio unit (13.4): a station that lost its own
/// does the handshakes again. The station stays attached to its former radio unit until the last phase ends.
#[derive(Debug)]
pub(super) struct Station {
    attached: Option<RadioUnitIndex>,
    activity: Option<Activity>,
    /// When the last scan began.
    last_scan: Timestamp,
    /// When it ended.
    scanned: Option<Timestamp>,
    times: HandoverTimes,
    fast_transition: bool,
    rng: Draws,
}

impl Station {
    /// Creates a station without a radio unit.
    pub(super) fn new(network: &WirelessNetwork, rng: Draws) -> Self {
        Self {
            attached: None,
            activity: None,
            last_scan: Timestamp::ZERO,
            scanned: None,
            times: network.handover,
            fast_transition: network.fast_transition,
            rng,
        }
    }

    /// Attaches the station before the run begins.
    pub(super) fn begin_attached(&mut self, to: RadioUnitIndex) {
        self.attached = Some(to);
    }

    /// Returns its radio unit, on or off the channel.
    pub(super) fn attached(&self) -> Option<RadioUnitIndex> {
        self.attached
    }

    /// Returns the radio unit that it can exchange frames with now.
    pub(super) fn on_channel(&self) -> Option<RadioUnitIndex> {
        match self.activity {
            None | Some(Activity { phase: Phase::Pause(..), .. }) => self.attached,
            Some(_) => None,
        }
    }

    /// Whether it scans or hands over. A station that scans may be back on its channel for a while.
    pub(super) fn is_busy(&self) -> bool {
        self.activity.is_some()
    }

    /// Whether it hands over, with its frames on the air.
    pub(super) fn is_exchanging(&self) -> bool {
        self.activity.is_some_and(|a| matches!(a.phase, Phase::Exchange(..)))
    }

    /// Whether it has scanned all channels at the end of the current phase.
    pub(super) fn completes_scan(&self) -> bool {
        self.activity.is_some_and(|a| matches!(a.phase, Phase::Scan(_, Duration::ZERO)))
    }

    /// Returns when [`Self::expire`] is due.
    pub(super) fn deadline(&self) -> Option<Timestamp> {
        self.activity.map(|a| match a.phase {
            Phase::Exchange(Exchange { reply: Some((at, _)), .. }, _) => at.min(a.ends),
            _ => a.ends,
        })
    }

    /// Returns when it next scans by itself to update the signals, if it does.
    pub(super) fn next_scan(&self) -> Option<Timestamp> {
        self.times.scan_every.map(|every| self.last_scan + every)
    }

    fn busy(&self) -> Option<Busy> {
        self.activity.map(|a| match a.phase {
            Phase::Scan(Purpose::Attach(to), _)
            | Phase::Pause(Purpose::Attach(to), _)
            | Phase::HandOver(_, to)
            | Phase::Exchange(_, to) => Busy::HandingOver(to),
            Phase::Scan(..) | Phase::Pause(..) => Busy::Scanning,
        })
    }

    /// Leaves the channel to scan.
    pub(super) fn scan(&mut self, now: Timestamp, purpose: Purpose) -> Result<(), Busy> {
        if let Some(busy) = self.busy() {
            return Err(busy);
        }
        self.last_scan = now;
        let whole = self.vary(self.times.scan);
        self.visit(now, now, purpose, whole);
        Ok(())
    }

    /// Leaves the channel for another radio unit, after a scan if one is under way or is to come first. Does nothing if the
    /// station is attached there, or about to be.
    pub(super) fn attach(&mut self, now: Timestamp, to: RadioUnitIndex) -> Result<(), Busy> {
        match self.busy() {
            Some(Busy::HandingOver(underway)) if underway == to => Ok(()),
            Some(busy @ Busy::HandingOver(_)) => Err(busy),
            Some(Busy::Scanning) => {
                let next = if self.attached == Some(to) { Purpose::Look } else { Purpose::Attach(to) };
                if let Some(Activity { phase: Phase::Scan(purpose, _) | Phase::Pause(purpose, _), .. }) =
                    &mut self.activity
                {
                    *purpose = next;
                }
                Ok(())
            }
            None if self.attached == Some(to) => Ok(()),
            None if self.times.scan_first && self.scanned.is_none_or(|at| now.since(at) > VALID) => {
                self.scan(now, Purpose::Attach(to))
            }
            None => {
                self.begin(now, now, Stage::Authenticate, to);
                Ok(())
            }
        }
    }

    /// Detaches from its radio unit and returns it, and ends a scan. Off the channel, a station does not notice the loss.
    pub(super) fn detach(&mut self) -> Option<RadioUnitIndex> {
        self.on_channel()?;
        self.activity = None;
        self.attached.take()
    }

    /// Ends whatever it does. Returns the radio unit that it was attached to.
    pub(super) fn silence(&mut self) -> Option<RadioUnitIndex> {
        self.activity = None;
        self.attached.take()
    }

    /// Returns the radio unit that it is being handed over to.
    pub(super) fn underway_to(&self) -> Option<RadioUnitIndex> {
        match self.busy() {
            Some(Busy::HandingOver(to)) => Some(to),
            Some(Busy::Scanning) | None => None,
        }
    }

    /// Ends the current phase. `chosen` is the result of a scan. `is_one_domain` says whether there is a former radio unit,
    /// here or at another core, and whether it is in one mobility domain with the next. `frames_wait` says whether the
    /// station has any to send.
    pub(super) fn expire(
        &mut self,
        chosen: Option<RadioUnitIndex>,
        is_one_domain: bool,
        frames_wait: bool,
    ) -> Step {
        let Some(activity) = self.activity.take() else { return Step::Underway };
        let Activity { left, phase, ends } = activity;
        match phase {
            Phase::Scan(purpose, Duration::ZERO) => {
                self.scanned = Some(ends);
                let to = match purpose {
                    Purpose::Look => None,
                    Purpose::Attach(to) => Some(to),
                    Purpose::Roam => chosen,
                };
                if let Some(to) = to.filter(|to| self.attached != Some(*to)) {
                    // By frames, the station is back on its channel before it leaves again.
                    let left = if self.times.frames.is_some() { ends } else { left };
                    self.begin(left, ends, Stage::Authenticate, to);
                }
                Step::Scanned
            }
            Phase::Scan(purpose, rest) => {
                match self.visits().filter(|v| frames_wait || ends.since(left) + v.next_dwell(rest) > v.away)
                {
                    Some(ScanVisits { back, .. }) => {
                        let phase = Phase::Pause(purpose, rest);
                        self.activity = Some(Activity { left, phase, ends: ends + back });
                    }
                    None => self.visit(left, ends, purpose, rest),
                }
                Step::Underway
            }
            Phase::Pause(purpose, rest) => {
                self.visit(ends, ends, purpose, rest);
                Step::Underway
            }
            Phase::Exchange(exchange, to) => self.go_on(activity, exchange, to),
            Phase::HandOver(Stage::Authenticate, to) => {
                self.begin(left, ends, Stage::Reassociate, to);
                Step::Underway
            }
            Phase::HandOver(Stage::Reassociate, to) if !self.is_fast(is_one_domain) => {
                self.begin(left, ends, Stage::Handshake, to);
                Step::Underway
            }
            Phase::HandOver(Stage::Reassociate | Stage::Handshake, to) => {
                let fast = self.is_fast(is_one_domain);
                let from = self.attached.replace(to);
                Step::Attached(Joined { from, to, fast, gap: ends.since(left) })
            }
        }
    }

    /// Whether a handover is a fast transition, within one mobility domain.
    pub(super) fn is_fast(&self, is_one_domain: bool) -> bool {
        self.fast_transition && is_one_domain
    }

    /// Goes to the next channel of a scan, or to all of the rest.
    fn visit(&mut self, left: Timestamp, now: Timestamp, purpose: Purpose, rest: Duration) {
        let dwell = self.visits().map_or(rest, |visits| visits.next_dwell(rest));
        let phase = Phase::Scan(purpose, rest - dwell);
        self.activity = Some(Activity { left, phase, ends: now + dwell });
    }

    /// Returns the visits of its scans. A station without a radio unit has no channel to be back on.
    fn visits(&self) -> Option<ScanVisits> {
        self.times.visits.filter(|_| self.attached.is_some())
    }

    fn begin(&mut self, left: Timestamp, now: Timestamp, stage: Stage, to: RadioUnitIndex) {
        if self.times.frames.is_some() {
            let next = Message::Authenticate;
            let exchange = Exchange { next, sendings: 0, reply: None, done: None };
            self.activity = Some(Activity { left, phase: Phase::Exchange(exchange, to), ends: now });
            return;
        }
        let mean = match stage {
            Stage::Authenticate => self.times.authenticate,
            Stage::Reassociate => self.times.reassociate,
            Stage::Handshake => self.times.handshake,
        };
        let ends = now + self.vary(mean);
        self.activity = Some(Activity { left, phase: Phase::HandOver(stage, to), ends });
    }

    /// Goes on with a handover whose frames are on the air: sends what is due, or ends it.
    fn go_on(&mut self, activity: Activity, mut exchange: Exchange, to: RadioUnitIndex) -> Step {
        let Activity { left, ends, .. } = activity;
        let underway = |exchange, ends| Some(Activity { left, phase: Phase::Exchange(exchange, to), ends });
        if let Some((_, reply)) = exchange.reply.take_if(|(at, _)| *at <= ends) {
            self.activity = underway(exchange, ends);
            return Step::Send(reply, to);
        }
        if let Some(fast) = exchange.done {
            let from = self.attached.replace(to);
            return Step::Attached(Joined { from, to, fast, gap: ends.since(left) });
        }
        if exchange.sendings == SENDINGS {
            return Step::Failed;
        }
        exchange.sendings += 1;
        let patience = if matches!(exchange.next, Message::Key(_)) { KEY_ANSWER } else { ANSWER };
        self.activity = underway(exchange, ends + patience);
        Step::Send(exchange.next, to)
    }

    /// Learns what became of a frame of its handover.
    pub(super) fn hear(&mut self, now: Timestamp, message: Message, fate: Fate, is_one_domain: bool) {
        let (fast, frames) = (self.is_fast(is_one_domain), self.times.frames);
        let Some(Activity { phase: Phase::Exchange(exchange, _), ends, .. }) = &mut self.activity else {
            return;
        };
        let tick = |at: Timestamp| frames.map_or(at, |frames| next_tick(at, frames));
        use Message::{Authenticate, Authenticated, Key, Reassociate, Reassociated};
        let next = match (exchange.next, message, fate) {
            // hostapd waits for the station's answer, whatever became of its own message.
            (Key(_), _, Fate::Settled { .. }) => return,
            (next, sent, Fate::Settled { acknowledged }) => {
                if next == sent {
                    *ends = if acknowledged { now + ANSWER_ONCE_ACKNOWLEDGED } else { now };
                }
                return;
            }
            (Authenticate, Authenticate, Fate::Received) => {
                let at = if fast { tick(now + FORGETTING) } else { now };
                exchange.reply = Some((at, Authenticated));
                return;
            }
            (Reassociate, Reassociate, Fate::Received) => {
                exchange.reply = Some((now, Reassociated));
                return;
            }
            (Key(sent @ (1 | 3)), Key(received), Fate::Received) if sent == received => {
                exchange.reply = Some((now, Key(received + 1)));
                return;
            }
            (Authenticate, Authenticated, Fate::Received) => (Reassociate, tick(now)),
            (Reassociate, Reassociated, Fate::Received) if !fast => (Key(1), now),
            (Key(1), Key(2), Fate::Received) => (Key(3), now),
            (Reassociate, Reassociated, Fate::Received) | (Key(3), Key(4), Fate::Received) => {
                (exchange.done, *ends) = (Some(fast), now);
                return;
            }
            // Again, because the answer to it was lost or late.
            (_, _, Fate::Received) => return,
        };
        *exchange = Exchange { next: next.0, sendings: 0, reply: None, done: None };
        *ends = next.1;
    }

    fn vary(&mut self, mean: Duration) -> Duration {
        let u = 2.0 * self.rng.unit() - 1.0;
        if self.times.variation == 0.0 {
            mean
        } else {
            mean.mul_f64((1.0 + u * self.times.variation).max(0.0))
        }
    }
}

/// Returns the next tick of a kernel. All ticks coincide, as those of one kernel do.
fn next_tick(now: Timestamp, Frames { tick }: Frames) -> Timestamp {
    let tick = tick.as_nanos() as u64;
    let passed = now.as_nanos().checked_div(tick);
    passed.map_or(now, |passed| Timestamp::from_nanos((passed + 1) * tick))
}

#[cfg(test)]
mod tests {
    use cotorra_graph::PassiveVisits;
    use cotorra_graph_testing as base;

    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    fn station(fast_transition: bool, variation: f64) -> Station {
        let handover = HandoverTimes { variation, ..base::wireless().handover };
        let network = WirelessNetwork { fast_transition, handover, ..base::wireless() };
        let mut station = Station::new(&network, Draws::new(1, "r"));
        station.begin_attached(0);
        station
    }

    /// Ends all phases at their deadlines. Returns the total time.
    fn run(
        station: &mut Station,
        from: Timestamp,
        strongest: Option<RadioUnitIndex>,
    ) -> (Vec<Step>, Duration) {
        let (mut steps, mut now) = (Vec::new(), from);
        while let Some(deadline) = station.deadline() {
            now = deadline;
            let is_one_domain = station.attached().is_some();
            steps.push(station.expire(strongest, is_one_domain, false));
        }
        (steps, now.since(from))
    }

    #[test]
    fn a_fast_handover_is_authentication_and_reassociation() {
        let mut station = station(true, 0.0);
        station.attach(at(5), 1).unwrap();
        assert_eq!((station.attached(), station.on_channel()), (Some(0), None));
        let joined = Joined { from: Some(0), to: 1, fast: true, gap: ms(30) };
        assert_eq!(run(&mut station, at(5), None), (vec![Step::Underway, Step::Attached(joined)], ms(30)));
        assert_eq!(station.on_channel(), Some(1));
    }

    #[test]
    fn a_full_handover_adds_the_handshakes() {
        let mut station = station(false, 0.0);
        station.attach(at(0), 1).unwrap();
        let joined = Joined { from: Some(0), to: 1, fast: false, gap: ms(70) };
        let (steps, took) = run(&mut station, at(0), None);
        assert_eq!((steps.last(), took), (Some(&Step::Attached(joined)), ms(70)));
    }

    #[test]
    fn handshakes_are_repeated_between_mobility_domains() {
        let mut station = station(true, 0.0);
        station.attach(at(0), 1).unwrap();
        assert_eq!(station.underway_to(), Some(1));
        while station.is_busy() {
            station.expire(None, false, false);
        }
        assert_eq!((station.attached(), station.underway_to()), (Some(1), None));
        station.attach(at(100), 0).unwrap();
        let mut last = Step::Underway;
        while station.is_busy() {
            last = station.expire(None, false, false);
        }
        assert_eq!(last, Step::Attached(Joined { from: Some(1), to: 0, fast: false, gap: ms(70) }));
    }

    #[test]
    fn handshakes_are_repeated_after_a_lost_radio_unit() {
        let mut station = station(true, 0.0);
        assert_eq!(station.detach(), Some(0));
        station.scan(at(0), Purpose::Roam).unwrap();
        let joined = Joined { from: None, to: 2, fast: false, gap: ms(170) };
        let (steps, took) = run(&mut station, at(0), Some(2));
        assert_eq!((steps[0], steps.last(), took), (Step::Scanned, Some(&Step::Attached(joined)), ms(170)));
    }

    #[test]
    fn a_scan_returns_to_its_channel() {
        let mut station = station(true, 0.0);
        station.scan(at(0), Purpose::Look).unwrap();
        assert_eq!(station.on_channel(), None);
        assert_eq!(run(&mut station, at(0), Some(1)), (vec![Step::Scanned], ms(100)));
        assert_eq!(station.on_channel(), Some(0));
        // A scan to roam returns as well if no radio unit is better.
        station.scan(at(200), Purpose::Roam).unwrap();
        assert_eq!(run(&mut station, at(200), Some(0)), (vec![Step::Scanned], ms(100)));
    }

    #[test]
    fn a_handover_requested_during_a_scan_follows_it() {
        let mut station = station(true, 0.0);
        station.scan(at(0), Purpose::Look).unwrap();
        station.attach(at(50), 1).unwrap();
        let joined = Joined { from: Some(0), to: 1, fast: true, gap: ms(130) };
        let steps = vec![Step::Scanned, Step::Underway, Step::Attached(joined)];
        assert_eq!(run(&mut station, at(0), None), (steps, ms(130)));
    }

    /// A station whose scans of 100 ms visit channels for 30 ms each, two at a time.
    fn visitor() -> Station {
        let mut station = station(true, 0.0);
        let visits = ScanVisits { dwell: ms(30), passive: None, away: ms(75), back: ms(200) };
        station.times.visits = Some(visits);
        station
    }

    /// Ends all phases at their deadlines. Returns the times, ms, and whether the station is on its channel from then on.
    fn presence(station: &mut Station, frames_wait: bool) -> Vec<(u64, bool)> {
        let mut presence = Vec::new();
        while let Some(deadline) = station.deadline() {
            station.expire(None, true, frames_wait);
            presence.push((deadline.as_nanos() / 1_000_000, station.on_channel().is_some()));
        }
        presence
    }

    #[test]
    fn a_scan_with_visits_comes_back_before_it_is_away_too_long() {
        let mut station = visitor();
        station.scan(at(0), Purpose::Look).unwrap();
        let expected = [(30, false), (60, true), (260, false), (290, false), (300, true)];
        assert_eq!(presence(&mut station, false), expected);
    }

    #[test]
    fn a_scan_listens_longer_on_its_last_channels() {
        let mut station = visitor();
        let passive = Some(PassiveVisits { channels: 2, dwell: ms(70) });
        let visits = station.times.visits.map(|visits| ScanVisits { passive, ..visits });
        station.times = HandoverTimes { scan: ms(2 * 30 + 2 * 70), visits, ..station.times };
        station.scan(at(0), Purpose::Look).unwrap();
        let expected = [(30, false), (60, true), (260, false), (330, true), (530, false), (600, true)];
        assert_eq!(presence(&mut station, false), expected);
    }

    #[test]
    fn a_scan_precedes_an_instructed_change_if_it_is_to() {
        let mut station = visitor();
        station.times.scan_first = true;
        station.attach(at(0), 1).unwrap();
        assert_eq!(station.attach(at(1), 2), Err(Busy::HandingOver(1)));
        // It is away for 60 ms, back for 200 ms, and away for 40 ms and the handover of 30 ms.
        let joined = Joined { from: Some(0), to: 1, fast: true, gap: ms(40 + 30) };
        let (steps, took) = run(&mut station, at(0), None);
        assert!(steps.contains(&Step::Scanned));
        assert_eq!((steps.last(), took), (Some(&Step::Attached(joined)), ms(60 + 200 + 70)));
        station.attach(at(400), 1).unwrap();
        assert!(!station.is_busy(), "it is there already");
        // The scan ended at 300 ms. Its result is good for 5 s.
        let joined = Joined { from: Some(1), to: 0, fast: true, gap: ms(30) };
        station.attach(at(5300), 0).unwrap();
        assert_eq!(run(&mut station, at(5300), None).0, [Step::Underway, Step::Attached(joined)]);
        station.attach(at(5330), 1).unwrap();
        assert!(run(&mut station, at(5330), None).0.contains(&Step::Scanned));
    }

    #[test]
    fn a_station_with_frames_to_send_comes_back_from_each_channel() {
        let mut station = visitor();
        station.scan(at(0), Purpose::Look).unwrap();
        let expected =
            [(30, true), (230, false), (260, true), (460, false), (490, true), (690, false), (700, true)];
        assert_eq!(presence(&mut station, true), expected);
    }

    #[test]
    fn a_station_without_a_radio_unit_scans_without_a_break() {
        let mut station = visitor();
        station.detach();
        station.scan(at(0), Purpose::Look).unwrap();
        assert_eq!(presence(&mut station, true), [(100, false)]);
    }

    #[test]
    fn a_station_between_visits_is_still_scanning() {
        let mut station = visitor();
        station.scan(at(0), Purpose::Look).unwrap();
        station.expire(None, true, true);
        assert_eq!((station.on_channel(), station.deadline()), (Some(0), Some(at(230))));
        assert_eq!(station.scan(at(40), Purpose::Look), Err(Busy::Scanning));
        // A handover follows the scan. Its gap begins when the station leaves its channel for the last time.
        station.attach(at(50), 1).unwrap();
        assert_eq!(station.attach(at(60), 2), Err(Busy::HandingOver(1)));
        let joined = Joined { from: Some(0), to: 1, fast: true, gap: ms(70 + 30) };
        assert_eq!(run(&mut station, at(50), None).0.last(), Some(&Step::Attached(joined)));
    }

    #[test]
    fn a_lost_radio_unit_ends_a_scan_between_visits() {
        let mut station = visitor();
        station.scan(at(0), Purpose::Look).unwrap();
        assert_eq!(station.detach(), None, "it is not noticed on another channel");
        station.expire(None, true, true);
        assert_eq!(station.detach(), Some(0));
        assert!(!station.is_busy());
    }

    #[test]
    fn a_busy_station_rejects_other_activities() {
        let mut station = station(true, 0.0);
        station.attach(at(0), 0).unwrap();
        assert!(!station.is_busy(), "it is there already");
        station.attach(at(0), 1).unwrap();
        assert_eq!(station.attach(at(1), 1), Ok(()), "it is on its way");
        assert_eq!(station.attach(at(1), 2), Err(Busy::HandingOver(1)));
        assert_eq!(station.scan(at(1), Purpose::Look), Err(Busy::HandingOver(1)));
        run(&mut station, at(0), None);
        station.scan(at(100), Purpose::Look).unwrap();
        assert_eq!(station.scan(at(110), Purpose::Look), Err(Busy::Scanning));
    }

    #[test]
    fn phases_vary_uniformly_within_the_variation() {
        let mut station = station(true, 0.5);
        let scans: Vec<f64> = (0..2000)
            .map(|i| {
                station.scan(at(1000 * i), Purpose::Look).unwrap();
                run(&mut station, at(1000 * i), None).1.as_secs_f64() * 1e3
            })
            .collect();
        assert!(scans.iter().all(|ms| (50.0..=150.0).contains(ms)));
        let mean = scans.iter().sum::<f64>() / scans.len() as f64;
        assert!((mean - 100.0).abs() < 2.0, "{mean}");
        assert!(scans.iter().any(|ms| *ms < 55.0) && scans.iter().any(|ms| *ms > 145.0));
    }
}
