//! Handles expired timers: a station looks at beacons, scans, changes its radio unit, or notices that it is gone.

use cotorra_graph::{Direction, Event, GapPolicy, Handover, Timestamp};

use super::{
    Path, Radio, RadioUnitIndex, SEARCH_INTERVAL, StationIndex,
    roaming::{Verdict, next_beacon},
    station::{self, Joined, Purpose, Step},
};

impl Radio {
    /// Does everything due by `now`, each step at its own time.
    pub(super) fn advance(&mut self, now: Timestamp) {
        while let Some((at, owner)) = self.timers.next().filter(|(at, _)| *at <= now) {
            self.timers.set(owner, None);
            match owner.checked_sub(self.channels) {
                None if self.contends(owner) => self.contend(owner, at),
                None => self.serve(owner, at),
                Some(robot) if self.robots[robot].station.is_away() => self.end_phase(robot, at),
                Some(robot) => self.beacon(robot, at),
            }
        }
    }

    /// Sets the timer for the next beacon of a station's radio unit, or for the next search if it has none.
    pub(super) fn watch(&mut self, robot: StationIndex, now: Timestamp) {
        let lost = self.robots[robot].station.attached().is_none();
        let next = if lost { now + SEARCH_INTERVAL } else { next_beacon(now) };
        self.timers.set(self.channels + robot, Some(next));
    }

    fn beacon(&mut self, robot: StationIndex, now: Timestamp) {
        self.robots[robot].moved = false;
        let Some(unit) = self.robots[robot].station.attached() else {
            return self.begin_scan(robot, now, Purpose::Roam).expect("a station on no channel is not away");
        };
        let thresholds = self.robots[robot].thresholds;
        let own = self.hears(robot, unit);
        if thresholds.is_some() {
            self.listen(robot);
        }
        let mut beacons = std::mem::take(&mut self.robots[robot].beacons);
        let others = self.joinable(robot).filter(|(other, _)| *other != unit);
        let verdict = beacons.weigh(now, own, others, thresholds);
        self.robots[robot].beacons = beacons;
        match verdict {
            Verdict::Stay => {}
            Verdict::Watch => self.watch(robot, now),
            Verdict::Roam => {
                self.begin_scan(robot, now, Purpose::Roam).expect("a station that hears beacons is not away");
            }
            Verdict::Lost => self.lose_unit(robot, unit, now),
        }
    }

    pub(super) fn begin_scan(
        &mut self,
        robot: StationIndex,
        now: Timestamp,
        purpose: Purpose,
    ) -> Result<(), station::Busy> {
        self.robots[robot].station.scan(now, purpose)?;
        self.leave(robot, now);
        Ok(())
    }

    /// Records that a station has left its channel. Queued frames stay or are lost, by the network's [`GapPolicy`].
    pub(super) fn leave(&mut self, robot: StationIndex, now: Timestamp) {
        self.leave_channel(robot, now);
        self.timers.set(self.channels + robot, self.robots[robot].station.deadline());
        let Some(unit) = self.robots[robot].home else { return };
        if self.gap_policy(robot) == GapPolicy::Drop {
            let [up, down] = self.take_queued(robot);
            let lost = up.into_iter().map(|waiting| (Direction::Forward, waiting));
            for (direction, waiting) in lost.chain(down.into_iter().map(|w| (Direction::Backward, w))) {
                self.lose(Path { robot, unit, direction }, waiting.frame, waiting.is_probe);
            }
        }
    }

    fn end_phase(&mut self, robot: StationIndex, now: Timestamp) {
        let strongest = if self.robots[robot].station.is_scanning() {
            self.listen(robot);
            self.strongest(robot)
        } else {
            None
        };
        let station = &self.robots[robot].station;
        let is_one_domain = self.is_one_mobility_domain(robot, station.underway_to());
        match self.robots[robot].station.expire(strongest, is_one_domain) {
            Step::Underway => {}
            Step::Scanned => {
                let robot = self.robots[robot].id.clone();
                self.emit(now, Event::Scanned { robot });
            }
            Step::Attached(joined) => self.join(robot, now, joined),
        }
        let station = &self.robots[robot].station;
        if station.is_away() {
            return self.timers.set(self.channels + robot, station.deadline());
        }
        let on = station.on_channel();
        self.robots[robot].beacons.reset();
        // A better radio unit may be near, or the own one lost. A standing robot without one need not search again.
        if on.is_some() || self.robots[robot].moved {
            self.watch(robot, now);
        }
        if let Some(unit) = on {
            if self.units[unit].serves.is_none() {
                // The vAP was removed in the meantime.
                return self.lose_unit(robot, unit, now);
            }
            self.enter_channel(robot, unit, now);
            self.serve(self.medium.channel(unit), now);
        }
    }

    /// Detaches a station on its channel from a radio unit that is gone, and starts a scan for another.
    pub(super) fn lose_unit(&mut self, robot: StationIndex, unit: RadioUnitIndex, now: Timestamp) {
        self.robots[robot].station.detach();
        self.units[unit].stations.retain(|r| *r != robot);
        let (robot_id, from) = (self.robots[robot].id.clone(), self.units[unit].id.clone());
        self.emit(now, Event::Detached { robot: robot_id, from });
        self.begin_scan(robot, now, Purpose::Roam).expect("a station that lost its unit is not away");
    }

    fn join(&mut self, robot: StationIndex, now: Timestamp, joined: Joined) {
        let Joined { from, to, fast, gap } = joined;
        if let Some(from) = from {
            self.units[from].stations.retain(|r| *r != robot);
        }
        self.robots[robot].elsewhere = None;
        self.associate(robot, to);
        let event = Event::Handover(Handover {
            robot: self.robots[robot].id.clone(),
            from: from.map(|unit| self.units[unit].id.clone()),
            to: self.units[to].id.clone(),
            fast,
            gap,
        });
        self.emit(now, event);
    }

    /// Records that a robot is attached to a radio unit.
    pub(super) fn associate(&mut self, robot: StationIndex, unit: RadioUnitIndex) {
        let stations = &mut self.units[unit].stations;
        let place = stations.partition_point(|r| *r < robot);
        stations.insert(place, robot);
        self.robots[robot].home = Some(unit);
        self.link(robot, unit).restart_rates();
    }
}
