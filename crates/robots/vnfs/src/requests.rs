//! Requests of an instance that threads work on, without the threads.

use std::{collections::VecDeque, time::Duration};

use cotorra_computing::Limits;
use cotorra_graph::Scheduling;

/// A request.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Request<T> {
    /// CPU time that it still takes.
    pub(crate) left: Duration,
    pub(crate) token: T,
}

/// Requests of an instance. As in virtual time, some are served at a time, which take turns, and others wait in the order of
/// their arrival.
#[derive(Debug)]
pub(crate) struct Requests<T> {
    /// Most requests that are served at a time.
    slots: usize,
    backlog: usize,
    /// Served requests that no thread works on, the next one first.
    served: VecDeque<Request<T>>,
    /// Number of served requests that threads work on.
    in_work: usize,
    waiting: VecDeque<Request<T>>,
}

impl<T> Requests<T> {
    pub(crate) fn new(limits: &Limits) -> Self {
        let slots = match limits.scheduling {
            Scheduling::Fifo { workers } => workers.max(1) as usize,
            Scheduling::Shared => usize::MAX,
        };
        let backlog = limits.backlog as usize;
        Self { slots, backlog, served: VecDeque::new(), in_work: 0, waiting: VecDeque::new() }
    }

    /// Returns the most requests that are served at a time.
    pub(crate) fn slots(&self) -> usize {
        self.slots.min(self.backlog)
    }

    /// Takes a request; returns it if the backlog is full.
    pub(crate) fn arrive(&mut self, request: Request<T>) -> Result<(), Request<T>> {
        if self.served.len() + self.in_work + self.waiting.len() >= self.backlog {
            return Err(request);
        }
        self.waiting.push_back(request);
        self.fill();
        Ok(())
    }

    /// Serves waiting requests as long as there is room.
    fn fill(&mut self) {
        while self.served.len() + self.in_work < self.slots
            && let Some(request) = self.waiting.pop_front()
        {
            self.served.push_back(request);
        }
    }

    /// Returns the next request to work on; [`Self::put_back`] or [`Self::finish`] ends the work.
    pub(crate) fn take(&mut self) -> Option<Request<T>> {
        let next = self.served.pop_front()?;
        self.in_work += 1;
        Some(next)
    }

    /// Puts a request back that takes more work. It has its next turn after the others.
    pub(crate) fn put_back(&mut self, request: Request<T>) {
        self.in_work -= 1;
        self.served.push_back(request);
    }

    /// Ends the work on a request that is finished.
    pub(crate) fn finish(&mut self) {
        self.in_work -= 1;
        self.fill();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN: Duration = Duration::from_millis(1);

    fn requests(scheduling: Scheduling, backlog: u32) -> Requests<usize> {
        Requests::new(&Limits { cpus: 1.0, scheduling, backlog })
    }

    fn arrive(requests: &mut Requests<usize>, token: usize, turns: u32) -> bool {
        requests.arrive(Request { left: TURN * turns, token }).is_ok()
    }

    /// Works on all requests with one thread, and returns the order in which they are finished.
    fn finished(requests: &mut Requests<usize>) -> Vec<usize> {
        let mut order = Vec::new();
        while let Some(Request { left, token }) = requests.take() {
            match left - TURN {
                Duration::ZERO => {
                    order.push(token);
                    requests.finish();
                }
                left => requests.put_back(Request { left, token }),
            }
        }
        order
    }

    #[test]
    fn workers_serve_in_the_order_of_arrival_and_shared_service_takes_turns() {
        for (scheduling, expected) in [
            (Scheduling::Fifo { workers: 1 }, [0, 1, 2, 3]),
            (Scheduling::Fifo { workers: 2 }, [1, 2, 0, 3]),
            (Scheduling::Shared, [1, 2, 3, 0]),
        ] {
            let mut requests = requests(scheduling, 10);
            for (token, turns) in [(0, 9), (1, 1), (2, 3), (3, 8)] {
                assert!(arrive(&mut requests, token, turns));
            }
            assert_eq!(finished(&mut requests), expected, "{scheduling:?}");
        }
    }

    #[test]
    fn requests_beyond_the_backlog_are_returned() {
        let mut requests = requests(Scheduling::Fifo { workers: 1 }, 2);
        assert!(arrive(&mut requests, 0, 1) && arrive(&mut requests, 1, 1) && !arrive(&mut requests, 2, 1));
        let first = requests.take().unwrap();
        assert_eq!(first.token, 0);
        assert!(!arrive(&mut requests, 3, 1), "the first one is still in work");
        requests.finish();
        assert!(arrive(&mut requests, 4, 1));
        assert_eq!(finished(&mut requests), [1, 4]);
    }

    #[test]
    fn no_thread_takes_more_than_the_workers_serve() {
        let mut requests = requests(Scheduling::Fifo { workers: 2 }, 9);
        (0..3).for_each(|token| assert!(arrive(&mut requests, token, 1)));
        assert!(requests.take().is_some() && requests.take().is_some());
        assert_eq!(requests.take(), None);
        requests.finish();
        assert_eq!(requests.take(), Some(Request { left: TURN, token: 2 }));
    }
}
