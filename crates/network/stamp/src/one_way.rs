//! Estimates both directions of a path between unsynchronised clocks.
//!
//! The clocks' offset θ is part of the apparent delay of the way there and, with the opposite sign, of the way back. Their
//! sum is the round trip, and their variations are the path's own while θ is constant (RFC 3393, section 4.3). Only θ is
//! unknown. It follows from the known least delay of each direction, if the rest is equal in both. The least excess over
//! the known delay is then that rest, plus or minus θ.

use std::time::Duration;

use crate::{
    measurement::{LinkEstimate, OneWay, Outcome, Sample, directions, duration, jitter, mean},
    utc::Utc,
};

/// Returns the estimates of the way there and the way back of outcomes in order of sending; `None` without outcomes.
/// `least` gives the known least delay of either direction for a packet's time of sending.
pub(crate) fn one_way<'a>(
    outcomes: impl Iterator<Item = &'a Outcome> + Clone,
    now: Utc,
    least: impl Fn(Utc) -> [Duration; 2],
) -> Option<[LinkEstimate; 2]> {
    let loss_age = now.since(outcomes.clone().last()?.sent_at);
    let samples = outcomes.clone().filter_map(|outcome| outcome.sample);
    let beyond = |way: usize| {
        let ns = |least: Duration| i64::try_from(least.as_nanos()).unwrap_or(i64::MAX);
        let of = |outcome: &Outcome| {
            Some(outcome.sample?.ways[way].saturating_sub(ns(least(outcome.sent_at)[way])))
        };
        outcomes.clone().filter_map(of).min()
    };
    let ahead = beyond(0).zip(beyond(1)).map(|(there, back)| there.saturating_sub(back) / 2);
    let age = samples.clone().map(|sample| sample.replied_at).max().map(|at| now.since(at));
    let delays = |way: usize| {
        let theta = if way == 0 { ahead? } else { -ahead? };
        let took = |sample: Sample| duration(sample.ways[way].saturating_sub(theta));
        let took = outcomes.clone().map(move |outcome| outcome.sample.map(took));
        Some((OneWay { mean: mean(took.clone().flatten())?, jitter: jitter(took) }, age?))
    };
    let [there, back] = losses(outcomes.clone().count() as u32, samples);
    Some([
        LinkEstimate { delays: delays(0), loss: there, loss_age },
        LinkEstimate { delays: delays(1), loss: back, loss_age },
    ])
}

/// Returns the share of `sent` packets that either direction lost, by the reflector's count. Lost packets before the first
/// answered one and after the last count as lost on the way there.
fn losses(sent: u32, samples: impl Iterator<Item = Sample> + Clone) -> [Option<f64>; 2] {
    let (Some(first), Some(last)) = (samples.clone().next(), samples.clone().last()) else {
        return [Some(1.0), None];
    };
    let Some([there, back]) = directions(samples) else {
        // A single answer settles one packet. With several, the reflector's count is unusable.
        let one = first.sequence == last.sequence;
        return [one.then(|| 1.0 - 1.0 / f64::from(sent)), one.then_some(0.0)];
    };
    let between = f64::from(last.sequence.wrapping_sub(first.sequence));
    let came = 1.0 + between * (1.0 - there);
    let answered = 1.0 + between * (1.0 - there) * (1.0 - back);
    [Some((1.0 - came / f64::from(sent)).max(0.0)), Some(1.0 - answered / came)]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Reflector, Session, SessionConfig};

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// Returns the estimates of `count` packets, one per 100 ms, with a reflector's clock that is ahead. `way` gives the
    /// delay of each packet there and back, ms; `None` if it is lost. `least` gives the known delays.
    fn told(
        ahead_ms: i64,
        count: u64,
        way: impl Fn(u64) -> [Option<u64>; 2],
        least: impl Fn(u64) -> [Duration; 2],
    ) -> Option<[LinkEstimate; 2]> {
        let begins = Utc::UNIX_EPOCH + ms(1_700_000_000_000);
        let there_now = |at: Utc| {
            if ahead_ms < 0 { at - ms(ahead_ms.unsigned_abs()) } else { at + ms(ahead_ms.unsigned_abs()) }
        };
        let mut session =
            Session::new(SessionConfig { patience: ms(99), ..SessionConfig::default() }, begins);
        let mut reflector = Reflector::default();
        for i in 0..count {
            let sent = begins + ms(i * 100);
            while session.deadline().unwrap() < sent {
                assert_eq!(session.poll(session.deadline().unwrap()), None, "one is given up");
            }
            let probe = session.poll(sent).unwrap();
            let [Some(there), back] = way(i) else { continue };
            let came = there_now(sent + ms(there));
            let reply = reflector.reflect((), &probe, came, None).unwrap().sent_at(came + ms(1));
            let Some(back) = back else { continue };
            session.receive(&reply, sent + ms(there + 1 + back)).unwrap();
        }
        let now = begins + ms(count * 100);
        let _ = session.poll(now);
        session.one_way(now, |sent_at| least(sent_at.since(begins).as_millis() as u64 / 100))
    }

    #[test]
    fn known_least_delays_separate_the_directions() {
        // 10 ms there and 2 ms back, 3 ms of unknown delay each, and a queue on the way back.
        let way = |i: u64| [Some(13), Some(5 + 4 * (i % 2))];
        for ahead in [-5_000_000, 0, 77] {
            let [there, back] = told(ahead, 40, way, |_| [ms(10), ms(2)]).unwrap();
            let [(there, age), (back, _)] = [there, back].map(|told| told.delays.unwrap());
            assert_eq!((there.mean, there.jitter), (ms(13), Some(ms(0))), "{ahead}");
            assert_eq!((back.mean, back.jitter), (ms(7), Some(ms(4))), "{ahead}");
            assert_eq!(age, ms(100 - 23));
        }
    }

    #[test]
    fn known_least_delays_may_change() {
        let way = |i: u64| if i < 10 { [Some(5), Some(5)] } else { [Some(45), Some(5)] };
        let least = |i: u64| if i < 10 { [ms(4), ms(4)] } else { [ms(44), ms(4)] };
        let [there, back] = told(1_234, 20, way, least).unwrap().map(|told| told.delays.unwrap().0.mean);
        assert_eq!((there, back), (ms(25), ms(5)));
    }

    #[test]
    fn losses_are_assigned_to_their_direction() {
        // Of a hundred packets, ten are lost on the way there, and nine of the others on the way back; not the first, not
        // the last.
        let way = |i: u64| [(i % 10 != 5).then_some(3), (i % 10 != 3 || i == 3).then_some(7)];
        let [there, back] = told(9, 100, way, |_| [ms(0), ms(0)]).unwrap().map(|told| told.loss.unwrap());
        assert!((there - 0.1).abs() < 1e-9 && (back - 0.1).abs() < 1e-9, "{there} {back}");
        // The direction of losses on a silent path is unknown.
        let way = |i: u64| [(i < 25).then_some(3), Some(7)];
        let [there, back] = told(9, 100, way, |_| [ms(0), ms(0)]).unwrap().map(|told| told.loss);
        assert_eq!((there, back), (Some(0.75), Some(0.0)));
        let [there, back] = told(9, 30, |_| [None, None], |_| [ms(0), ms(0)]).unwrap();
        assert_eq!((there.loss, there.delays, back.loss, back.delays), (Some(1.0), None, None, None));
        assert_eq!(
            told(9, 1, |i| [(i > 0).then_some(1), None], |_| [ms(0), ms(0)]).unwrap()[0].loss,
            Some(1.0)
        );
    }

    proptest! {
        #[test]
        fn both_directions_sum_to_the_round_trip(
            ways in prop::collection::vec((0..80_u64, 0..18_u64), 1..40),
            ahead in -1_000_000..1_000_000_i64,
            known in (0..50_u64, 0..50_u64),
        ) {
            let mean = ways.iter().map(|(there, back)| there + back).sum::<u64>() as f64 / ways.len() as f64;
            let least = |_| [ms(known.0), ms(known.1)];
            let way = |i: u64| { let (there, back) = ways[i as usize]; [Some(there), Some(back)] };
            let [there, back] = told(ahead, ways.len() as u64, way, least).unwrap();
            let [there_ms, back_ms] = [there, back].map(|told| told.delays.unwrap().0.mean.as_secs_f64() * 1e3);
            // Wrong known delays would make one direction negative, which is reported as zero.
            prop_assert!(there_ms + back_ms >= mean - 1e-3);
            let least_there = ways.iter().map(|way| way.0).min().unwrap();
            let least_back = ways.iter().map(|way| way.1).min().unwrap();
            if least_there >= known.0 && least_back >= known.1 {
                prop_assert!((there_ms + back_ms - mean).abs() < 1e-3, "{there_ms} {back_ms} {mean}");
            }
            prop_assert_eq!((there.loss, back.loss), (Some(0.0), Some(0.0)));
        }
    }
}
