//! Both ends of one link in one hand, with one clock: then each direction is told by itself, whatever gets lost.

use std::{collections::VecDeque, time::Duration};

use crate::{
    measurement::{LinkEstimate, OneWay},
    packet::{Malformed, Test},
    reflector::Reflector,
    session::{Session, SessionConfig},
    utc::{ErrorEstimate, Utc},
};

/// A link of which both ends are within reach. Its first end asks, its second end answers.
#[derive(Debug)]
pub struct Link {
    config: SessionConfig,
    session: Session,
    reflector: Reflector<()>,
    /// What was sent within the window, in order.
    probes: VecDeque<Probe>,
}

#[derive(Debug)]
struct Probe {
    sequence: u32,
    sent_at: Utc,
    /// How far it got.
    crossed: Crossed,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Crossed {
    Nothing,
    TheWayThere,
    Both,
}

impl Link {
    /// A link that is probed from a time on, as the configuration says; whose clock it is has no part in that.
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

    /// The probe that is due at the first end, if one is.
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

    /// When [`Link::poll`] has something to do.
    pub fn deadline(&self) -> Option<Utc> {
        self.session.deadline()
    }

    /// As [`Session::pace`].
    pub fn pace(&mut self, config: SessionConfig) {
        let SessionConfig { patience, window, .. } = config;
        self.config = SessionConfig { patience, window, ..self.config };
        self.session.pace(config);
    }

    /// A probe came to the second end: gives the answer, which goes back `now`, and what the way there took.
    ///
    /// # Errors
    /// [`Malformed`] if it is none.
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

    /// An answer came to the first end: gives what the way back took. One that came twice or too late is `None`.
    ///
    /// # Errors
    /// [`Malformed`] if it is none.
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

    /// What probes tell of the way there and the way back; `None` before it is known of the first what became of it.
    pub fn told(&self, now: Utc) -> Option<[LinkEstimate; 2]> {
        let from = now - self.config.window;
        let recent = self.probes.iter().filter(|probe| probe.sent_at >= from);
        // An answer settles all that was sent before it: what is still missing is lost, unless it comes after all.
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

    /// Probes every 100 ms over a way that says what becomes of each: lost there, lost back, or neither.
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
            // The second end rests for a millisecond, which is nobody's delay.
            let (answer, took) = link.reflect(&probe, ms(n * 100 + 3), ms(n * 100 + 4)).unwrap();
            assert_eq!(took, Duration::from_millis(3));
            if way(n) == Crossed::Both {
                let took = Some(Duration::from_millis(7));
                assert_eq!(link.receive(&answer, ms(n * 100 + 11)), Ok(took));
                assert_eq!(link.receive(&answer, ms(n * 100 + 12)), Ok(None), "the same again");
            }
        }
        link.told(ms(count * 100))
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
    fn a_link_that_went_silent_is_told_before_its_delay_is_forgotten() {
        let [there, back] = after(120, |n| if n < 60 { Crossed::Both } else { Crossed::Nothing }).unwrap();
        // Of the last 100, 40 came back and 56 were given up.
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
    fn nothing_is_told_before_anything_is_known() {
        assert_eq!(after(1, |_| Crossed::Nothing), None);
        assert_eq!(after(6, |_| Crossed::Nothing).unwrap().map(|told| told.loss), [Some(1.0), None]);
        assert!(after(1, |_| Crossed::Both).is_some());
    }
}
