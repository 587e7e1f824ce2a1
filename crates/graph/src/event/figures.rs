//! Values of figures in events.

use super::Event;
use crate::{
    figure::{Figure, LatenessQuantity, LinkQuantity, MachineQuantity, RobotQuantity},
    units::millis,
};

impl Figure {
    /// Calls `each` with the figure's values in an event, NaN included.
    pub fn of(&self, event: &Event, mut each: impl FnMut(f64)) {
        match (self, event) {
            (Self::Link(link, direction, quantity), Event::Link(context))
                if context.link == *link && context.direction == *direction =>
            {
                let probed = context.probed;
                match quantity {
                    LinkQuantity::Delay => context.delay.map(millis::of).into_iter().for_each(each),
                    LinkQuantity::Throughput => each(context.throughput_bps),
                    LinkQuantity::Queue => {
                        context.queued_packets.into_iter().for_each(|packets| each(packets as f64));
                    }
                    LinkQuantity::DelayScale => each(context.scale.delay_scale),
                    LinkQuantity::DropScale => each(context.scale.drop_scale),
                    LinkQuantity::ProbedDelay => {
                        probed.and_then(|p| p.delay).map(millis::of).into_iter().for_each(each)
                    }
                    LinkQuantity::ProbedJitter => {
                        probed.and_then(|p| p.jitter).map(millis::of).into_iter().for_each(each)
                    }
                    LinkQuantity::ProbedLoss => probed.and_then(|p| p.loss).into_iter().for_each(each),
                }
            }
            (Self::Robot(robot, quantity), Event::Robot(context)) if context.robot == *robot => {
                let sensors = &context.sensors;
                match quantity {
                    RobotQuantity::X => each(sensors.pose.x),
                    RobotQuantity::Y => each(sensors.pose.y),
                    RobotQuantity::Z => each(sensors.pose.z),
                    RobotQuantity::Heading => each(sensors.pose.heading),
                    RobotQuantity::Linear => each(sensors.velocity.linear),
                    RobotQuantity::Vertical => each(sensors.velocity.vertical),
                    RobotQuantity::Angular => each(sensors.velocity.angular),
                    RobotQuantity::NearestObstacle => sensors.nearest_obstacle_m.into_iter().for_each(each),
                    RobotQuantity::LocalizationError => {
                        context.localization_error_m.into_iter().for_each(each);
                    }
                }
            }
            (Self::Signal { robot, radio_unit }, Event::Robot(context)) if context.robot == *robot => {
                let heard = context.attachments.iter();
                // A signal counts once, where it was heard.
                let heard = heard.filter(|heard| heard.radio_unit == *radio_unit && heard.is_news());
                heard.filter_map(|heard| heard.signal).for_each(|signal| each(signal.0));
            }
            (Self::Load(unit), Event::Radio(context)) if context.radio_unit == *unit => {
                context.load.into_iter().for_each(each);
            }
            (Self::ServiceTime { service, robot }, Event::ServiceTime(time))
                if service.as_ref().is_none_or(|service| time.service == *service)
                    && robot.as_ref().is_none_or(|robot| time.robot == *robot) =>
            {
                time.took.map(millis::of).into_iter().for_each(each);
            }
            (Self::TimePart { part, service, robot }, Event::ServiceTime(time))
                if service.as_ref().is_none_or(|service| time.service == *service)
                    && robot.as_ref().is_none_or(|robot| time.robot == *robot) =>
            {
                let rows = time.parts.iter().flat_map(|parts| parts.rows());
                rows.filter(|row| row.name() == part).for_each(|row| each(millis::of(row.total())));
            }
            (Self::HandoverGap { robot }, Event::Handover(handover))
                if robot.as_ref().is_none_or(|robot| handover.robot == *robot) =>
            {
                each(millis::of(handover.gap));
            }
            (Self::Sensor { robot, sensor, component }, Event::Sensor(reading))
                if reading.robot == *robot && reading.sensor == *sensor =>
            {
                reading.values.get(component).copied().into_iter().for_each(each);
            }
            (Self::Machine(node, quantity), Event::Machine(context)) if context.node == *node => {
                let busy = || context.cpu?.busy;
                match quantity {
                    MachineQuantity::Cpu => busy().into_iter().for_each(|busy| each(busy.get())),
                    MachineQuantity::LoadAverage => {
                        context.load_average.into_iter().for_each(|load| each(load.one_minute));
                    }
                    MachineQuantity::AvailableMemory => {
                        context.memory.into_iter().for_each(|memory| each(memory.available_bytes as f64));
                    }
                }
            }
            (Self::Lateness(quantity), Event::Lateness(lateness)) => each(match quantity {
                LatenessQuantity::P50 => lateness.p50_us,
                LatenessQuantity::P99 => lateness.p99_us,
                LatenessQuantity::Max => lateness.max_us,
            }),
            _ => {}
        }
    }
}
