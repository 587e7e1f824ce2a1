//! The network between both ends, and what their worlds share.

use std::time::Duration;

use cotorra_agent_protocol::{Agent, LEASE, Report, Run, Transmit, Wanted};
use cotorra_graph::Timestamp;

pub const STEP: Duration = Duration::from_millis(10);

/// Returns how many steps a time takes.
pub fn steps_of(time: Duration) -> u32 {
    time.as_millis() as u32 / STEP.as_millis() as u32
}

/// Steps in which a lease and what is under way pass, several times over.
pub fn settling() -> u32 {
    steps_of(LEASE * 4)
}

/// A message under way.
#[derive(Clone)]
pub enum Message {
    ToAgent(Transmit),
    ToCore(Report),
}

/// A network that loses, doubles, delays and overtakes messages.
pub struct Carrier {
    under_way: Vec<(Timestamp, Message)>,
    pub is_cut: bool,
    /// Draws a fault: lost if it is 0, doubled if it is 1, and delayed by so many steps.
    faults: Box<dyn FnMut() -> u8>,
}

impl Carrier {
    pub fn new(faults: impl FnMut() -> u8 + 'static) -> Self {
        Self { under_way: Vec::new(), is_cut: false, faults: Box::new(faults) }
    }

    /// Creates a network with these faults, again and again.
    pub fn with(faults: Vec<u8>) -> Self {
        let mut place = 0;
        Self::new(move || {
            place += 1;
            faults[place % faults.len()] % 16
        })
    }

    /// Creates a network that delays messages a little.
    pub fn sound() -> Self {
        Self::new(|| 2)
    }

    pub fn send(&mut self, now: Timestamp, message: Message) {
        let fault = (self.faults)();
        if self.is_cut || fault == 0 {
            return;
        }
        if fault == 1 {
            self.under_way.push((now + STEP * 9, message.clone()));
        }
        self.under_way.push((now + STEP * u32::from(fault % 8), message));
    }

    /// Returns the messages that have arrived by now, as they were read.
    pub fn arrived(&mut self, now: Timestamp) -> Vec<Message> {
        let (due, later): (Vec<_>, Vec<_>) = self.under_way.drain(..).partition(|(at, _)| *at <= now);
        self.under_way = later;
        let read = |(_, message)| match message {
            Message::ToAgent(Transmit::Wanted(agent, wanted)) => {
                let wanted = Wanted::decode(&wanted.encode()).unwrap();
                Message::ToAgent(Transmit::Wanted(agent, wanted.into()))
            }
            Message::ToCore(report) => Message::ToCore(Report::decode(&report.encode()).unwrap()),
            beat => beat,
        };
        due.into_iter().map(read).collect()
    }

    /// Cuts the network, and loses what is under way.
    pub fn cut(&mut self) {
        self.is_cut = true;
        self.under_way.clear();
    }

    /// Ends all faults.
    pub fn heal(&mut self) {
        self.is_cut = false;
        self.faults = Box::new(|| 2);
    }
}

/// Gives a message to an agent. Returns the run that sent it.
pub fn tell(agent: &mut Agent, now: Timestamp, transmit: Transmit) -> Run {
    match transmit {
        Transmit::Wanted(_, wanted) => {
            let run = wanted.run;
            agent.want(now, *wanted);
            run
        }
        Transmit::Beat(_, beat) => {
            agent.beat(now, beat);
            beat.run
        }
    }
}
