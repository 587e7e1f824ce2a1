//! Shows packets that cross links to those who tap them.

use cotorra_graph::{Direction, LinkCounters, LinkId, Timestamp};

use super::{Fabric, edge};
use crate::{
    frame::Frame,
    radio::Arrival,
    tap::{MOST_TAPS, Passage, Tap, TapError, TapReader},
};

impl Fabric {
    /// Shows all packets of hosts that cross a link, or the links of a node, to a reader from now on. A name of both is the
    /// link's. Packets that only measure are not shown.
    ///
    /// # Errors
    /// [`TapError`].
    pub fn tap(&mut self, name: &str, reader: TapReader) -> Result<(), TapError> {
        self.taps.retain_mut(|tap| (tap.reader)(None));
        if self.taps.len() >= MOST_TAPS {
            return Err(TapError::TooMany);
        }
        let both = |link: usize| [edge(link, Direction::Forward), edge(link, Direction::Backward)];
        let air = || self.radio.ends_of(&LinkId::new(name).ok()?);
        let (edges, ends) = if let Some(&link) = self.link_by_name.get(name) {
            (both(link).to_vec(), Vec::new())
        } else if let Some(ends) = air() {
            (Vec::new(), ends.to_vec())
        } else if let Some(&vertex) = self.vertices.get(name) {
            // The ends of a link are where its two directions lead to.
            let is_here = |link: &usize| both(*link).iter().any(|edge| self.routes.end(*edge) == vertex);
            let edges = (0..self.links.len()).filter(is_here).flat_map(both).collect();
            (edges, self.port_of_vertex[vertex].into_iter().collect())
        } else {
            return Err(TapError::Unknown(name.to_owned()));
        };
        self.taps.push(Tap { edges, ends, reader });
        Ok(())
    }

    /// Shows a packet that has crossed a wired link.
    #[cold]
    pub(super) fn show_wired(&mut self, edge: usize, [entered, due]: [Timestamp; 2], frame: &Frame) {
        let LinkCounters { lost, overflowed, .. } = *self.pipes[edge].counters();
        let direction = if edge.is_multiple_of(2) { Direction::Forward } else { Direction::Backward };
        let (link, delivered) = (&self.links[edge / 2], self.now);
        let passage = Passage { link, direction, entered, due, delivered, lost, overflowed, frame };
        self.taps.retain_mut(|tap| !tap.edges.contains(&edge) || (tap.reader)(Some(&passage)));
    }

    /// Shows a packet that has crossed the air.
    #[cold]
    pub(super) fn show_air(&mut self, arrival: &Arrival) {
        let Arrival { since, due, from, at, path, ref frame, .. } = *arrival;
        let Some((link, &LinkCounters { lost, overflowed, .. })) = self.radio.counters(path) else { return };
        let (direction, delivered) = (path.direction, self.now);
        let passage = Passage { link, direction, entered: since, due, delivered, lost, overflowed, frame };
        self.taps.retain_mut(|tap| !tap.is_of_air([from, at]) || (tap.reader)(Some(&passage)));
    }
}
