//! Signals that a robot heard before: they are written once, and shared by all contexts that repeat them.

use std::{fmt::Write as _, time::Duration};

use super::{Unreadable, unreadable};
use crate::{
    context::Attachment,
    id::NodeId,
    units::{Dbm, Timestamp},
};

/// The radio units of a robot in order, each with the signal that the robot heard before, if it did, and the time. That of
/// the own radio unit changes all the time, and is in none.
#[derive(Debug, Clone, PartialEq)]
pub struct Heard(Vec<(NodeId, Option<(Dbm, i64)>)>);

impl Heard {
    /// Returns the signals that a context repeats; `None` if it repeats none.
    pub fn of(at: Timestamp, attachments: &[Attachment]) -> Option<Self> {
        let before = |attachment: &Attachment| {
            let (signal, age) = attachment.signal.zip(attachment.age).filter(|_| !attachment.attached)?;
            Some((signal, at.as_nanos().cast_signed().checked_sub(i64::try_from(age.as_nanos()).ok()?)?))
        };
        let all = attachments.iter().map(|a| (a.radio_unit.clone(), before(a))).collect();
        attachments.iter().any(|attachment| !is_written(attachment)).then_some(Self(all))
    }

    /// Adds the signals to those that a context has of its own.
    pub fn complete(self, at: Timestamp, own: Vec<Attachment>) -> Vec<Attachment> {
        let mut own = own.into_iter().peekable();
        let mut complete = |(radio_unit, heard): (NodeId, Option<(Dbm, i64)>)| {
            own.next_if(|its| its.radio_unit == radio_unit).unwrap_or_else(|| {
                let signal = heard.map(|(signal, _)| signal);
                let age = heard.map(|(_, heard)| at.as_nanos().cast_signed().saturating_sub(heard));
                let age = age.map(|age| Duration::from_nanos(age.max(0).cast_unsigned()));
                Attachment { radio_unit, attached: false, signal, age }
            })
        };
        self.0.into_iter().map(&mut complete).collect()
    }

    /// Returns the text of [`Self::parse`]: a line for each radio unit, with its signal, dBm, the time, ns, and its name.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for (radio_unit, heard) in &self.0 {
            let _ = match heard {
                Some((signal, at)) => writeln!(text, "{} {at} {radio_unit}", signal.0),
                None => writeln!(text, "- - {radio_unit}"),
            };
        }
        text
    }

    /// Reads [`Self::text`].
    ///
    /// # Errors
    /// [`Unreadable`] for any other text.
    pub fn parse<E: From<Unreadable>>(text: &str) -> Result<Self, E> {
        let line = |line: &str| {
            let (signal, rest) = line.split_once(' ')?;
            let (at, name) = rest.split_once(' ')?;
            let heard = match signal {
                "-" => None,
                signal => Some((Dbm(signal.parse().ok()?), at.parse().ok()?)),
            };
            Some((NodeId::new(name).ok()?, heard))
        };
        let read = |text: &str| line(text).ok_or_else(|| unreadable(format_args!("`{text}` is no signal")));
        text.lines().map(read).collect::<Result<_, _>>().map(Self)
    }
}

/// Whether a context has an attachment of its own: with a signal that it does not repeat.
pub(super) fn is_written(attachment: &Attachment) -> bool {
    attachment.is_news() && (attachment.attached || attachment.signal.is_some())
}
