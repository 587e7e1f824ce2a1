//! The Session-Sender (RFC 8762, section 4.2): schedules test packets and evaluates the replies.

use std::{collections::VecDeque, time::Duration};

use crate::{
    extension,
    measurement::{Answer, LinkEstimate, Measurement, Outcome, Sample, duration},
    one_way::one_way,
    packet::{BASE_LENGTH, Malformed, Reply, Test},
    utc::{ErrorEstimate, Utc},
};

/// The configuration of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SessionConfig {
    /// Session identifier, which distinguishes sessions of one sender (RFC 8972, section 3); zero for none.
    pub identifier: u16,
    /// Time from one test packet to the next.
    pub interval: Duration,
    /// Length of a packet, octets; at least 44.
    pub length: usize,
    /// Time after which a packet without a reply is lost.
    pub patience: Duration,
    /// Time span of [`Session::measurement`].
    pub window: Duration,
    /// Error estimate of the session's own clock.
    pub error: ErrorEstimate,
    /// Whether the reflector counts its replies by itself (stateful; RFC 8762, section 4.3). Without that, losses cannot be
    /// assigned to a direction.
    pub reflector_counts: bool,
}

/// Ten packets per second, over ten seconds.
impl Default for SessionConfig {
    fn default() -> Self {
        Self {
            identifier: 0,
            interval: Duration::from_millis(100),
            length: BASE_LENGTH,
            patience: Duration::from_secs(1),
            window: Duration::from_secs(10),
            error: ErrorEstimate::default(),
            reflector_counts: true,
        }
    }
}

impl SessionConfig {
    /// Extends the interval so that test packets, each with `overhead` octets of headers, take at most `share` of a rate of
    /// `rate_bps`, bit/s.
    #[must_use]
    pub fn within(self, share: f64, rate_bps: f64, overhead: usize) -> Self {
        let bits = 8.0 * (self.length.max(BASE_LENGTH) + overhead) as f64;
        let least = Duration::try_from_secs_f64(bits / (share * rate_bps)).unwrap_or(Duration::MAX);
        Self { interval: self.interval.max(least), ..self }
    }
}

/// A session: sends test packets and measures by the replies.
#[derive(Debug)]
pub struct Session {
    config: SessionConfig,
    next: Option<Utc>,
    sequence: u32,
    /// Packets that are neither answered nor given up, in order of sending.
    open: VecDeque<(u32, Utc)>,
    /// Outcomes of packets, in order of sending.
    outcomes: VecDeque<Outcome>,
}

impl Session {
    /// Creates a session whose first packet is due at `begins`.
    pub fn new(config: SessionConfig, begins: Utc) -> Self {
        let outcomes = VecDeque::new();
        Self { config, next: Some(begins), sequence: 0, open: VecDeque::new(), outcomes }
    }

    /// Returns the packet that is due, if any. Call it at [`Session::deadline`]. A late call skips packets rather than
    /// sending them in a burst.
    pub fn poll(&mut self, now: Utc) -> Option<Vec<u8>> {
        self.give_up(now);
        let due = self.next.filter(|due| *due <= now)?;
        let following = due + self.config.interval;
        self.next = Some(if following <= now { now + self.config.interval } else { following });
        let test = Test {
            sequence: self.sequence,
            sent_at: now.to_wire(self.config.error.format),
            error: self.config.error,
            session: self.config.identifier,
        };
        self.open.push_back((self.sequence, now));
        self.sequence = self.sequence.wrapping_add(1);
        let mut bytes = test.encode(self.config.length);
        extension::pad(&mut bytes[BASE_LENGTH..]);
        Some(bytes)
    }

    /// Returns when [`Session::poll`] is due: a packet is to be sent, or given up.
    pub fn deadline(&self) -> Option<Utc> {
        let given_up = self.open.front().map(|(_, sent_at)| *sent_at + self.config.patience);
        [self.next, given_up].into_iter().flatten().min()
    }

    /// Takes interval, patience and window from another configuration. The next packet stays due when it was.
    pub fn pace(&mut self, config: SessionConfig) {
        let SessionConfig { interval, patience, window, .. } = config;
        self.config = SessionConfig { interval, patience, window, ..self.config };
    }

    /// Stops sending. Replies to packets in flight still count.
    pub fn stop(&mut self) {
        self.next = None;
    }

    /// Takes a received packet. Returns its round-trip time without the reflector's processing time; `None` for a repeated
    /// or late reply, or one of another session.
    ///
    /// # Errors
    /// [`Malformed`] for bytes that are no reply.
    pub fn receive(&mut self, bytes: &[u8], now: Utc) -> Result<Option<Duration>, Malformed> {
        Ok(self.take(bytes, now)?.map(|sample| sample.round_trip))
    }

    /// [`Self::receive`], but returns the sequence number of the answered packet, and the delay of the way back if both
    /// clocks are synchronised.
    pub(crate) fn receive_which(
        &mut self,
        bytes: &[u8],
        now: Utc,
    ) -> Result<Option<(u32, Option<Duration>)>, Malformed> {
        let back = |[_, ns]: [i64; 2]| duration(ns);
        Ok(self.take(bytes, now)?.map(|sample| (sample.sequence, sample.one_way().map(back))))
    }

    fn take(&mut self, bytes: &[u8], now: Utc) -> Result<Option<Sample>, Malformed> {
        let reply = Reply::decode(bytes)?;
        self.give_up(now);
        let is_ours = reply.test.session == self.config.identifier || bytes.len() < BASE_LENGTH;
        let open = self.open.iter().position(|(sequence, _)| *sequence == reply.test.sequence);
        let Some((sequence, sent_at)) = open.filter(|_| is_ours).and_then(|at| self.open.remove(at)) else {
            return Ok(None);
        };
        let received = Utc::from_wire(reply.received_at, reply.error.format, now);
        let sent_back = Utc::from_wire(reply.sent_at, reply.error.format, now);
        let rested = Duration::from_nanos(u64::try_from(sent_back.minus(received)).unwrap_or(0));
        // Ignores a reflector's processing time that exceeds the round trip.
        let round_trip = now.since(sent_at).checked_sub(rested).unwrap_or(now.since(sent_at));
        let sample = Sample {
            replied_at: now,
            round_trip,
            ways: [received.minus(sent_at), now.minus(sent_back)],
            synchronized: reply.error.synchronized && self.config.error.synchronized,
            sequence,
            reflected: reply.sequence,
        };
        self.record(Outcome { sent_at, sample: Some(sample) });
        Ok(Some(sample))
    }

    /// Returns the answers of the window's packets, in order of sending; `None` for a packet that was given up. Packets that are
    /// neither answered nor given up are left out.
    pub fn answers(&self, now: Utc) -> impl Iterator<Item = Option<Answer>> {
        self.recent(now).map(|outcome| outcome.sample.as_ref().map(Sample::answer))
    }

    /// Returns the measurement over the window; `None` until the first packet was answered or given up.
    pub fn measurement(&self, now: Utc) -> Option<Measurement> {
        Measurement::of(self.recent(now), self.config.reflector_counts)
    }

    /// Estimates the way there and the way back over the window without synchronised clocks. `least` gives the known least
    /// delay of either direction for a packet's time of sending. The rest of the least round trip is assumed to be equal in
    /// both directions. `None` until the first packet was answered or given up.
    ///
    /// The reflector's count assigns losses to directions. Packets lost after the last answered one count as lost on the
    /// way there, because their direction is unknown.
    pub fn one_way(&self, now: Utc, least: impl Fn(Utc) -> [Duration; 2]) -> Option<[LinkEstimate; 2]> {
        one_way(self.recent(now), now, least)
    }

    /// Returns the outcomes of the window's packets, in order of sending.
    pub(crate) fn recent(&self, now: Utc) -> impl Iterator<Item = &Outcome> + Clone {
        let from = now - self.config.window;
        self.outcomes.iter().filter(move |outcome| outcome.sent_at >= from)
    }

    /// Returns the number of packets sent since the session began.
    pub fn sent(&self) -> u32 {
        self.sequence
    }

    fn give_up(&mut self, now: Utc) {
        while let Some((_, sent_at)) = self.open.front().copied()
            && sent_at + self.config.patience <= now
        {
            self.open.pop_front();
            self.record(Outcome { sent_at, sample: None });
        }
        let from = now - self.config.window;
        while self.outcomes.front().is_some_and(|outcome| outcome.sent_at < from) {
            self.outcomes.pop_front();
        }
    }

    fn record(&mut self, outcome: Outcome) {
        let at = self.outcomes.partition_point(|other| other.sent_at <= outcome.sent_at);
        self.outcomes.insert(at, outcome);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Reflector;

    fn at(ms: u64) -> Utc {
        Utc::UNIX_EPOCH + Duration::from_secs(1_700_000_000) + Duration::from_millis(ms)
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// Sends a hundred packets. `way` gives the delay of each, there and back, ms; `None` if it is lost.
    fn over(mut way: impl FnMut(u64) -> (Option<u64>, Option<u64>), config: SessionConfig) -> (Session, Utc) {
        let mut session = Session::new(config, at(0));
        let mut reflector = Reflector::new(config.error);
        for i in 0..100 {
            let sent = at(i * 100);
            while session.deadline().unwrap() < sent {
                assert_eq!(session.poll(session.deadline().unwrap()), None, "one is given up");
            }
            assert_eq!(session.deadline(), Some(sent));
            let probe = session.poll(sent).unwrap();
            assert_eq!(session.poll(sent), None);
            let (there, back) = way(i);
            let Some(there) = there else { continue };
            let reply = reflector.reflect(0, &probe, sent + ms(there), None).unwrap();
            let reply = reply.sent_at(sent + ms(there + 1));
            let Some(back) = back else { continue };
            assert_eq!(session.receive(&reply, sent + ms(there + 1 + back)), Ok(Some(ms(there + back))));
            assert_eq!(session.receive(&reply, sent + ms(there + 1 + back)), Ok(None), "the same again");
        }
        session.stop();
        while let Some(deadline) = session.deadline() {
            assert_eq!(session.poll(deadline), None);
        }
        (session, at(9_999))
    }

    fn all() -> SessionConfig {
        SessionConfig {
            patience: ms(99),
            window: Duration::from_secs(60),
            error: ErrorEstimate::new(true, Duration::from_nanos(100)),
            ..SessionConfig::default()
        }
    }

    #[test]
    fn delays_are_measured_by_direction_without_the_reflectors_time() {
        let (session, now) = over(|i| (Some(3 + i % 2), Some(7)), all());
        let measured = session.measurement(now).unwrap();
        let round_trip = measured.round_trip.unwrap();
        let median = Duration::from_micros(10_500);
        assert_eq!((round_trip.min, round_trip.p50, round_trip.max), (ms(10), median, ms(11)));
        let answers: Vec<_> = session.answers(now).collect();
        assert_eq!(answers.len(), 100);
        assert_eq!(answers[1], Some(Answer { round_trip: ms(11), ways: Some([ms(4), ms(7)]) }));
        assert_eq!(measured.forward.unwrap().max, ms(4));
        assert_eq!(measured.backward.unwrap().mean, ms(7));
        let jitter = [round_trip, measured.forward.unwrap(), measured.backward.unwrap()].map(|d| d.jitter);
        assert_eq!(jitter, [Some(ms(1)), Some(ms(1)), Some(ms(0))]);
        assert_eq!((measured.sent, measured.lost, measured.age(now)), (100, 0, Some(ms(9_999 - 9_912))));
    }

    #[test]
    fn unsynchronised_clocks_give_only_round_trips() {
        let (session, now) =
            over(|_| (Some(3), Some(7)), SessionConfig { error: ErrorEstimate::default(), ..all() });
        let measured = session.measurement(now).unwrap();
        assert_eq!((measured.forward, measured.backward), (None, None));
        assert_eq!(measured.round_trip.unwrap().mean, ms(10));
    }

    #[test]
    fn losses_are_assigned_to_their_direction() {
        // Ten packets are lost on the way there, and nine of the others on the way back; not the first, not the last.
        let way = |i: u64| (((i % 10 != 5).then_some(3)), (i % 10 != 3 || i == 3).then_some(7));
        let (session, now) = over(way, all());
        let measured = session.measurement(now).unwrap();
        assert_eq!((measured.sent, measured.lost), (100, 19));
        assert!((measured.loss() - 0.19).abs() < 1e-9);
        assert!((measured.forward_loss.unwrap() - 10.0 / 99.0).abs() < 1e-9);
        assert!((measured.backward_loss.unwrap() - 9.0 / 89.0).abs() < 1e-9);
        let (session, now) = over(way, SessionConfig { reflector_counts: false, ..all() });
        assert_eq!(session.measurement(now).unwrap().forward_loss, None);
    }

    #[test]
    fn total_loss_is_measured() {
        let (session, now) = over(|_| (None, None), all());
        let measured = session.measurement(now).unwrap();
        assert_eq!((measured.sent, measured.lost, measured.round_trip), (100, 100, None));
    }

    #[test]
    fn late_polls_cause_no_burst() {
        let mut session = Session::new(all(), at(0));
        assert!(session.poll(at(5_000)).is_some());
        assert!(session.poll(at(5_000)).is_none());
        assert!(session.poll(at(5_099)).is_none());
        assert!(session.poll(at(5_100)).is_some());
    }

    #[test]
    fn packets_stay_within_their_share_of_a_rate() {
        let config = all().within(0.01, 100_000.0, 42);
        // 86 octets at 1 kbit/s.
        assert_eq!(config.interval, ms(688));
        assert_eq!(all().within(0.01, 1e9, 42).interval, ms(100));
        assert_eq!(all().within(0.01, 0.0, 42).interval, Duration::MAX);
    }

    proptest! {
        #[test]
        fn memory_is_bounded_and_no_packet_counts_twice(
            steps in prop::collection::vec((0..400_u64, 0..4_u8, any::<u8>()), 1..200)
        ) {
            let config = SessionConfig { patience: ms(500), window: ms(2_000), ..all() };
            let mut session = Session::new(config, at(0));
            let mut reflector = Reflector::default();
            let (mut now, mut replies) = (at(0), Vec::new());
            for (pause, what, which) in steps {
                now = now + ms(pause);
                if let Some(probe) = session.poll(now)
                    && what > 0
                {
                    replies.push(reflector.reflect(0, &probe, now, None).unwrap().sent_at(now));
                }
                if what > 1 && !replies.is_empty() {
                    let reply = &replies[usize::from(which) % replies.len()];
                    prop_assert!(session.receive(reply, now).is_ok());
                }
                prop_assert!(session.open.len() <= 6 && session.outcomes.len() <= 26);
                if let Some(measured) = session.measurement(now) {
                    prop_assert!(measured.lost <= measured.sent && measured.sent <= session.sent());
                    prop_assert!((0.0..=1.0).contains(&measured.loss()));
                }
            }
        }

        #[test]
        fn arbitrary_bytes_cause_no_panic(bytes in prop::collection::vec(any::<u8>(), 0..120)) {
            let mut session = Session::new(all(), at(0));
            let _ = session.poll(at(0));
            let _ = session.receive(&bytes, at(1));
            let _ = session.measurement(at(1));
        }
    }
}
