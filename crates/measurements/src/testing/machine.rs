//! Strategies for contexts of machines.

use cotorra_graph::{
    BitRate, CpuContext, Dbm, InterfaceContext, InterfaceTraffic, LoadAverage, MachineContext, MemoryContext,
    ReadingTime, Timestamp, WifiChannel, WifiContext, WifiRole, WifiStation,
};
use proptest::{collection::vec, option::of, prelude::*, sample::select};

use super::{duration, finite, node, share};

fn dbm() -> impl Strategy<Value = Option<Dbm>> {
    of(finite().prop_map(Dbm))
}

fn bit_rate() -> impl Strategy<Value = Option<BitRate>> {
    any::<u64>().prop_map(BitRate::from_bits_per_second)
}

prop_compose! {
    fn traffic()(counters: [u64; 4], throughput_bps in of(finite())) -> InterfaceTraffic {
        let [packets, bytes, errors, dropped] = counters;
        InterfaceTraffic { packets, bytes, errors, dropped, throughput_bps }
    }
}

prop_compose! {
    fn interface()(
        name in ".{0,9}", up: bool, carrier: bool, speed in bit_rate(), mtu_bytes: u32,
        received in traffic(), sent in traffic(),
    ) -> InterfaceContext {
        InterfaceContext { name, up, carrier, speed, mtu_bytes, received, sent }
    }
}

prop_compose! {
    fn wifi_station()(
        mac in ".{0,9}",
        signal in dbm(),
        (transmit_rate, receive_rate) in (bit_rate(), bit_rate()),
        (retransmissions, transmissions_failed) in any::<(Option<u32>, Option<u32>)>(),
        [transmit_airtime, receive_airtime, inactive] in [of(duration()), of(duration()), of(duration())],
    ) -> WifiStation {
        WifiStation {
            mac, signal, transmit_rate, receive_rate, retransmissions, transmissions_failed, transmit_airtime,
            receive_airtime, inactive,
        }
    }
}

prop_compose! {
    fn wifi()(
        interface in ".{0,9}",
        role in select(vec![WifiRole::AccessPoint, WifiRole::Client, WifiRole::Mesh, WifiRole::Other]),
        ssid in of(".{0,9}"),
        stations in vec(wifi_station(), 0..3),
        channels in vec((any::<u32>(), any::<bool>(), dbm(), of(share())), 0..3),
        (stations_left_out, channels_left_out) in any::<(u32, u32)>(),
    ) -> WifiContext {
        let channels = channels.into_iter().map(|(frequency_mhz, in_use, noise, busy)| {
            WifiChannel { frequency_mhz, in_use, noise, busy }
        });
        let channels = channels.collect();
        WifiContext { interface, role, ssid, stations, stations_left_out, channels, channels_left_out }
    }
}

prop_compose! {
    pub(super) fn context()(
        node in node(),
        cpu in of((any::<u32>(), of(share()))),
        load_average in of((finite(), finite(), finite())),
        memory in of((0..=u64::MAX / 2, 0..=u64::MAX / 2)),
        interfaces in vec(interface(), 0..4),
        wifi in vec(wifi(), 0..3),
        (interfaces_left_out, wifi_left_out) in any::<(u32, u32)>(),
        reading in of((any::<u64>(), duration())),
    ) -> MachineContext {
        let load = |(one_minute, five_minutes, fifteen_minutes)| {
            LoadAverage { one_minute, five_minutes, fifteen_minutes }
        };
        let memory_of = |(memory_bytes, available_bytes)| MemoryContext { memory_bytes, available_bytes };
        let reading_of = |(measured, error)| ReadingTime { measured: Timestamp::from_nanos(measured), error };
        MachineContext {
            node,
            reading: reading.map(reading_of),
            cpu: cpu.map(|(cpus, busy)| CpuContext { cpus, busy }),
            load_average: load_average.map(load),
            memory: memory.map(memory_of),
            interfaces,
            interfaces_left_out,
            wifi,
            wifi_left_out,
        }
    }
}
