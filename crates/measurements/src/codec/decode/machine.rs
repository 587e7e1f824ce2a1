//! Reads contexts of machines.

use cotorra_graph::{
    BitRate, CpuContext, InterfaceContext, InterfaceTraffic, LoadAverage, MachineContext, MemoryContext,
    Probability, ReadingTime, Timestamp,
};

use super::{super::read_error::unreadable, Columns, Result, Source, json, required};

/// Reads a context, within its bounds.
pub(super) fn read(source: &mut dyn Source) -> Result<MachineContext> {
    let mut row = Columns(source);
    let node = row.name()?;
    let (cpus, busy) = (row.optional_small()?, row.optional_share()?);
    let averages = [row.0.real()?, row.0.real()?, row.0.real()?];
    let bytes = [row.0.integer()?, row.0.integer()?];
    let mut context = MachineContext {
        node,
        cpu: cpus.map(|cpus| CpuContext { cpus, busy }),
        load_average: match averages {
            [Some(one_minute), Some(five_minutes), Some(fifteen_minutes)] => {
                Some(LoadAverage { one_minute, five_minutes, fifteen_minutes })
            }
            _ => None,
        },
        memory: match bytes.map(|bytes| bytes.map(i64::cast_unsigned)) {
            [Some(memory_bytes), Some(available_bytes)] => {
                Some(MemoryContext { memory_bytes, available_bytes })
            }
            _ => None,
        },
        interfaces: Vec::new(),
        interfaces_left_out: row.small()?,
        wifi_left_out: row.small()?,
        wifi: row.0.text()?.as_deref().map(json).transpose()?.unwrap_or_default(),
        reading: row.reading()?,
    };
    let interfaces = &mut context.interfaces;
    source.children(&mut |child| {
        // Checked here, too, so that what is read stays bounded.
        if interfaces.len() == MachineContext::MOST_INTERFACES {
            return Err(unreadable("a machine has too many interfaces"));
        }
        let mut row = Columns(child);
        interfaces.push(InterfaceContext {
            name: required(row.0.name()?)?.as_ref().to_owned(),
            up: row.boolean()?,
            carrier: row.boolean()?,
            speed: row.optional_rate()?,
            mtu_bytes: row.small()?,
            received: row.traffic()?,
            sent: row.traffic()?,
        });
        Ok(())
    })?;
    context
        .is_valid()
        .then_some(context)
        .ok_or_else(|| unreadable("the context of a machine is out of its bounds"))
}

impl Columns<'_> {
    fn reading(&mut self) -> Result<Option<ReadingTime>> {
        let measured = self.0.integer()?.map(|ns| Timestamp::from_nanos(ns.cast_unsigned()));
        let reading = measured.zip(self.duration()?);
        Ok(reading.map(|(measured, error)| ReadingTime { measured, error }))
    }

    fn optional_share(&mut self) -> Result<Option<Probability>> {
        let Some(share) = self.0.real()? else { return Ok(None) };
        let found = Probability::new(share);
        found.map(Some).ok_or_else(|| unreadable(format_args!("{share} is not a share")))
    }

    fn optional_rate(&mut self) -> Result<Option<BitRate>> {
        let Some(rate) = self.0.integer()? else { return Ok(None) };
        let found = BitRate::from_bits_per_second(rate.cast_unsigned());
        found.map(Some).ok_or_else(|| unreadable(format_args!("{rate} is not a rate")))
    }

    fn traffic(&mut self) -> Result<InterfaceTraffic> {
        Ok(InterfaceTraffic {
            packets: self.unsigned()?,
            bytes: self.unsigned()?,
            errors: self.unsigned()?,
            dropped: self.unsigned()?,
            throughput_bps: self.0.real()?,
        })
    }
}
