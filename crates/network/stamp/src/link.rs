//! Both ends of a link in one process, with one clock. Each direction is measured by itself, whatever gets lost.

use std::{collections::VecDeque, time::Duration};

use crate::{
    measurement::{LinkEstimate, OneWay},
    packet::{Malformed, Test},
    reflector::Reflector,
    session::{Session, SessionConfig},
    utc::{ErrorEstimate, Utc},
};

/// Both ends of a link. The first end sends probes, the second end answers.
#[derive(Debug)]
pub struct Link {
    config: SessionConfig,
    session: Session,
    reflector: Reflector<()>,
    /// Probes sent within the window, in order.
    probes: VecDeque<Probe>,
}

#[derive(Debug)]
struct Probe {
    sequence: u32,
    sent_at: Utc,
    /// Directions that it crossed.
    crossed: Crossed,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Crossed {
    Nothing,
    TheWayThere,
    Both,
}

impl Link {
    /// Starts to probe a link at `begins`. The configuration's error estimate and `reflector_counts` are ignored.
    pub fn new(config: SessionConfig, begins: Utc) -> Self {
        let clock = ErrorEstimate::new(true, Duration::from_nanos(1));
        let config = SessionConfig { error: clock, reflector_counts: true, ..config };
        Self {
            config,
            session: Session::new(config, begins),
            reflector: Reflector::new(clock),
            probes: VecDeque::new(),
        }
    }

    /// Returns the probe that is due at the first end, if any.
    pub fn poll(&mut self, now: Utc) -> Option<Vec<u8>> {
        let sequence = self.session.sent();
        let bytes = self.session.poll(now)?;
        let from = now - self.config.window;
        while self.probes.front().is_some_and(|probe| probe.sent_at < from) {
            self.probes.pop_front();
        }
        self.probes.push_back(Probe { sequence, sent_at: now, crossed: Crossed::Nothing });
        Some(bytes)
    }

    /// Returns when [`Link::poll`] is due.
    pub fn deadline(&self) -> Option<Utc> {
        self.session.deadline()
    }

    /// Changes the pace; see [`Session::pace`].
    pub fn pace(&mut self, config: SessionConfig) {
        let SessionConfig { patience, window, .. } = config;
        self.config = SessionConfig { patience, window, ..self.config };
        self.session.pace(config);
    }

    /// Takes a probe at the second end. Returns the answer, to be sent back `now`, and the delay of the way there.
    ///
    /// # Errors
    /// [`Malformed`] for bytes that are no probe.
    pub fn reflect(
        &mut self,
        bytes: &[u8],
        received: Utc,
        now: Utc,
    ) -> Result<(Vec<u8>, Duration), Malformed> {
        let test = Test::decode(bytes)?;
        let answer = self.reflector.reflect((), bytes, received, None)?.sent_at(now);
        self.got(test.sequence, Crossed::TheWayThere);
        let sent = Utc::from_wire(test.sent_at, test.error.format, received);
        Ok((answer, received.since(sent)))
    }

    /// Takes an answer at the first end. Returns the delay of the way back; `None` for a repeated or late answer.
    ///
    /// # Errors
    /// [`Malformed`] for bytes that are no answer.
    pub fn receive(&mut self, bytes: &[u8], received: Utc) -> Result<Option<Duration>, Malformed> {
        let Some((sequence, back)) = self.session.receive_which(bytes, received)? else { return Ok(None) };
        self.got(sequence, Crossed::Both);
        Ok(back)
    }

    fn got(&mut self, sequence: u32, crossed: Crossed) {
        let its = self.probes.iter_mut().rev().find(|probe| probe.sequence == sequence);
        if let Some(probe) = its {
            probe.crossed = probe.crossed.max(crossed);
        }
    }

    /// Returns the estimates of the way there and the way back; `None` until the first probe was answered or given up.
    pub fn estimates(&self, now: Utc) -> Option<[LinkEstimate; 2]> {
        let from = now - self.config.window;
        let recent = self.probes.iter().filter(|probe| probe.sent_at >= from);
        // An answer settles all probes sent before it. Those without an answer count as lost, unless it still comes.
        let settled =
            |probe: &&Probe| probe.crossed == Crossed::Both || probe.sent_at + self.config.patience <= now;
        let latest = recent.clone().rfind(settled)?.sent_at;
        let known = recent.filter(|probe| probe.sent_at <= latest);
        let count = |least: Crossed| known.clone().filter(|probe| probe.crossed >= least).count() as f64;
        let [sent, there, back] = [Crossed::Nothing, Crossed::TheWayThere, Crossed::Both].map(count);
        let measured = OneWay::of(self.session.recent(now));
        let replied =
            self.session.recent(now).filter_map(|outcome| outcome.sample).map(|sample| sample.replied_at);
        let age = replied.max().map(|at| now.since(at));
        let told = |of: f64, got: f64, way: usize| LinkEstimate {
            delays: measured.map(|ways| ways[way]).zip(age),
            loss: (of > 0.0).then(|| 1.0 - got / of),
            loss_age: now.since(latest),
        };
        Some([told(sent, there, 0), told(there, back, 1)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Utc {
        Utc::UNIX_EPOCH + Duration::from_millis(ms)
    }

    /// Probes every 100 ms. `way` gives the directions that each probe crosses.
    fn after(count: u64, way: impl Fn(u64) -> Crossed) -> Option<[LinkEstimate; 2]> {
        let config = SessionConfig { patience: Duration::from_millis(500), ..SessionConfig::default() };
        let mut link = Link::new(config, ms(0));
        for n in 0..count {
            while link.deadline() < Some(ms(n * 100)) {
                assert_eq!(link.poll(link.deadline().unwrap()), None, "one is given up");
            }
            let probe = link.poll(ms(n * 100)).unwrap();
            if way(n) == Crossed::Nothing {
                continue;
            }
            // The second end rests for a millisecond, which counts in neither delay.
            let (answer, took) = link.reflect(&probe, ms(n * 100 + 3), ms(n * 100 + 4)).unwrap();
            assert_eq!(took, Duration::from_millis(3));
            if way(n) == Crossed::Both {
                let took = Some(Duration::from_millis(7));
                assert_eq!(link.receive(&answer, ms(n * 100 + 11)), Ok(took));
                assert_eq!(link.receive(&answer, ms(n * 100 + 12)), Ok(None), "the same again");
            }
        }
        link.estimates(ms(count * 100))
    }

    #[test]
    fn each_direction_has_its_own_delay_and_loss() {
        let way = |n| match n % 10 {
            0 | 5 => Crossed::Nothing,
            3 => Crossed::TheWayThere,
            _ => Crossed::Both,
        };
        let [there, back] = after(1_000, way).unwrap();
        let mean = |told: LinkEstimate| told.delays.unwrap().0.mean;
        assert_eq!((mean(there), mean(back)), (Duration::from_millis(3), Duration::from_millis(7)));
        assert!((there.loss.unwrap() - 0.2).abs() < 0.01, "{there:?}");
        assert!((back.loss.unwrap() - 0.125).abs() < 0.01, "{back:?}");
        assert_eq!(
            (there.delays.unwrap().1, there.loss_age),
            (Duration::from_millis(89), Duration::from_millis(100))
        );
    }

    #[test]
    fn loss_is_reported_before_the_delay_is_forgotten() {
        let [there, back] = after(120, |n| if n < 60 { Crossed::Both } else { Crossed::Nothing }).unwrap();
        // 40 of the last 100 came back, and 56 were given up.
        assert!((there.loss.unwrap() - 56.0 / 96.0).abs() < 1e-9, "{there:?}");
        assert_eq!(back.loss, Some(0.0));
        assert_eq!(
            (there.delays.unwrap().1, there.loss_age),
            (Duration::from_millis(6_089), Duration::from_millis(500))
        );
        let [there, back] = after(400, |n| if n < 60 { Crossed::Both } else { Crossed::Nothing }).unwrap();
        assert_eq!((there.loss, there.delays, back.loss, back.delays), (Some(1.0), None, None, None));
    }

    #[test]
    fn there_are_no_estimates_before_the_first_answer() {
        assert_eq!(after(1, |_| Crossed::Nothing), None);
        assert_eq!(after(6, |_| Crossed::Nothing).unwrap().map(|told| told.loss), [Some(1.0), None]);
        assert!(after(1, |_| Crossed::Both).is_some());
    }
}
