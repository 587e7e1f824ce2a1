//! Records of the graph's embedding: of robots, radio units, links, VNFs, virtual links and sensors.

use super::{
    Columns, Fields, Heard, Reader, Record, Role, SeriesPart, Source, Table, Unreadable, Value, children,
    columns, heard::is_written, unreadable,
};
use crate::{
    active::{Probed, Tested},
    context::{
        LinkContext, Placement, Pose, RadioContext, RobotContext, RobotFault, SensorData, StationContext,
        StationCounts, Velocity, VirtualLinkMapping,
    },
    id::{ComponentId, NodeId},
    nodes::Nodes,
    sensor::{LargeData, SensorReading},
    units::Timestamp,
};

#[rustfmt::skip]
const ROBOT: &[&str] = &[
    "robot", "waypoint",
    "x", "y", "heading",
    "cov_xx", "cov_xy", "cov_xh", "cov_yx", "cov_yy", "cov_yh", "cov_hx", "cov_hy", "cov_hh",
    "source",
    "odometry_x", "odometry_y", "odometry_heading",
    "odometry_cov_xx", "odometry_cov_xy", "odometry_cov_xh", "odometry_cov_yx", "odometry_cov_yy", "odometry_cov_yh",
    "odometry_cov_hx", "odometry_cov_hy", "odometry_cov_hh",
    "odometry_source",
    "linear", "angular", "bumper", "nearest_obstacle_m", "health",
    "z", "roll", "pitch", "odometry_z", "odometry_roll", "odometry_pitch", "vertical",
    "speed_limit_mps", "localization_error_m", "heard",
];

impl Record for RobotContext {
    const TABLE: Table = Table {
        columns: ROBOT,
        series: &["robot"],
        children: Some(("attachment", &["radio_unit", "attached", "signal_dbm", "signal_age_ms"])),
    };

    fn put<'a>(&'a self, at: Timestamp, row: &mut Fields<'a>, children: &mut Fields<'a>) {
        let SensorData { pose, odometry, velocity, bumper, nearest_obstacle_m } = &self.sensors;
        self.robot.put(row);
        self.waypoint.put(row);
        put_plane(pose, row);
        put_plane(odometry, row);
        velocity.linear.put(row);
        velocity.angular.put(row);
        bumper.put(row);
        nearest_obstacle_m.put(row);
        row.0.push(faults(&self.health).map_or(Value::Null, |faults| Value::Text(faults.into())));
        for pose in [pose, odometry] {
            row.0.extend([pose.z, pose.roll, pose.pitch].map(Value::Real));
        }
        velocity.vertical.put(row);
        self.speed_limit_mps.put(row);
        self.localization_error_m.put(row);
        row.0.push(Heard::of(at, &self.attachments).map_or(Value::Null, Value::Heard));
        for attachment in self.attachments.iter().filter(|attachment| is_written(attachment)) {
            attachment.put(children);
        }
    }

    fn take<E: From<Unreadable>>(at: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
        let mut row = Reader(source);
        let (robot, waypoint) = (row.take()?, row.take()?);
        let (mut pose, mut odometry) = (take_plane(&mut row)?, take_plane(&mut row)?);
        let mut velocity = Velocity::planar(row.take()?, row.take()?);
        let (bumper, nearest_obstacle_m) = (row.take()?, row.take()?);
        let health = take_faults(&mut row)?;
        for pose in [&mut pose, &mut odometry] {
            (pose.z, pose.roll, pose.pitch) = (row.take()?, row.take()?, row.take()?);
        }
        velocity.vertical = row.take()?;
        let (speed_limit_mps, localization_error_m) = (row.take()?, row.take()?);
        let heard = row.0.heard()?;
        let own = children(source)?;
        let attachments = match heard {
            Some(heard) => heard.complete(at, own),
            None => own,
        };
        let sensors = SensorData { pose, odometry, velocity, bumper, nearest_obstacle_m };
        Ok(Self { robot, attachments, sensors, waypoint, health, speed_limit_mps, localization_error_m })
    }

    fn series(&self) -> Option<[SeriesPart; 2]> {
        Some([(&self.robot).into(), ().into()])
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.attachments[..]) + size_of_val(&self.health[..])
    }
}

/// Adds the part of a pose in the plane.
fn put_plane<'a>(pose: &'a Pose, row: &mut Fields<'a>) {
    row.0.extend([pose.x, pose.y, pose.heading].map(Value::Real));
    row.0.extend(pose.covariance.map(Value::Real));
    pose.source.put(row);
}

fn take_plane<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Pose, E> {
    let (x, y, heading) = (row.take()?, row.take()?, row.take()?);
    let mut covariance = [0.0; 9];
    for c in &mut covariance {
        *c = row.take()?;
    }
    Ok(Pose::planar(x, y, heading, covariance, row.take()?))
}

/// Returns faults as words with spaces between; `None` without any.
fn faults(health: &[RobotFault]) -> Option<String> {
    let words: Vec<_> = health.iter().map(|fault| fault.as_str()).collect();
    (!words.is_empty()).then(|| words.join(" "))
}

fn take_faults<E: From<Unreadable>>(row: &mut Reader<'_, E>) -> Result<Vec<RobotFault>, E> {
    let text = row.take::<Option<String>>()?.unwrap_or_default();
    let fault = |word| RobotFault::ALL.into_iter().find(|fault| fault.as_str() == word);
    text.split_whitespace()
        .map(|word| fault(word).ok_or_else(|| unreadable(format_args!("`{word}` is not a fault of a robot"))))
        .collect()
}

columns! {
    StationContext { robot, signal, downlink_bps, uplink_bps, counted }
    StationCounts { retransmissions, transmissions_failed, transmit_airtime, receive_airtime }
}

impl Record for RadioContext {
    const TABLE: Table = Table {
        columns: &["radio_unit", "channel", "load"],
        series: &["radio_unit"],
        children: Some((
            "station",
            &[
                "robot",
                "signal_dbm",
                "downlink_bps",
                "uplink_bps",
                "retransmissions",
                "transmissions_failed",
                "transmit_airtime_ms",
                "receive_airtime_ms",
            ],
        )),
    };

    fn put<'a>(&'a self, _: Timestamp, row: &mut Fields<'a>, children: &mut Fields<'a>) {
        self.radio_unit.put(row);
        self.channel.put(row);
        self.load.put(row);
        self.stations.iter().for_each(|station| station.put(children));
    }

    fn take<E: From<Unreadable>>(_: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
        let mut row = Reader(source);
        let (radio_unit, channel, load) = (row.take()?, row.take()?, row.take()?);
        Ok(Self { radio_unit, channel, load, stations: children(source)? })
    }

    fn series(&self) -> Option<[SeriesPart; 2]> {
        Some([(&self.radio_unit).into(), ().into()])
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.stations[..])
    }
}

#[rustfmt::skip]
const LINK: &[&str] = &[
    "link", "direction", "delay_ms", "throughput_bps", "delay_scale", "drop_scale",
    "asked", "effective",
    "packets", "bytes", "lost", "overflowed", "duplicated", "corrupted",
    "probed_delay_ms", "probed_jitter_ms", "probed_delay_age_ms", "probed_loss", "probed_loss_age_ms",
    "tested_throughput_bps", "tested_offered_bps", "tested_age_ms",
    "queued_packets",
];

impl Record for LinkContext {
    const TABLE: Table = Table { columns: LINK, series: &["link", "direction"], children: None };

    fn put<'a>(&'a self, _: Timestamp, row: &mut Fields<'a>, _: &mut Fields<'a>) {
        self.link.put(row);
        self.direction.put(row);
        self.delay.put(row);
        self.throughput_bps.put(row);
        self.scale.put(row);
        row.0.push(Value::Conditions(Role::Asked, &self.asked));
        row.0.push(Value::Conditions(Role::Effective, &self.effective));
        self.counters.put(row);
        match &self.probed {
            Some(Probed { delay, jitter, delay_age, loss, loss_age }) => {
                [delay, jitter, delay_age].into_iter().for_each(|duration| duration.put(row));
                loss.put(row);
                loss_age.put(row);
            }
            None => row.nulls(5),
        }
        match &self.tested {
            Some(Tested { throughput_bps, offered_bps, age }) => {
                throughput_bps.put(row);
                offered_bps.put(row);
                age.put(row);
            }
            None => row.nulls(3),
        }
        self.queued_packets.put(row);
    }

    fn take<E: From<Unreadable>>(_: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
        let mut row = Reader(source);
        Ok(Self {
            link: row.take()?,
            direction: row.take()?,
            delay: row.take()?,
            throughput_bps: row.take()?,
            scale: row.take()?,
            asked: row.0.conditions()?,
            effective: row.0.conditions()?,
            counters: row.take()?,
            probed: {
                let (delay, jitter, delay_age, loss) = (row.take()?, row.take()?, row.take()?, row.take()?);
                // Every probe with a result has the age of the loss.
                let probed = |loss_age| Probed { delay, jitter, delay_age, loss, loss_age };
                row.take::<Option<_>>()?.map(probed)
            },
            tested: {
                let (throughput_bps, offered_bps) = (row.take()?, row.take()?);
                row.take::<Option<_>>()?.map(|age| Tested { throughput_bps, offered_bps, age })
            },
            queued_packets: row.take()?,
        })
    }

    fn series(&self) -> Option<[SeriesPart; 2]> {
        Some([(&self.link).into(), self.direction.into()])
    }
}

impl Record for Placement {
    const TABLE: Table =
        Table { columns: &["vnf", "node"], series: &["vnf"], children: Some(("replica_node", &["node"])) };

    fn put<'a>(&'a self, _: Timestamp, row: &mut Fields<'a>, children: &mut Fields<'a>) {
        self.vnf.put(row);
        self.node.first().put(row);
        self.node.all()[1..].iter().for_each(|node| node.put(children));
    }

    fn take<E: From<Unreadable>>(_: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
        let mut row = Reader(source);
        let vnf = row.take()?;
        let mut nodes: Vec<NodeId> = vec![row.take()?];
        nodes.extend(children::<NodeId, E>(source)?);
        Ok(Self { vnf, node: Nodes::new(nodes).map_err(unreadable)? })
    }

    fn series(&self) -> Option<[SeriesPart; 2]> {
        Some([(&self.vnf).into(), ().into()])
    }

    fn bytes(&self) -> usize {
        size_of_val(self.node.all())
    }
}

impl Record for VirtualLinkMapping {
    const TABLE: Table = Table {
        columns: &["from_vnf", "to_vnf", "path", "others"],
        series: &["from_vnf", "to_vnf"],
        children: Some(("hop", &["link"])),
    };

    fn put<'a>(&'a self, _: Timestamp, row: &mut Fields<'a>, children: &mut Fields<'a>) {
        self.from.put(row);
        self.to.put(row);
        self.path.put(row);
        row.json(Some(&self.others).filter(|others| !others.is_empty()));
        self.links.iter().for_each(|link| link.put(children));
    }

    fn take<E: From<Unreadable>>(_: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
        let mut row = Reader(source);
        let (from, to) = (row.take()?, row.take()?);
        let path = row.take::<Option<_>>()?.unwrap_or_default();
        let others = row.json()?.unwrap_or_default();
        Ok(Self { from, to, links: children(source)?, path, others })
    }

    fn series(&self) -> Option<[SeriesPart; 2]> {
        Some([(&self.from).into(), (&self.to).into()])
    }

    fn bytes(&self) -> usize {
        let others = self.others.iter().map(|other| size_of_val(&other.links[..]));
        size_of_val(&self.links[..]) + size_of_val(&self.others[..]) + others.sum::<usize>()
    }
}

columns! {
    LargeData { sequence, format, width, height, bytes }
}

impl Record for SensorReading {
    const TABLE: Table = Table {
        columns: &["robot", "sensor", "measured_ns", "sequence", "format", "width", "height", "bytes"],
        series: &["robot", "sensor"],
        children: Some(("sensor_value", &["component", "value"])),
    };

    fn put<'a>(&'a self, _: Timestamp, row: &mut Fields<'a>, children: &mut Fields<'a>) {
        self.robot.put(row);
        self.sensor.put(row);
        self.measured.put(row);
        match &self.data {
            Some(data) => data.put(row),
            None => row.nulls(5),
        }
        for (component, value) in &self.values {
            component.put(children);
            value.put(children);
        }
    }

    fn take<E: From<Unreadable>>(_: Timestamp, source: &mut dyn Source<E>) -> Result<Self, E> {
        let mut row = Reader(source);
        let (robot, sensor, measured) = (row.take()?, row.take()?, row.take()?);
        let data = match row.take()? {
            Some(sequence) => Some(LargeData {
                sequence,
                format: row.take()?,
                width: row.take()?,
                height: row.take()?,
                bytes: row.take()?,
            }),
            // Readings without large data have no such columns.
            None => {
                row.0.text()?;
                for _ in 0..3 {
                    row.0.integer()?;
                }
                None
            }
        };
        let mut values = std::collections::BTreeMap::new();
        source.children(&mut |child| {
            let mut row = Reader(child);
            values.insert(row.take::<ComponentId>()?, row.take()?);
            Ok(())
        })?;
        Ok(Self { robot, sensor, measured, values, data })
    }

    fn series(&self) -> Option<[SeriesPart; 2]> {
        Some([(&self.robot).into(), (&self.sensor).into()])
    }

    fn bytes(&self) -> usize {
        self.values.len() * size_of::<(ComponentId, f64)>()
    }
}
