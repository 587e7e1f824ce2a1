//! An instance of a VNF on a server: its requests, and what it did so far.

use std::{
    cmp::Ordering,
    collections::{BinaryHeap, VecDeque},
    time::Duration,
};

use cotorra_graph::{Computing, Scheduling, Timestamp};

/// Binary digits behind the point of CPUs, speeds and work.
pub(crate) const POINT: u32 = 32;

/// Returns a number of CPUs, or a speed, as a fixed-point number.
pub(crate) fn fixed(number: f64) -> u64 {
    (number * (1_u64 << POINT) as f64).round() as u64
}

/// Limits of an instance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Most CPUs that it uses, above 0.
    pub cpus: f64,
    /// The order in which it serves requests.
    pub scheduling: Scheduling,
    /// Most requests that wait or are served at a time.
    pub backlog: u32,
}

impl Limits {
    /// Returns the limits of a VNF's instance that uses at most so many CPUs.
    pub fn new(computing: &Computing, cpus: f64) -> Self {
        Self { cpus, scheduling: computing.scheduling, backlog: computing.backlog }
    }
}

/// What an instance did so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Load {
    /// Requests that arrived.
    pub arrived: u64,
    /// Requests that were finished.
    pub served: u64,
    /// Requests that were dropped, because the backlog was full.
    pub dropped: u64,
    /// Demands of the finished requests, on a CPU of speed 1.
    pub served_demand: Duration,
    /// Sum of the times from the arrivals of requests to their ends, those of unfinished requests up to now.
    pub in_system: Duration,
    /// Most requests that were with it at a time.
    pub most_requests: u32,
    /// CPU time that it used, in nanoseconds with [`POINT`] binary digits behind the point.
    pub(crate) used: u128,
}

impl Load {
    /// Returns the CPU time that it used.
    pub fn cpu_time(&self) -> Duration {
        Duration::from_nanos((self.used >> POINT) as u64)
    }

    /// Returns the load of an instance that used that CPU time, of which nothing else is known.
    pub fn of_cpu_time(time: Duration) -> Self {
        Self { used: time.as_nanos() << POINT, ..Self::default() }
    }

    /// Adds what another instance did.
    pub fn add(&mut self, other: &Self) {
        let Self { arrived, served, dropped, served_demand, in_system, most_requests, used } = other;
        self.arrived += arrived;
        self.served += served;
        self.dropped += dropped;
        self.served_demand += *served_demand;
        self.in_system += *in_system;
        self.most_requests = self.most_requests.max(*most_requests);
        self.used += used;
    }
}

/// A request.
#[derive(Debug, Clone)]
pub(crate) struct Request<T> {
    pub token: T,
    pub arrived: Timestamp,
    pub demand: Duration,
}

/// A request that is served.
#[derive(Debug, Clone)]
struct Served<T> {
    /// Work of its instance on each served request by which it is finished.
    finished_by: u128,
    /// Number of its arrival. Of requests that finish together, the first that arrived is first.
    number: u64,
    request: Request<T>,
}

impl<T> PartialEq for Served<T> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl<T> Eq for Served<T> {}

impl<T> PartialOrd for Served<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> Ord for Served<T> {
    /// The next to finish is the greatest.
    fn cmp(&self, other: &Self) -> Ordering {
        (other.finished_by, other.number).cmp(&(self.finished_by, self.number))
    }
}

/// An instance and its requests.
#[derive(Debug, Clone)]
pub(crate) struct Instance<T> {
    limit: u64,
    /// Most requests that it serves at a time.
    slots: usize,
    backlog: usize,
    /// Work so far on each request that was served all the time.
    worked: u128,
    /// Work on each served request in a nanosecond.
    rate: u64,
    /// CPUs that it uses now.
    cpus: u64,
    served: BinaryHeap<Served<T>>,
    waiting: VecDeque<Request<T>>,
    arrivals: u64,
    load: Load,
}

impl<T> Instance<T> {
    pub fn new(limits: Limits) -> Self {
        let slots = match limits.scheduling {
            Scheduling::Fifo { workers } => workers.max(1) as usize,
            Scheduling::Shared => usize::MAX,
        };
        Self {
            limit: fixed(limits.cpus),
            slots,
            backlog: limits.backlog as usize,
            worked: 0,
            rate: 0,
            cpus: 0,
            served: BinaryHeap::new(),
            waiting: VecDeque::new(),
            arrivals: 0,
            load: Load::default(),
        }
    }

    /// Takes a request; returns it if the backlog is full.
    pub fn arrive(&mut self, request: Request<T>) -> Result<(), Request<T>> {
        self.load.arrived += 1;
        let requests = self.served.len() + self.waiting.len();
        if requests >= self.backlog {
            self.load.dropped += 1;
            return Err(request);
        }
        self.load.most_requests = self.load.most_requests.max(requests as u32 + 1);
        self.waiting.push_back(request);
        self.fill();
        Ok(())
    }

    /// Serves waiting requests as long as there are free workers.
    fn fill(&mut self) {
        while self.served.len() < self.slots
            && let Some(request) = self.waiting.pop_front()
        {
            let finished_by = self.worked + (request.demand.as_nanos() << POINT);
            self.served.push(Served { finished_by, number: self.arrivals, request });
            self.arrivals += 1;
        }
    }

    /// Returns the CPUs that it can use.
    pub fn wanted(&self) -> u64 {
        let most = (self.served.len() as u64).saturating_mul(1 << POINT);
        self.limit.min(most)
    }

    /// Gives it CPUs of a speed from now on.
    pub fn give(&mut self, cpus: u64, speed: u64) {
        self.cpus = cpus;
        let served = self.served.len() as u128;
        let work = (u128::from(cpus) * u128::from(speed)) >> POINT;
        // One that is served goes on, however many there are.
        self.rate = work.checked_div(served).map_or(0, |rate| rate.max(1) as u64);
    }

    /// Returns the time until the next request is finished; `None` without a served one.
    pub fn next(&self) -> Option<Duration> {
        let next = self.served.peek()?;
        let left = next.finished_by.saturating_sub(self.worked);
        let ns = left.div_ceil(u128::from(self.rate.max(1)));
        Some(Duration::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX)))
    }

    /// Works for so long.
    pub fn work(&mut self, ns: u64) {
        self.worked += u128::from(self.rate) * u128::from(ns);
        self.load.used += u128::from(self.cpus) * u128::from(ns);
        let requests = (self.served.len() + self.waiting.len()) as u32;
        self.load.in_system += Duration::from_nanos(ns) * requests;
    }

    /// Takes the next request that is finished, and serves another.
    pub fn finish(&mut self) -> Option<Request<T>> {
        if self.served.peek()?.finished_by > self.worked {
            return None;
        }
        let finished = self.served.pop()?.request;
        self.load.served += 1;
        self.load.served_demand += finished.demand;
        self.fill();
        Some(finished)
    }

    /// Returns the requests that it has, in no order.
    pub fn into_requests(self) -> Vec<Request<T>> {
        self.served.into_iter().map(|served| served.request).chain(self.waiting).collect()
    }

    pub fn load(&self) -> Load {
        self.load
    }
}
