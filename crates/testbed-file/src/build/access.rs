//! Sharing of a wireless network's channels by its senders, and what disturbs them.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Access, Contention, Edca, FixedRate, FqCodel, Interferer, InterfererKind, Node, NodeKind, PowerSave,
    Presence, Probability, QueueDiscipline, QueueLimit, RateControl, WifiStandard, WirelessNetwork,
};

use super::builder::{Builder, each};
use crate::{
    records::{
        AccessWord, DeviceRecord, EmitterRecord, FixedRateRecord, InterferenceRecord, NodeRecord,
        OtherNetworkRecord, PowerSaveRecord, PresenceRecord, QueueRecord, WirelessRecord,
    },
    yaml::decode::{Either, Spanned, words},
};

/// Times of frames and pulses. Shorter ones would cost a run its speed.
const AIRTIMES: [Duration; 2] = [Duration::from_micros(100), Duration::from_secs(1)];

impl Builder<'_> {
    pub(super) fn access(&mut self, ssid: &Spanned<String>, record: &WirelessRecord) -> Option<Access> {
        let edca = self.edca(record);
        let interference = self.interference(ssid, record)?;
        let software = self.software(record)?;
        let contention = edca.map(|edca| Box::new(Contention { edca, interference, software }));
        Some(contention.map_or(Access::Turns, Access::Contention))
    }

    fn edca(&mut self, record: &WirelessRecord) -> Option<Edca> {
        let can_aggregate = record.standard.aggregates();
        match &record.access.value {
            Either::Short(AccessWord::Turns) => None,
            Either::Short(AccessWord::Edca) => Some(Edca {
                aggregation: can_aggregate,
                rate_control: RateControl::Minstrel,
                power_save: None,
                queue: record.standard.queue_limit(),
                queue_discipline: QueueDiscipline::FqCodel(FqCodel::MAC80211),
            }),
            Either::Long(settings) => {
                if let Some(aggregation) =
                    settings.aggregation.as_ref().filter(|on| on.value && !can_aggregate)
                {
                    self.sink
                        .error(&aggregation.span, "802.11a and g do not aggregate frames")
                        .help("leave `aggregation` out, or write `standard: n`, `ac` or `ax`");
                }
                let aggregation = settings.aggregation.as_ref().map_or(can_aggregate, |on| on.value);
                let power_save = match &settings.power_save {
                    None => None,
                    Some(record) => Some(self.power_save(record)?),
                };
                let (queue, queue_discipline) = self.radio_queue(record.standard, settings.queue.as_ref())?;
                let rate_control = match &settings.rate_control {
                    Either::Short(control) => *control,
                    Either::Long(FixedRateRecord { fixed }) => self.fixed_rate(record, fixed)?,
                };
                Some(Edca { aggregation, rate_control, power_save, queue, queue_discipline })
            }
        }
    }

    /// Returns the rate control of stations that send at a fixed rate, which the standard has.
    fn fixed_rate(&mut self, record: &WirelessRecord, rate: &Spanned<FixedRate>) -> Option<RateControl> {
        let (width, streams) = (record.width.value, record.streams.value.clamp(1, 2));
        let rates = record.standard.fixed_rates(width, streams);
        if !rates.contains(&rate.value) {
            let at_2_ghz_or_5 = record.standard.described();
            let streams = if streams == 1 { "one stream" } else { "two streams" };
            let message = match rate.value {
                FixedRate::Mcs(_) if record.standard.aggregates() => {
                    format!("{at_2_ghz_or_5} has no {} with {streams} in {} MHz", rate.value, width.mhz())
                }
                _ => format!("{at_2_ghz_or_5} has no {}", rate.value),
            };
            let help = match &rates[..] {
                [first @ FixedRate::Mcs(_), .., last] => format!("write `{first}` to `{last}`"),
                rates => format!(
                    "its rates are {}",
                    words(&rates.iter().map(FixedRate::to_string).collect::<Vec<_>>())
                ),
            };
            self.sink.error(&rate.span, message).help(help);
            return None;
        }
        Some(RateControl::Fixed(rate.value))
    }

    /// Returns the limit and the discipline of the queues of radios.
    fn radio_queue(
        &mut self,
        standard: WifiStandard,
        queue: Option<&Spanned<Either<QueueLimit, QueueRecord>>>,
    ) -> Option<(QueueLimit, QueueDiscipline)> {
        let Some(queue) = queue else {
            let fair = QueueDiscipline::FqCodel(FqCodel::MAC80211);
            return Some((standard.queue_limit(), fair));
        };
        let (limit, discipline) = self.queue(Some(&queue.value))?;
        let discipline = discipline.unwrap_or_default();
        if !matches!(discipline, QueueDiscipline::DropTail | QueueDiscipline::FqCodel(_)) {
            self.sink
                .error(&queue.span, format!("radios have no queues with {}", discipline.name()))
                .help("write `fq_codel` or `drop_tail`, or put a wired link with the discipline next to the radio unit");
            return None;
        }
        Some((limit.unwrap_or_default(), discipline))
    }

    fn power_save(&mut self, record: &PowerSaveRecord) -> Option<PowerSave> {
        if record.dtim_period.value == 0 {
            self.sink
                .error(&record.dtim_period.span, "a DTIM period of 0 beacons")
                .help("write 1 or more; 2 is the default of hostapd");
            return None;
        }
        let idle = record.idle.value;
        if idle < AIRTIMES[0] {
            self.sink
                .error(&record.idle.span, format!("stations that sleep after {idle:?}"))
                .help("write `100 ms`, as Linux does; leave `power_save` out for stations that never sleep");
            return None;
        }
        Some(PowerSave { idle, dtim_period: record.dtim_period.value })
    }

    fn interference(&mut self, ssid: &Spanned<String>, record: &WirelessRecord) -> Option<Vec<Interferer>> {
        let first = record.interference.0.first();
        if let (Some((name, _)), Either::Short(AccessWord::Turns)) = (first, &record.access.value) {
            self.sink
                .error(&name.span, "interference in a network whose senders take turns")
                .help("leave `access: turns` out, so that its stations sense the channel");
        }
        each(&record.interference.0, |(name, record)| {
            let (emitter, kind) = match record {
                InterferenceRecord::Network(network) => (&network.emitter, self.other_network(network)?),
                InterferenceRecord::Device(device) => (&device.emitter, self.device(device)?),
            };
            self.check_channel(ssid, emitter);
            let presence = match &emitter.presence {
                None => None,
                Some(PresenceRecord { on, off }) => {
                    Some(Presence { on: self.some_time(on)?, off: self.some_time(off)? })
                }
            };
            Some(Interferer {
                name: name.value.clone(),
                channel: emitter.channel.value,
                position: emitter.position,
                tx_power: emitter.tx_power,
                kind,
                presence,
            })
        })
    }

    fn other_network(&mut self, record: &OtherNetworkRecord) -> Option<InterfererKind> {
        if record.load.value == Probability::ZERO {
            self.sink.error(&record.load.span, "a network that sends nothing").help("write a load above 0 %");
            return None;
        }
        let airtime = self.airtime(&record.airtime)?;
        Some(InterfererKind::Network { load: record.load.value, airtime })
    }

    fn device(&mut self, record: &DeviceRecord) -> Option<InterfererKind> {
        Some(InterfererKind::Device { on: self.airtime(&record.on)?, off: self.airtime(&record.off)? })
    }

    fn airtime(&mut self, time: &Spanned<Duration>) -> Option<Duration> {
        let [least, most] = AIRTIMES;
        if !(least..=most).contains(&time.value) {
            self.sink
                .error(&time.span, format!("a transmission or pause of {:?}", time.value))
                .help(format!("write a time from {least:?} to {most:?}"));
            return None;
        }
        Some(time.value)
    }

    fn some_time(&mut self, time: &Spanned<Duration>) -> Option<Duration> {
        let least = AIRTIMES[0];
        if time.value < least {
            self.sink
                .error(&time.span, format!("a mean presence or absence of {:?}", time.value))
                .help(format!("write {least:?} or more; leave `presence` out for what is always there"));
            return None;
        }
        Some(time.value)
    }

    /// Checks that a radio unit of the network is on the channel of an interferer.
    fn check_channel(&mut self, ssid: &Spanned<String>, emitter: &EmitterRecord) {
        let channel = &emitter.channel;
        let mut channels: Vec<_> = self
            .record
            .nodes
            .0
            .iter()
            .filter_map(|(_, node)| match node {
                NodeRecord::RadioUnit(unit) => {
                    let is_here = unit.network.as_ref().is_none_or(|network| network.value == ssid.value);
                    is_here.then_some(unit.channel.value)
                }
                _ => None,
            })
            .collect();
        if channels.contains(&channel.value) {
            return;
        }
        channels.sort_unstable();
        channels.dedup();
        let there: Vec<_> = channels.iter().map(u8::to_string).collect();
        let help = match &there[..] {
            [] => "add radio units to the network".to_owned(),
            _ => format!("write a channel that it uses: {}", there.join(", ")),
        };
        let message = format!("no radio unit of `{}` is on channel {}", ssid.value, channel.value);
        self.sink.error(&channel.span, message).help(help);
    }

    /// Checks that the networks on one channel share it in the same way.
    pub(super) fn check_shared_channels(
        &mut self,
        wireless: &BTreeMap<String, WirelessNetwork>,
        nodes: &[Node],
    ) {
        let mut contention_by_channel = BTreeMap::new();
        for node in nodes {
            let NodeKind::RadioUnit(unit) = &node.kind else { continue };
            let Some(network) = wireless.get(&unit.network) else { continue };
            let contends = network.access.contends();
            let frequency_mhz = network.standard.frequency_mhz(unit.channel);
            let (before, other) =
                *contention_by_channel.entry(frequency_mhz).or_insert((contends, unit.network.as_str()));
            if before != contends {
                let record = self.record.wireless.0.iter().find(|(ssid, _)| ssid.value == unit.network);
                let Some((ssid, _)) = record else { continue };
                let message = format!(
                    "`{}` and `{other}` are on channel {}, and only one of them contends for it",
                    unit.network, unit.channel
                );
                self.sink.error(&ssid.span, message).help("give both the same `access`");
                return;
            }
        }
    }
}
