//! The medium: frames of hwsim's radios on one side, the fabric's air on the other.

use std::{collections::BTreeMap, sync::Arc};

use cotorra_fabric::{
    Antenna, Category, Fabric, FabricError, PhyRate, RateTries, Receiver, Report, Transmission,
};
use cotorra_graph::{Dbm, NodeId, Timestamp};

use crate::{
    address::MacAddress,
    agreements::Agreements,
    header::{FrameType, Header},
    message::{Alias, DELIVERABLE, Delivery, Frame, Message, Rates, Status, Tries},
    rate::{legacy_index, phy_rate, wants_rts},
};

/// Bytes of the check sequence, which frames on the air have.
const CHECK_SEQUENCE: usize = 4;
/// Addresses of all radios together, at most. Those of further interfaces are unknown.
const MOST_ADDRESSES: usize = 4096;

/// Makes the fabric's air the medium of hwsim's radios. Each radio has the antenna of a robot or a radio unit.
///
/// It is a state machine without sockets and clocks. Give it what the kernel sends ([`Self::handle`]), and send the kernel
/// what it returns. After each poll of the fabric, call [`Self::poll`] until there is nothing more to send. Tell it what the
/// kernel [refuses](Self::refused), so that frames to radios that do not listen stay unacknowledged, and when it has refused
/// [nothing more](Self::confirm). [`Exchange`](crate::Exchange) does all of this.
#[derive(Debug, Default)]
pub struct Medium {
    radios: Vec<Member>,
    by_hardware: BTreeMap<MacAddress, usize>,
    by_antenna: BTreeMap<Antenna, usize>,
    /// Receivers of frames to an address.
    by_address: BTreeMap<MacAddress, usize>,
    agreements: Agreements,
    /// Frames that the air has not settled, by their number.
    under_way: BTreeMap<u64, UnderWay>,
    sent: u64,
    /// Frames to one radio that the kernel may refuse: their numbers and that of the transmission.
    delivered: BTreeMap<u32, u64>,
    numbered: u32,
    /// Number of times that the kernel's refusals were known.
    confirmed: u64,
    /// A report that depends on refusals.
    held: Option<Report>,
}

#[derive(Debug)]
struct Member {
    hardware: MacAddress,
    antenna: Antenna,
    counts: TryCounts,
}

/// Counts of a radio's frames that are to be acknowledged, and whose last try is over.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TryCounts {
    /// Frames.
    pub frames: u64,
    /// Frames that were acknowledged.
    pub acknowledged: u64,
    /// Tries of all frames.
    pub tries: u64,
    /// Frames of which the kernel said that they may go in an A-MPDU.
    pub aggregates: u64,
}

#[derive(Debug)]
struct UnderWay {
    radio: usize,
    frame: Arc<[u8]>,
    frequency_mhz: u16,
    cookie: u64,
    no_ack: bool,
    aggregates: bool,
    rates: Rates,
    to: Receiver,
    /// The number of its delivery to one radio; how often refusals had been known then; and whether the kernel refused it.
    delivery: Option<(u32, u64)>,
    refused: bool,
}

/// A message to the kernel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outgoing {
    /// The number to send it with. Refusals have it.
    pub number: u32,
    /// The message.
    pub message: Message,
}

impl Medium {
    /// Returns a medium without radios.
    pub fn new() -> Self {
        Self::default()
    }

    /// Gives a radio the antenna of a robot or a radio unit. `hardware` is the address that the kernel names it by: its
    /// permanent address, if it was created with one.
    ///
    /// # Errors
    /// Those of [`Fabric::lend_antenna`].
    pub fn join(
        &mut self,
        now: Timestamp,
        fabric: &mut Fabric,
        node: &NodeId,
        hardware: MacAddress,
    ) -> Result<(), FabricError> {
        let antenna = fabric.lend_antenna(now, node)?;
        let radio = self.radios.len();
        self.radios.push(Member { hardware, antenna, counts: TryCounts::default() });
        self.by_hardware.insert(hardware, radio);
        self.by_antenna.insert(antenna, radio);
        Ok(())
    }

    /// Takes a message of the kernel's. Returns the answer if there is one at once: the status of a frame that cannot be
    /// sent.
    pub fn handle(&mut self, now: Timestamp, fabric: &mut Fabric, message: &Message) -> Option<Outgoing> {
        match message {
            Message::Frame(frame) => return self.transmit(now, fabric, frame),
            Message::AddAddress(Alias { radio, address }) => {
                if let Some(&radio) = self.by_hardware.get(radio) {
                    self.learn(*address, radio);
                }
            }
            Message::RemoveAddress(Alias { radio, address }) => {
                let radio = self.by_hardware.get(radio);
                if radio.is_some() && self.by_address.get(address) == radio {
                    self.by_address.remove(address);
                }
            }
            _ => {}
        }
        None
    }

    /// Records that the kernel refused the message of this number: the receiver is off, or on another channel.
    pub fn refused(&mut self, now: Timestamp, fabric: &mut Fabric, number: u32) {
        let Some(id) = self.delivered.remove(&number) else { return };
        let Some(under_way) = self.under_way.get_mut(&id) else { return };
        under_way.refused = true;
        if let Receiver::One(antenna) | Receiver::OneWithoutAnswer(antenna) = under_way.to {
            fabric.stop_listening(now, antenna);
        }
    }

    /// Records that no refusal of what was sent so far waits. The kernel refuses a message before its sending returns.
    pub fn confirm(&mut self) {
        self.confirmed += 1;
    }

    /// Whether the next message depends on refusals that are not known yet. [`Self::poll`] returns nothing until
    /// [they are](Self::confirm).
    pub fn awaits_refusals(&self) -> bool {
        self.held.as_ref().is_some_and(|report| self.depends_on_refusals(report))
    }

    fn depends_on_refusals(&self, report: &Report) -> bool {
        let Report::Settled { id, acknowledged: Some(_), .. } = report else { return false };
        let delivery = self.under_way.get(id).and_then(|sent| sent.delivery);
        delivery.is_some_and(|(_, confirmed)| confirmed == self.confirmed)
    }

    /// Returns the next message to the kernel: a frame that a radio receives now, or the status of one that is settled.
    pub fn poll(&mut self, fabric: &mut Fabric) -> Option<Outgoing> {
        while let Some(report) = self.held.take().or_else(|| fabric.next_report()) {
            if self.depends_on_refusals(&report) {
                self.held = Some(report);
                return None;
            }
            let outgoing = match report {
                Report::Received { id, by, signal, rate, .. } => self.deliver(id, by, signal, rate),
                Report::Settled { id, tries, acknowledged, .. } => self.settle(id, &tries, acknowledged),
            };
            if outgoing.is_some() {
                return outgoing;
            }
        }
        None
    }

    /// Returns the number of frames that the air has not settled.
    pub fn under_way(&self) -> usize {
        self.under_way.len()
    }

    /// Returns the counts of a radio's frames; `None` for one that has not joined.
    pub fn counts(&self, hardware: MacAddress) -> Option<TryCounts> {
        self.by_hardware.get(&hardware).map(|radio| self.radios[*radio].counts)
    }

    fn transmit(&mut self, now: Timestamp, fabric: &mut Fabric, sent: &Frame) -> Option<Outgoing> {
        let Frame { radio, frame, frequency_mhz, no_ack, aggregates, rates, cookie, .. } = sent;
        let known = self.by_hardware.get(radio).copied();
        let frequency_mhz = frequency_mhz.and_then(|mhz| u16::try_from(mhz).ok());
        let (Some(radio), Some(frequency_mhz), Some(header)) = (known, frequency_mhz, Header::parse(frame))
        else {
            // The kernel keeps each frame until it gets its status, and drops others if there are many.
            return Some(self.number(Message::Status(Status {
                radio: *radio,
                cookie: *cookie,
                acknowledged: false,
                no_ack: *no_ack,
                rates: Rates::default(),
                signal_dbm: 0,
            })));
        };
        if let Some(transmitter) = header.transmitter {
            // Interfaces that were there before the medium are not announced.
            if !self.by_address.contains_key(&transmitter) {
                self.learn(transmitter, radio);
            }
        }
        self.agreements.see(&header, frame);
        let (rates, tried) = usable(rates, frequency_mhz);
        let to = self.receiver(radio, &header, *no_ack);
        self.sent += 1;
        let transmission = Transmission {
            id: self.sent,
            frequency_mhz,
            psdu_bytes: (frame.len() + CHECK_SEQUENCE) as u32,
            category: category(&header),
            to,
            packet_bytes: header.packet_bytes(frame.len()).map(|bytes| bytes as u32),
            aggregates: *aggregates || self.agreements.cover(&header),
            rates: tried,
        };
        self.under_way.insert(
            self.sent,
            UnderWay {
                radio,
                frame: Arc::clone(frame),
                frequency_mhz,
                cookie: *cookie,
                no_ack: *no_ack,
                aggregates: *aggregates,
                rates,
                to,
                delivery: None,
                refused: false,
            },
        );
        fabric.transmit(now, self.radios[radio].antenna, transmission);
        None
    }

    /// Returns who a frame is for.
    fn receiver(&self, sender: usize, header: &Header, no_ack: bool) -> Receiver {
        if header.receiver.is_group() {
            return Receiver::All;
        }
        let owner = self.by_address.get(&header.receiver).filter(|owner| **owner != sender);
        match owner {
            Some(owner) if no_ack || !header.is_acknowledged() => {
                Receiver::OneWithoutAnswer(self.radios[*owner].antenna)
            }
            Some(owner) => Receiver::One(self.radios[*owner].antenna),
            None => Receiver::Nobody,
        }
    }

    fn learn(&mut self, address: MacAddress, radio: usize) {
        if !address.is_group() && self.by_address.len() < MOST_ADDRESSES {
            self.by_address.insert(address, radio);
        }
    }

    fn deliver(&mut self, id: u64, by: Antenna, signal: Dbm, rate: PhyRate) -> Option<Outgoing> {
        let radio = self.radios.get(*self.by_antenna.get(&by)?)?.hardware;
        let sent = self.under_way.get(&id).filter(|sent| DELIVERABLE.contains(&sent.frame.len()))?;
        let outgoing = Outgoing {
            number: self.numbered.wrapping_add(1),
            message: Message::Delivery(Delivery {
                radio,
                frame: Arc::clone(&sent.frame),
                rate: legacy_index(rate, sent.frequency_mhz),
                signal_dbm: rounded(signal),
                frequency_mhz: Some(sent.frequency_mhz.into()),
            }),
        };
        self.numbered = outgoing.number;
        if let Some(sent) = self.under_way.get_mut(&id).filter(|sent| sent.to != Receiver::All) {
            sent.delivery = Some((outgoing.number, self.confirmed));
            self.delivered.insert(outgoing.number, id);
        }
        Some(outgoing)
    }

    fn settle(&mut self, id: u64, tries: &[u32], acknowledged: Option<Dbm>) -> Option<Outgoing> {
        let sent = self.under_way.remove(&id)?;
        if let Some((number, _)) = sent.delivery {
            self.delivered.remove(&number);
        }
        let acknowledged = acknowledged.filter(|_| !sent.refused);
        // A sender that heard no acknowledgement has tried all it could.
        let all = sent.refused && !sent.no_ack;
        let made = |(rate, made): (Tries, &u32)| Tries {
            count: if all { rate.count.max(1) } else { u8::try_from(*made).unwrap_or(u8::MAX) },
            ..rate
        };
        let rates = Rates::new(sent.rates.iter().zip(tries).map(made).take_while(|rate| rate.count > 0));
        let radio = self.radios.get_mut(sent.radio)?;
        if matches!(sent.to, Receiver::One(_) | Receiver::Nobody) {
            radio.counts.frames += 1;
            radio.counts.acknowledged += u64::from(acknowledged.is_some());
            radio.counts.tries += rates.iter().map(|tries| u64::from(tries.count)).sum::<u64>();
            radio.counts.aggregates += u64::from(sent.aggregates);
        }
        let status = Status {
            radio: radio.hardware,
            cookie: sent.cookie,
            acknowledged: acknowledged.is_some(),
            no_ack: sent.no_ack,
            rates,
            signal_dbm: acknowledged.map_or(0, rounded),
        };
        Some(self.number(Message::Status(status)))
    }

    fn number(&mut self, message: Message) -> Outgoing {
        self.numbered = self.numbered.wrapping_add(1);
        Outgoing { number: self.numbered, message }
    }
}

/// Returns the rates up to the first that is none, or else the slowest, once; and the same for the air.
fn usable(rates: &Rates, frequency_mhz: u16) -> (Rates, Vec<RateTries>) {
    const SLOWEST: Tries = Tries { index: 0, count: 1, flags: 0 };
    let known = |rates: &Rates| -> Vec<RateTries> {
        let on_air = |tries: Tries| {
            let rate = phy_rate(tries, frequency_mhz)?;
            Some(RateTries { rate, tries: tries.count.into(), rts: wants_rts(tries) })
        };
        rates.iter().map_while(on_air).collect()
    };
    let on_air = known(rates);
    if on_air.is_empty() {
        let slowest = Rates::new([SLOWEST]);
        return (slowest, known(&slowest));
    }
    (*rates, on_air)
}

/// Returns the access category of a frame (IEEE 802.11-2020, 10.2.3.2, tables 9-1 and 10-1): that of its user priority,
/// voice for management frames, and otherwise best effort.
fn category(header: &Header) -> Category {
    match (header.kind, header.tid) {
        (FrameType::Management, _) | (_, Some(6 | 7)) => Category::Voice,
        (_, Some(4 | 5)) => Category::Video,
        (_, Some(1 | 2)) => Category::Background,
        _ => Category::BestEffort,
    }
}

fn rounded(power: Dbm) -> i32 {
    power.0.round() as i32
}

#[cfg(test)]
mod tests;
