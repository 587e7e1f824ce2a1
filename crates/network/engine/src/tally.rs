//! Counts the requests of VNFs with a demand as their programs report them.
#![allow(clippy::disallowed_types, reason = "programs serve in real time")]

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use crate::{
    computed::{RequestLine, Requests},
    engine::InstanceId,
};

/// Counts the requests of a VNF's instances on a node as their lines come.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    requests: Requests,
    /// Time for which instances served that have ended.
    ran: Duration,
    serving: BTreeMap<InstanceId, Serving>,
}

/// An instance that serves.
#[derive(Debug)]
struct Serving {
    since: Instant,
    /// Requests that are with it.
    present: u32,
}

impl Tally {
    /// Notes that an instance serves from now on.
    pub(crate) fn begin(&mut self, instance: InstanceId, now: Instant) {
        self.serving.entry(instance).or_insert(Serving { since: now, present: 0 });
    }

    /// Counts a line of an instance that serves.
    pub(crate) fn add(&mut self, instance: InstanceId, line: RequestLine) {
        let Some(Serving { present, .. }) = self.serving.get_mut(&instance) else { return };
        let requests = &mut self.requests;
        match line {
            RequestLine::Arrived => {
                requests.arrived += 1;
                *present += 1;
                requests.most = requests.most.max(*present);
            }
            RequestLine::Dropped => {
                requests.arrived += 1;
                requests.dropped += 1;
            }
            RequestLine::Served { cpu_time, waiting } => {
                *present = present.saturating_sub(1);
                requests.served += 1;
                requests.cpu_time += cpu_time;
                requests.waited += waiting;
                requests.waiting_ms.add(waiting.as_secs_f64() * 1e3);
            }
        }
    }

    /// Notes that an instance has ended, if it served.
    pub(crate) fn end(&mut self, instance: InstanceId, now: Instant) {
        if let Some(Serving { since, present }) = self.serving.remove(&instance) {
            self.ran += now.saturating_duration_since(since);
            self.requests.lost += u64::from(present);
        }
    }

    /// Returns the requests so far, and the time for which instances served.
    pub(crate) fn so_far(&self, now: Instant) -> (Requests, Duration) {
        let serving = self.serving.values().map(|its| now.saturating_duration_since(its.since));
        (self.requests.clone(), self.ran + serving.sum::<Duration>())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn requests_are_counted() {
        let began = Instant::now();
        let at = |s| began + Duration::from_secs(s);
        let [first, second] = [InstanceId(1), InstanceId(2)];
        let served =
            |cpu_us, waiting_us| RequestLine::Served { cpu_time: us(cpu_us), waiting: us(waiting_us) };
        let mut tally = Tally::default();
        tally.add(first, RequestLine::Arrived);
        tally.begin(first, at(0));
        for line in [
            RequestLine::Arrived,
            RequestLine::Arrived,
            RequestLine::Dropped,
            served(500, 0),
            RequestLine::Arrived,
            served(700, 2000),
        ] {
            tally.add(first, line);
        }
        tally.end(first, at(3));
        tally.begin(second, at(5));
        tally.add(second, RequestLine::Arrived);
        let (requests, ran) = tally.so_far(at(6));
        let Requests { arrived, served, dropped, lost, most, cpu_time, waited, waiting_ms } = requests;
        assert_eq!((arrived, served, dropped, lost, most), (5, 2, 1, 1, 2));
        assert_eq!((cpu_time, waited, waiting_ms.count()), (us(1200), us(2000), 2));
        assert_eq!(ran, Duration::from_secs(4));
    }
}
