//! Places of links in the real network: which packets of which interface cross them.

use cotorra_graph::{Conditions, Direction, IpNetwork, LinkId, Medium, Reached, RealLink};
use cotorra_netem::{ConditionsError, Rule, Side};

/// A condition of a link that NetEm cannot emulate. Nothing has changed then.
#[derive(Debug, thiserror::Error)]
#[error("link `{link}`: {reason}")]
pub struct NotForNetem {
    link: LinkId,
    /// The condition.
    reason: ConditionsError,
}

/// The place of a link in the real network.
#[derive(Debug, Clone)]
pub(crate) struct Place {
    pub(crate) reached: Reached,
    leaving: Direction,
    pub(crate) medium: Medium,
}

impl Place {
    pub(crate) fn of(real: RealLink<'_>) -> Self {
        Self { reached: real.reached.clone(), leaving: real.leaving, medium: real.link.medium() }
    }

    /// Returns 0 for the direction that leaves by the interface, and 1 for the way back.
    pub(crate) fn way(&self, direction: Direction) -> usize {
        usize::from(direction != self.leaving)
    }

    /// Reorders values of the forward and the backward direction into there and back.
    pub(crate) fn there_and_back<T>(&self, mut directions: [T; 2]) -> [T; 2] {
        directions.rotate_left(self.way(Direction::Forward));
        directions
    }

    /// Returns what NetEm adds to what the medium itself does.
    pub(crate) fn added(&self, conditions: &Conditions) -> Conditions {
        Conditions { delay: self.medium.added_delay(conditions.delay), ..conditions.clone() }
    }

    /// Returns the packets of the interface that cross the link in a direction.
    pub(crate) fn packets(&self, direction: Direction) -> (Side, Option<IpNetwork>) {
        let side = if direction == self.leaving { Side::Egress } else { Side::Ingress };
        (side, self.reached.address)
    }

    /// Returns NetEm's rule for one direction of the link under these conditions.
    ///
    /// # Errors
    /// [`NotForNetem`].
    pub(crate) fn rule(
        &self,
        link: &LinkId,
        direction: Direction,
        conditions: &Conditions,
    ) -> Result<Rule, NotForNetem> {
        let (side, _) = self.packets(direction);
        Rule::new(side, self.reached.address, &self.added(conditions))
            .map_err(|reason| NotForNetem { link: link.clone(), reason })
    }
}
