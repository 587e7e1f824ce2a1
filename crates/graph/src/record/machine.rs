//! Contexts of machines.

use super::{
    Columns, Fields, Reader, Record, SeriesPart, Source, Table, Unreadable, Value, columns, required,
    unreadable,
};
use crate::{
    machine_context::{
        CpuContext, InterfaceContext, InterfaceTraffic, LoadAverage, MachineContext, MemoryContext,
        ReadingTime,
    },
    units::Timestamp,
};

columns! {
    InterfaceTraffic { packets, bytes, errors, dropped, throughput_bps }
}

/// The name is written once for all rows, like those of nodes.
impl Columns for InterfaceContext {
    fn put<'a>(&'a self, row: &mut Fields<'a>) {
        row.0.push(Value::Name(&self.name));
        self.up.put(row);
        self.carrier.put(row);
        self.speed.put(row);
        self.mtu_bytes.put(row);
        self.received.put(row);
        self.sent.put(row);
    }

    fn take<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Self, E> {
        Ok(Self {
            name: required(row.0.name()?)?.as_ref().to_owned(),
            up: row.take()?,
            carrier: row.take()?,
            speed: row.take()?,
            mtu_bytes: row.take()?,
            received: row.take()?,
            sent: row.take()?,
        })
    }
}

impl Record for MachineContext {
    #[rustfmt::skip]
    const TABLE: Table = Table {
        columns: &[
            "node", "cpus", "cpu_busy", "one_minute", "five_minutes", "fifteen_minutes", "memory_bytes", "available_bytes",
            "interfaces_left_out", "wifi_left_out", "wifi", "measured_ns", "time_error_ms",
        ],
        series: &["node"],
        children: Some(("machine_interface", &[
            "interface", "up", "carrier", "speed_bps", "mtu_bytes",
            "received_packets", "received_bytes", "received_errors", "received_dropped", "received_throughput_bps",
            "sent_packets", "sent_bytes", "sent_errors", "sent_dropped", "sent_throughput_bps",
        ])),
    };

    fn put<'a>(&'a self, _: Timestamp, row: &mut Fields<'a>, children: &mut Fields<'a>) {
        self.node.put(row);
        match &self.cpu {
            Some(CpuContext { cpus, busy }) => {
                cpus.put(row);
                busy.put(row);
            }
            None => row.nulls(2),
        }
        match &self.load_average {
            Some(load) => {
                row.0.extend([load.one_minute, load.five_minutes, load.fifteen_minutes].map(Value::Real));
            }
            None => row.nulls(3),
        }
        match &self.memory {
            Some(MemoryContext { memory_bytes, available_bytes }) => {
                memory_bytes.put(row);
                available_bytes.put(row);
            }
            None => row.nulls(2),
        }
        self.interfaces_left_out.put(row);
        self.wifi_left_out.put(row);
        row.json(Some(&self.wifi).filter(|wifi| !wifi.is_empty()));
        match &self.reading {
            Some(ReadingTime { measured, error }) => {
                measured.put(row);
                error.put(row);
            }
            None => row.nulls(2),
        }
        self.interfaces.iter().for_each(|interface| interface.put(children));
    }

    /// Reads a context, within its bounds.
    fn take<E: From<Unreadable>>(_: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
        let mut row = Reader(source);
        let node = row.take()?;
        let (cpus, busy) = (row.take::<Option<_>>()?, row.take()?);
        let averages: [Option<f64>; 3] = [row.take()?, row.take()?, row.take()?];
        let bytes: [Option<u64>; 2] = [row.take()?, row.take()?];
        let mut context = Self {
            node,
            cpu: cpus.map(|cpus| CpuContext { cpus, busy }),
            load_average: match averages {
                [Some(one_minute), Some(five_minutes), Some(fifteen_minutes)] => {
                    Some(LoadAverage { one_minute, five_minutes, fifteen_minutes })
                }
                _ => None,
            },
            memory: match bytes {
                [Some(memory_bytes), Some(available_bytes)] => {
                    Some(MemoryContext { memory_bytes, available_bytes })
                }
                _ => None,
            },
            interfaces: Vec::new(),
            interfaces_left_out: row.take()?,
            wifi_left_out: row.take()?,
            wifi: row.json()?.unwrap_or_default(),
            reading: {
                let (measured, error): (Option<_>, Option<_>) = (row.take()?, row.take()?);
                measured.zip(error).map(|(measured, error)| ReadingTime { measured, error })
            },
        };
        let interfaces = &mut context.interfaces;
        source.children(&mut |child| {
            // Checked here, too, so that what is read stays bounded.
            if interfaces.len() == Self::MOST_INTERFACES {
                return Err(unreadable("a machine has too many interfaces"));
            }
            interfaces.push(InterfaceContext::take(&mut Reader(child))?);
            Ok(())
        })?;
        context
            .is_valid()
            .then_some(context)
            .ok_or_else(|| unreadable("the context of a machine is out of its bounds"))
    }

    fn series(&self) -> Option<[SeriesPart; 2]> {
        Some([(&self.node).into(), ().into()])
    }

    fn bytes(&self) -> usize {
        let interfaces = self.interfaces.iter().map(|of| size_of_val(of) + of.name.len());
        let wifi = self.wifi.iter().map(|of| {
            let stations = of.stations.iter().map(|of| size_of_val(of) + of.mac.len());
            let texts = of.interface.len() + of.ssid.as_ref().map_or(0, String::len);
            size_of_val(of) + texts + size_of_val(&of.channels[..]) + stations.sum::<usize>()
        });
        interfaces.sum::<usize>() + wifi.sum::<usize>()
    }
}
