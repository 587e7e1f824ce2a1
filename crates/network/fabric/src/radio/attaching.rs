//! Handles expired timers: a station looks at beacons, scans, changes its radio unit, or notices that it is gone.

use cotorra_graph::{Direction, Event, GapPolicy, Handover, Timestamp};

use super::{
    Path, Radio, RadioUnitIndex, RobotRadio, SEARCH_INTERVAL, StationIndex,
    roaming::{Verdict, next_beacon},
    station::{self, Joined, Purpose, Step},
    supplicant::Decision,
};

impl Radio {
    /// Does everything due by `now`, each step at its own time.
    pub(super) fn advance(&mut self, now: Timestamp) {
        loop {
            if self.tell_station() {
                continue;
            }
            let Some((at, owner)) = self.timers.next().filter(|(at, _)| *at <= now) else { return };
            self.timers.set(owner, None);
            match owner.checked_sub(self.channels) {
                None if self.contends(owner) => self.contend(owner, at),
                None => self.serve(owner, at),
                Some(further) if further >= self.robots.len() => {
                    self.contend(owner - self.robots.len(), at);
                }
                Some(robot) if self.robots[robot].station.is_busy() => self.end_phase(robot, at),
                Some(robot) if self.next_scan(robot).is_some_and(|due| due <= at) => {
                    self.scan_in_background(robot, at);
                }
                Some(robot) => self.beacon(robot, at),
            }
        }
    }

    /// Sets the timer for the next beacon of a station's radio unit or its next background scan, or for the next search if
    /// it has no radio unit.
    pub(super) fn watch(&mut self, robot: StationIndex, now: Timestamp) {
        let lost = self.robots[robot].station.attached().is_none();
        let next = if lost { now + SEARCH_INTERVAL } else { next_beacon(now) };
        let next = self.next_scan(robot).map_or(next, |scan| scan.min(next));
        self.timers.set(self.channels + robot, Some(next));
    }

    /// Returns when an attached station scans next in the background, if it does.
    pub(super) fn next_scan(&self, robot: StationIndex) -> Option<Timestamp> {
        let RobotRadio { station, policy, .. } = &self.robots[robot];
        station.attached()?;
        policy.supplicant().map_or_else(|| station.next_scan(), |supplicant| Some(supplicant.deadline()))
    }

    fn scan_in_background(&mut self, robot: StationIndex, now: Timestamp) {
        let purpose = match self.robots[robot].policy.supplicant_mut() {
            Some(supplicant) => {
                supplicant.scans(now);
                Purpose::Roam
            }
            None => Purpose::Look,
        };
        self.begin_scan(robot, now, purpose).expect("a station with a background scan due is not away");
    }

    fn beacon(&mut self, robot: StationIndex, now: Timestamp) {
        self.robots[robot].moved = false;
        let Some(unit) = self.robots[robot].station.attached() else {
            return self.begin_scan(robot, now, Purpose::Roam).expect("a station on no channel is not away");
        };
        let thresholds = self.robots[robot].policy.thresholds();
        let own = self.receive_beacon(now, robot, unit);
        if thresholds.is_some() {
            self.listen(robot, now);
        }
        let mut beacons = std::mem::take(&mut self.robots[robot].beacons);
        let others = self.joinable(robot).filter(|(other, _)| *other != unit);
        let verdict = beacons.weigh(now, own, others, thresholds);
        self.robots[robot].beacons = beacons;
        let supplicant = self.robots[robot].policy.supplicant_mut();
        let is_watchful = supplicant.is_some();
        if let (Some(supplicant), Some(own)) = (supplicant, own) {
            supplicant.beacon(now, own);
        }
        match verdict {
            // Nothing changes until it moves, or scans in the background.
            Verdict::Stay if !is_watchful => self.timers.set(self.channels + robot, self.next_scan(robot)),
            Verdict::Stay | Verdict::Watch => self.watch(robot, now),
            Verdict::Roam => {
                self.begin_scan(robot, now, Purpose::Roam).expect("a station that hears beacons is not away");
            }
            Verdict::Lost if self.answers_probe(now, robot, unit) => {
                self.robots[robot].beacons.reset();
                self.watch(robot, now);
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
        self.part(robot, now);
        self.leave_channel(robot, now);
        self.timers.set(self.channels + robot, self.robots[robot].station.deadline());
        self.drop_queued(robot);
    }

    /// Loses queued frames of a station off its channel, if the network's [`GapPolicy`] says so.
    fn drop_queued(&mut self, robot: StationIndex) {
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
        let before = self.robots[robot].station.on_channel();
        let chosen = if self.robots[robot].station.completes_scan() {
            self.listen(robot, now);
            self.choose(robot, now)
        } else {
            None
        };
        let station = &self.robots[robot].station;
        let is_one_domain = self.is_one_mobility_domain(robot, station.underway_to());
        let frames_wait = self.queued(robot)[Direction::Forward as usize] > 0;
        match self.robots[robot].station.expire(chosen, is_one_domain, frames_wait) {
            Step::Underway => {}
            Step::Send(message, unit) => self.send_message(now, robot, unit, message),
            Step::Failed => return self.fail(robot, now),
            Step::Scanned => {
                let id = self.robots[robot].id.clone();
                self.emit(now, Event::Scanned { robot: id });
                if self.robots[robot].station.is_exchanging() {
                    self.drop_queued(robot);
                }
            }
            Step::Attached(joined) => self.join(robot, now, joined),
        }
        let RobotRadio { station, moved, policy, .. } = &self.robots[robot];
        let on = station.on_channel();
        if before.is_some() && on.is_none() {
            return self.leave(robot, now);
        }
        if station.is_busy() {
            self.timers.set(self.channels + robot, station.deadline());
        } else {
            // A better radio unit may be near, or the own one lost. A standing robot without one need not search again,
            // but a supplicant never stops.
            let watches = on.is_some() || *moved || policy.supplicant().is_some();
            self.robots[robot].beacons.reset();
            if watches {
                self.watch(robot, now);
            }
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

    /// Returns the radio unit that a robot chooses after a scan.
    fn choose(&mut self, robot: StationIndex, now: Timestamp) -> Option<RadioUnitIndex> {
        let RobotRadio { station, policy, .. } = &self.robots[robot];
        let Some(own) = station.attached().filter(|_| policy.supplicant().is_some()) else {
            return self.strongest(robot);
        };
        let heard: Vec<_> = self.joinable(robot).collect();
        match self.robots[robot].policy.supplicant_mut()?.scanned(now, own, heard) {
            Decision::Stay => None,
            Decision::Roam(unit) => Some(unit),
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

    /// Ends a handover whose frames were lost again and again. The station has left its former radio unit, and looks for
    /// another.
    fn fail(&mut self, robot: StationIndex, now: Timestamp) {
        match self.robots[robot].station.attached() {
            Some(from) => self.lose_unit(robot, from, now),
            None => self.watch(robot, now),
        }
    }

    fn join(&mut self, robot: StationIndex, now: Timestamp, joined: Joined) {
        let Joined { from, to, fast, gap } = joined;
        if let Some(from) = from {
            self.units[from].stations.retain(|r| *r != robot);
        }
        self.robots[robot].elsewhere = None;
        self.associate(now, robot, to);
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
    pub(super) fn associate(&mut self, now: Timestamp, robot: StationIndex, unit: RadioUnitIndex) {
        if self.robots[robot].policy.supplicant().is_some() {
            let [_, signal] = self.signals(robot, unit);
            self.robots[robot].policy.supplicant_mut().expect("it has one").attached(now, signal);
        }
        let stations = &mut self.units[unit].stations;
        let place = stations.partition_point(|r| *r < robot);
        stations.insert(place, robot);
        self.robots[robot].home = Some(unit);
        self.link(robot, unit).begin_association();
    }
}
