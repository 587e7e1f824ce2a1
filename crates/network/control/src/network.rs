//! The seam to the emulated network, and why it rejects instructions.

use cotorra_fabric::Fabric;
use cotorra_graph::{ConditionChange, Direction, Lateness, LinkContext, LinkId, ThroughputTest, Timestamp};

/// The emulated network, wherever it runs: on another thread in real time, right here in virtual time.
pub trait Network {
    /// Does something with the fabric, at its own time, and gives what came of it.
    ///
    /// # Errors
    /// [`NetworkGone`] once it is stopped.
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone>;

    /// Changes what a link does, in one direction or both, and gives its contexts; it does so when this returns.
    ///
    /// # Errors
    /// [`InstructionError`] with the reason; then nothing changed.
    fn change(
        &self,
        link: &LinkId,
        direction: Option<Direction>,
        change: &ConditionChange,
    ) -> Result<Vec<LinkContext>, InstructionError> {
        change_fabric(self, link, direction, change)
    }

    /// Begins to test what one direction of a link carries; what came of it is in its context later.
    ///
    /// # Errors
    /// [`InstructionError`] with the reason; then no packet was sent.
    fn test_throughput(
        &self,
        link: &LinkId,
        direction: Direction,
        test: ThroughputTest,
    ) -> Result<(), InstructionError> {
        test_fabric_throughput(self, link, direction, test)
    }

    /// Completes what the fabric knows of links, where not only the fabric carries packets.
    fn complete(&self, _now: Timestamp, contexts: Vec<LinkContext>) -> Vec<LinkContext> {
        contexts
    }

    /// How late packets were, where not only the fabric carries them, which was that late.
    fn lateness(&self, fabric: Lateness) -> Lateness {
        fabric
    }
}

/// [`Network::change`] in the fabric alone.
///
/// # Errors
/// As there.
pub fn change_fabric<N: Network + ?Sized>(
    network: &N,
    link: &LinkId,
    direction: Option<Direction>,
    change: &ConditionChange,
) -> Result<Vec<LinkContext>, InstructionError> {
    let (link, change) = (link.clone(), change.clone());
    let apply = move |fabric: &mut Fabric, now| {
        fabric.change(now, &link, direction, &change).map_err(refused)?;
        Ok(fabric.link_contexts(now).into_iter().filter(|context| context.link == link).collect())
    };
    network.with(apply).map_err(refused)?
}

/// [`Network::test_throughput`] in the fabric.
///
/// # Errors
/// As there.
pub fn test_fabric_throughput<N: Network + ?Sized>(
    network: &N,
    link: &LinkId,
    direction: Direction,
    test: ThroughputTest,
) -> Result<(), InstructionError> {
    let link = link.clone();
    let begin = move |fabric: &mut Fabric, now| fabric.test_throughput(now, &link, direction, test);
    network.with(begin).map_err(refused)?.map_err(refused)
}

/// The emulated network was stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the emulated network was stopped")]
pub struct NetworkGone;

/// Why an instruction was not done; for people.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InstructionError(pub String);

pub(crate) fn refused(reason: impl ToString) -> InstructionError {
    InstructionError(reason.to_string())
}
