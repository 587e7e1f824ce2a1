//! Decisions of plug-ins.

use std::{borrow::Cow, sync::Arc};

use serde::{Deserialize, Serialize};

use crate::{
    id::PluginId,
    instruction::Instruction,
    record::{
        Columns, Fields, Reader, Record, Source, Table, Unreadable, Value, code, required, slots::Slots,
    },
    units::Timestamp,
};

/// An instruction of a plug-in, its reason and its outcome.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Decision {
    /// The plug-in.
    pub plugin: PluginId,
    /// The instruction.
    pub instruction: Instruction,
    /// The plug-in's reason.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Reason for its rejection; `None` if it was applied.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

impl Record for Decision {
    const TABLE: Table = Table::plain(&[
        "plugin",
        "instruction",
        "subject",
        "object",
        "linear",
        "angular",
        "waypoint",
        "direction",
        "change",
        "reason",
        "refused",
        "vertical",
    ]);

    fn put<'a>(&'a self, _: Timestamp, row: &mut Fields<'a>, _: &mut Fields<'a>) {
        let mut slots = Slots::default();
        self.instruction.put(&mut slots);
        let Slots { subject, object, linear, angular, vertical, waypoint, direction, change } = slots;
        let real = |value: Option<f64>| value.map_or(Value::Null, Value::Real);
        self.plugin.put(row);
        row.0.extend([
            Value::Text(self.instruction.name().into()),
            Value::Name(subject),
            object.map_or(Value::Null, Value::Name),
            real(linear),
            real(angular),
            waypoint.map_or(Value::Null, |waypoint| Value::Integer(waypoint.into())),
            direction.map_or(Value::Null, |direction| Value::Integer(code(direction))),
            change.map_or(Value::Null, Value::Text),
        ]);
        self.reason.put(row);
        self.refused.put(row);
        row.0.push(real(vertical));
    }

    fn take<E: From<Unreadable>>(_: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
        let mut row = Reader(source);
        let plugin = row.take()?;
        let instruction: String = row.take()?;
        let subject: Arc<str> = required(row.0.name()?)?;
        let object = row.0.name()?;
        let (linear, angular) = (row.take()?, row.take()?);
        let waypoint = row.0.integer()?.and_then(|n| u32::try_from(n).ok());
        let direction = row.take()?;
        let change = row.0.text()?.map(Cow::Owned);
        let (reason, refused, vertical) = (row.take()?, row.take()?, row.take()?);
        let (subject, object) = (&*subject, object.as_deref());
        let slots = Slots { subject, object, linear, angular, vertical, waypoint, direction, change };
        let instruction = Instruction::take(&instruction, &slots)?;
        Ok(Self { plugin, instruction, reason, refused })
    }

    fn bytes(&self) -> usize {
        let Self { plugin, instruction, reason, refused } = self;
        // An instruction beyond a bound was never applied, and is counted as the most.
        let instruction = instruction.measure().unwrap_or(Instruction::LONGEST);
        let texts = [reason, refused].into_iter().flatten().map(String::len).sum::<usize>();
        plugin.as_str().len() + instruction + texts
    }
}
