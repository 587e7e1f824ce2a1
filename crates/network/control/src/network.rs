//! The interface to the emulated network, and its errors.

use cotorra_fabric::Fabric;
use cotorra_graph::{ConditionChange, Direction, Lateness, LinkContext, LinkId, ThroughputTest, Timestamp};

/// The emulated network: on another thread in real time, in the same one in virtual time.
pub trait Network {
    /// Runs an action on the fabric, at the fabric's time, and returns the result.
    ///
    /// # Errors
    /// [`NetworkGone`] once the network is stopped.
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone>;

    /// Changes the conditions of a link, in one direction or both, and returns its contexts. The change is in effect when
    /// this returns.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    fn change(
        &self,
        link: &LinkId,
        direction: Option<Direction>,
        change: &ConditionChange,
    ) -> Result<Vec<LinkContext>, InstructionError> {
        change_fabric(self, link, direction, change)
    }

    /// Starts a throughput test of one direction of a link. Its context has the result later.
    ///
    /// # Errors
    /// [`InstructionError`]. No packet was sent then.
    fn test_throughput(
        &self,
        link: &LinkId,
        direction: Direction,
        test: ThroughputTest,
    ) -> Result<(), InstructionError> {
        test_fabric_throughput(self, link, direction, test)
    }

    /// Completes the fabric's contexts of links, if other networks carry packets, too.
    fn complete(&self, _now: Timestamp, contexts: Vec<LinkContext>) -> Vec<LinkContext> {
        contexts
    }

    /// Completes the fabric's lateness, if other networks carry packets, too.
    fn lateness(&self, fabric: Lateness) -> Lateness {
        fabric
    }
}

/// [`Network::change`] in the fabric alone.
///
/// # Errors
/// Those of [`Network::change`].
pub fn change_fabric<N: Network + ?Sized>(
    network: &N,
    link: &LinkId,
    direction: Option<Direction>,
    change: &ConditionChange,
) -> Result<Vec<LinkContext>, InstructionError> {
    let (link, change) = (link.clone(), change.clone());
    let apply = move |fabric: &mut Fabric, now| {
        fabric.change(now, &link, direction, &change).map_err(rejected)?;
        Ok(fabric.link_contexts(now).into_iter().filter(|context| context.link == link).collect())
    };
    network.with(apply).map_err(rejected)?
}

/// [`Network::test_throughput`] in the fabric alone.
///
/// # Errors
/// Those of [`Network::test_throughput`].
pub fn test_fabric_throughput<N: Network + ?Sized>(
    network: &N,
    link: &LinkId,
    direction: Direction,
    test: ThroughputTest,
) -> Result<(), InstructionError> {
    let link = link.clone();
    let begin = move |fabric: &mut Fabric, now| fabric.test_throughput(now, &link, direction, test);
    network.with(begin).map_err(rejected)?.map_err(rejected)
}

/// The emulated network was stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the emulated network was stopped")]
pub struct NetworkGone;

/// The reason for which an instruction was rejected, for people.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InstructionError(pub String);

pub(crate) fn rejected(reason: impl ToString) -> InstructionError {
    InstructionError(reason.to_string())
}
