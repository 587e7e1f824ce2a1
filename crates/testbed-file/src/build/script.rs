//! Scripted conditions of links: each entry of a schedule, and the run whose conditions are replayed.

use cotorra_graph::{BitRate, ConditionChange, Direction, Link, LinkId, Rate, Scheduled, Script, When};

use super::builder::Builder;
use crate::{
    records::{ConditionsRecord, NodeRecord, ScheduledRecord, WhenRecord},
    yaml::decode::{Either, Spanned},
};

/// The whole script; `None` when it cannot be, which the sink then knows.
pub(super) fn script(builder: &mut Builder<'_>, links: Option<&[Link]>) -> Option<Script> {
    let record = builder.record;
    let replay = record.conditions.replay.as_ref();
    let replay = replay.map(|path| (path, builder.base_dir.join(&path.value)));
    if let Some((path, _)) = replay.as_ref().filter(|(_, folder)| !folder.is_dir()) {
        builder.sink.error(&path.span, format!("there is no folder `{}`", path.value)).help(
            "name the folder of a run, such as `runs/…`, or that of an export (`cotorra history export`)",
        );
    }
    // All are read before any that failed ends it, so that each one's mistakes show.
    let schedule: Vec<_> = record.schedule.iter().map(|entry| scheduled(builder, entry, links)).collect();
    Some(Script {
        replay: replay.map(|(_, folder)| folder),
        schedule: schedule.into_iter().collect::<Option<_>>()?,
    })
}

fn scheduled(
    builder: &mut Builder<'_>,
    record: &ScheduledRecord,
    links: Option<&[Link]>,
) -> Option<Scheduled> {
    let when = match (&record.at, &record.when) {
        (Some(at), None) => Some(When::At(at.value)),
        (None, Some(when)) => enters(builder, &when.value),
        (Some(_), Some(when)) => {
            builder
                .sink
                .error(&when.span, "both a time and a place")
                .help("keep one of `at` and `when`: two entries can do the same");
            None
        }
        (None, None) => {
            builder.sink.error(&record.set.span, "nothing says when this happens").help(
                "add `at: 30 s`, or `when: { robot: NAME, within: [[x, y], …] }` for where a robot is to be",
            );
            None
        }
    };
    let named = match &record.links.value {
        Either::Short(one) => std::slice::from_ref(one),
        Either::Long(several) => several,
    };
    if named.is_empty() {
        builder.sink.error(&record.links.span, "no link").help("name one or more, as `links: [a-b, c-d]`");
    }
    let mut named_well = true;
    for link in named {
        named_well &= is_there(builder, link, links);
    }
    // A condition that may not be faster than an unknown medium is reported with the links' mistakes.
    let wired = links.unwrap_or_default().iter().filter(|link| named.iter().any(|n| n.value == link.id));
    let medium = wired.clone().map(|link| link.medium).min();
    let set = change(builder, &record.set, medium.unwrap_or(UNBOUNDED));
    if let Some(set) = &set {
        wired.for_each(|link| warn_of_mean(builder, record, link, set));
    }
    named_well.then_some(())?;
    Some(Scheduled {
        when: when?,
        links: named.iter().map(|link| link.value.clone()).collect(),
        direction: record.direction,
        set: set?,
    })
}

/// Warns of a jitter that raises the mean of a delay, in each direction that changes. What is left out counts as at the start.
fn warn_of_mean(builder: &mut Builder<'_>, record: &ScheduledRecord, link: &Link, set: &ConditionChange) {
    if set.delay_ms.is_none() && set.jitter.is_none() {
        return;
    }
    let place = record.set.value.jitter.as_ref().map_or(&record.set.span, |jitter| &jitter.span);
    for (direction, conditions) in
        [(Direction::Forward, &link.forward), (Direction::Backward, &link.backward)]
    {
        let delay = record.set.value.delay.unwrap_or(conditions.delay);
        if let Some(jitter) = set.jitter.or(conditions.jitter)
            && record.direction.is_none_or(|only| only == direction)
        {
            builder.warn_of_mean(place, jitter, delay);
        }
    }
}

/// Stands in for the medium of a wireless link. The run checks such entries against the network's own rate.
const UNBOUNDED: BitRate = BitRate::from_bits_per_second(u64::MAX).expect("it is above zero");

fn enters(builder: &mut Builder<'_>, record: &WhenRecord) -> Option<When> {
    let robot = builder.robot(&record.robot);
    let area = &record.within;
    if area.value.len() < 3 {
        builder
            .sink
            .error(&area.span, format!("an area of {} corners", area.value.len()))
            .help("write three or more, such as `[[0, 0], [5, 0], [5, 4], [0, 4]]`");
        return None;
    }
    Some(When::Enters { robot: robot?, area: area.value.clone() })
}

/// Whether there is such a link, wired or wireless; else that is reported.
fn is_there(builder: &mut Builder<'_>, link: &Spanned<LinkId>, links: Option<&[Link]>) -> bool {
    let name = link.value.as_str();
    let is_robot = |name: &str| matches!(builder.nodes.get(name), Some(NodeRecord::Robot(_)));
    let is_unit = |name: &str| matches!(builder.nodes.get(name), Some(NodeRecord::RadioUnit(_)));
    let wireless = name.match_indices('~').any(|(at, _)| is_robot(&name[..at]) && is_unit(&name[at + 1..]));
    let Some(links) = links else { return true };
    if wireless || links.iter().any(|l| l.id == link.value) {
        return true;
    }
    builder.sink.unknown_name(&link.span, "link", name, links.iter().map(|link| link.id.as_str()));
    false
}

fn change(
    builder: &mut Builder<'_>,
    set: &Spanned<ConditionsRecord>,
    medium: BitRate,
) -> Option<ConditionChange> {
    let record = &set.value;
    if let Some(drop) = record.drop_scale.as_ref().filter(|drop| drop.value.0 == 0.0) {
        builder
            .sink
            .error(&drop.span, "a throughput cannot be divided by 0")
            .help("write a number above 0; 1 leaves the link as it is");
    }
    let rate: Option<Option<Rate>> = match (&record.rate, &record.trace) {
        (None, None) => Some(None),
        _ => builder.rate(record, medium).map(Some),
    };
    let loss = match &record.loss {
        None => Some(None),
        Some(loss) => builder.loss(loss).map(Some),
    };
    let (queue, queue_discipline) = builder.queue(record.queue.as_ref())?;
    let change = ConditionChange {
        delay_ms: record.delay.map(|delay| delay.as_secs_f64() * 1e3),
        jitter: record.jitter.as_ref().map(|jitter| builder.jitter(&jitter.value)),
        loss: loss?,
        duplication: record.duplication,
        corruption: record.corruption,
        reordering: record.reordering.as_ref().map(|share| share.value),
        rate: rate?,
        queue,
        queue_discipline,
        delay_scale: record.delay_scale.map(|scale| scale.0),
        drop_scale: record.drop_scale.as_ref().map(|scale| scale.value.0),
    };
    if change == ConditionChange::default() {
        builder
            .sink
            .error(&set.span, "this changes nothing")
            .help("say what the links do from then on, such as `set: { delay: 40 ms }`");
    }
    Some(change)
}
