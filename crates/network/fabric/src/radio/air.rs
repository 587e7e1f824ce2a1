//! Carries frames over the air: queues them, sends them in turns, and puts received ones in flight.

use std::{cmp::Reverse, time::Duration};

use cotorra_graph::{Direction, GapPolicy, LostCause, Timestamp};

use super::{
    InFlight, Path, Radio, RadioUnitIndex, StationIndex, link,
    medium::{Flow, Waiting},
    phy::{Exchange, Phy, Reception},
};
use crate::frame::Frame;

impl Radio {
    /// Queues a frame for the air. `path.unit` is the robot's present or last radio unit.
    pub(super) fn enqueue(&mut self, now: Timestamp, path: Path, frame: Frame, is_probe: bool) {
        let on = self.robots[path.robot].station.on_channel();
        if on.is_none() && self.gap_policy(path.robot) == GapPolicy::Drop {
            return self.lose(path, frame, is_probe);
        }
        let queue = self.lane(path).queue();
        let flow = match path.direction {
            Direction::Forward => Flow::Up(path.robot),
            Direction::Backward => Flow::Down(path.robot),
        };
        let waiting = Waiting { frame, since: now, source: None, is_probe };
        let network = self.robots[path.robot].network;
        let dropped = self.push(now, network, flow, waiting, queue);
        self.overflow(path, dropped);
        if let Some(unit) = on {
            self.agree(now, path);
            self.serve(self.medium.channel(unit), now);
        }
        // A frame that went on the air at once did not wait.
        let waiting = self.queued(path.robot)[path.direction as usize];
        if waiting > 0 {
            self.lane(path).meter().queued(now, waiting);
        }
    }

    /// Loses frames that a queue dropped.
    pub(super) fn overflow(&mut self, path: Path, dropped: Vec<Waiting>) {
        for Waiting { mut frame, is_probe, .. } in dropped {
            frame.end(Some(path.into()), LostCause::FullQueue);
            self.lane(path).meter().counters.overflowed += u64::from(!is_probe);
            self.lost.push(frame);
        }
    }

    /// Loses a frame of a robot that is off its channel.
    pub(super) fn lose(&mut self, path: Path, mut frame: Frame, is_probe: bool) {
        frame.end(Some(path.into()), LostCause::NoAttachment);
        self.lane(path).meter().counters.lost += u64::from(!is_probe);
        self.lost.push(frame);
    }

    /// Puts the next frame on the air, if the channel is idle and a frame waits. With contention, that waits for the backoff.
    pub(super) fn serve(&mut self, channel: usize, now: Timestamp) {
        if self.contends(channel) {
            let wakes = self.edca().wakes(channel);
            return self.timers.set(self.timer_of(channel), wakes);
        }
        if let Some((flow, waiting)) = self.medium.next(channel, now) {
            let idle = self.medium.idle_for(channel, now);
            let waited = waiting.since < now;
            let contended = |phy: &Phy| waited || idle < phy.difs();
            let airtime = match flow {
                Flow::Up(robot) => self.send(now, robot, Direction::Forward, waiting, contended),
                Flow::Down(robot) => self.send(now, robot, Direction::Backward, waiting, contended),
                Flow::Group(unit) => self.send_group(now, unit, waiting, contended),
            };
            self.medium.occupy(channel, now, airtime);
        }
        self.timers.set(channel, self.medium.wakes(channel));
    }

    fn send(
        &mut self,
        now: Timestamp,
        robot: StationIndex,
        direction: Direction,
        waiting: Waiting,
        contended: impl Fn(&Phy) -> bool,
    ) -> Duration {
        let unit = self.robots[robot].station.on_channel().expect("each sender in turns is on the channel");
        let contended = contended(self.networks[self.units[unit].network].phy);
        let path = Path { robot, unit, direction };
        if waiting.since < now {
            let waited = self.medium.queued(robot)[direction as usize] + 1;
            self.lane(path).meter().queued(now, waited);
        }
        let reception = self.reception(now, path);
        let exchange = self.lane(path).exchange(&reception, waiting.frame.bytes().len(), contended);
        self.fly(now, path, waiting, &exchange);
        let turn = exchange.first + exchange.retries;
        self.count_turn(path, turn);
        turn
    }

    fn send_group(
        &mut self,
        now: Timestamp,
        unit: RadioUnitIndex,
        waiting: Waiting,
        contended: impl Fn(&Phy) -> bool,
    ) -> Duration {
        let phy = self.networks[self.units[unit].network].phy;
        let Waiting { frame, since, source, is_probe } = waiting;
        let bytes = frame.bytes().len();
        let paths: Vec<_> = self.group(unit, source).collect();
        let least = paths.iter().map(|path| self.lane(*path).least_airtime(bytes)).max();
        let backoff = self.units[unit].rng.unit();
        let first = phy.group_airtime(bytes, contended(phy), backoff).max(least.unwrap_or_default());
        for path in paths {
            let present = self.robots[path.robot].station.on_channel() == Some(unit);
            let reception = self.reception(now, path);
            let received = present && self.lane(path).receives(reception.group_error_rate(bytes));
            let copy = Waiting { frame: frame.clone(), since, source, is_probe };
            self.fly(now, path, copy, &Exchange { first, retries: Duration::ZERO, received });
        }
        self.lost.push(frame);
        self.count_group(unit, first);
        first
    }

    /// Returns the reception on a path at the robot's present place.
    pub(super) fn reception(&mut self, now: Timestamp, path: Path) -> Reception {
        let place = self.robots[path.robot].position;
        let link = self.link(path.robot, path.unit);
        let moment = link.moment(now, place);
        if let Some(reception) = link.reception(path.direction, moment) {
            return reception;
        }
        let fading_db = self.fading_db(path, moment);
        let receptions = self.receptions(path.robot, path.unit, fading_db);
        self.link(path.robot, path.unit).set_receptions(moment, receptions);
        receptions[path.direction as usize]
    }

    /// Puts a frame on the air at `now`, and in flight if the receiver gets it.
    pub(super) fn fly(&mut self, now: Timestamp, path: Path, waiting: Waiting, exchange: &Exchange) {
        let Waiting { mut frame, since, is_probe, .. } = waiting;
        let Some(landing) = self.lane(path).land(now, exchange, &mut frame, !is_probe) else {
            frame.end(Some(path.into()), LostCause::Loss);
            return self.lost.push(frame);
        };
        if landing.corrupted {
            frame.end(Some(path.into()), LostCause::Corruption);
        }
        let copy = landing.twice.then(|| frame.clone());
        for frame in [Some(frame), copy].into_iter().flatten() {
            let link::Landing { due, flight, .. } = landing;
            self.sent += 1;
            let order = self.sent;
            self.in_flight.push(Reverse(InFlight { due, order, path, since, flight, frame, is_probe }));
        }
    }
}
