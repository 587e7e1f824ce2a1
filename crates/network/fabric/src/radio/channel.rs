//! The two ways to share a channel: senders [take turns](super::medium), or [contend](super::edca). All networks on a channel
//! share it in the same way.

use std::collections::VecDeque;

use cotorra_graph::{Direction, Timestamp};

use super::{
    Path, Radio, RadioUnitIndex, StationIndex,
    medium::{Flow, QueueSettings, Waiting},
};

impl Radio {
    /// Whether senders contend for a channel.
    pub(super) fn contends(&self, channel: usize) -> bool {
        self.contention.contains(&channel)
    }

    /// Puts a robot on its radio unit's channel.
    pub(super) fn enter_channel(&mut self, robot: StationIndex, unit: RadioUnitIndex, now: Timestamp) {
        match &mut self.edca {
            Some(edca) if self.networks[self.robots[robot].network].contends() => {
                edca.enter(now, robot, unit)
            }
            _ => self.medium.enter(robot, unit),
        }
    }

    /// Takes a robot off its channel. Its queued frames, and those for it, stay.
    pub(super) fn leave_channel(&mut self, robot: StationIndex, now: Timestamp) {
        self.medium.leave(robot);
        let Some(edca) = &mut self.edca else { return };
        let settled = edca.leave(now, robot);
        let Some(unit) = self.robots[robot].home else { return };
        for (direction, settled) in [Direction::Forward, Direction::Backward].into_iter().zip(settled) {
            self.settle(now, Path { robot, unit, direction }, settled);
        }
    }

    /// Queues a frame for its flow, in a network. Returns the frames that the queue drops.
    pub(super) fn push(
        &mut self,
        now: Timestamp,
        network: usize,
        flow: Flow,
        waiting: Waiting,
        queue: QueueSettings,
    ) -> Vec<Waiting> {
        match &mut self.edca {
            Some(edca) if self.networks[network].contends() => edca.push(now, flow, waiting, queue),
            _ => self.medium.push(flow, waiting, queue.limit).err().into_iter().collect(),
        }
    }

    /// Takes the queued frames from and for a robot that is off its channel.
    pub(super) fn take_queued(&mut self, robot: StationIndex) -> [VecDeque<Waiting>; 2] {
        match &mut self.edca {
            Some(edca) if self.networks[self.robots[robot].network].contends() => edca.clear(robot),
            _ => self.medium.clear(robot),
        }
    }

    /// Returns the number of frames that wait from a robot, and for it.
    pub(super) fn queued(&self, robot: StationIndex) -> [u64; 2] {
        match &self.edca {
            Some(edca) if self.networks[self.robots[robot].network].contends() => edca.queued(robot),
            _ => self.medium.queued(robot),
        }
    }

    /// Returns the share of the last second in which a channel was busy.
    pub(super) fn load(&self, channel: usize, now: Timestamp) -> f64 {
        match &self.edca {
            Some(edca) if self.contends(channel) => edca.load(channel, now),
            _ => self.medium.load(channel, now),
        }
    }
}
