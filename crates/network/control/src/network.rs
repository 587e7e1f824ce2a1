//! The interface to the emulated network, and its errors.

use cotorra_fabric::{Fabric, FabricError, PinnedPath};
use cotorra_graph::{
    AccessPoint, Attachment, ConditionChange, Dbm, Direction, Lateness, LinkContext, LinkId, NodeId,
    RadioContext, ThroughputTest, Timestamp,
};

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

    /// Replaces the paths that packets are pinned to, with their reservations. The paths are checked.
    ///
    /// # Errors
    /// [`NetworkGone`]; in it, [`InstructionError`] if the paths are pinned, but their reservations are not kept.
    fn pin(&self, paths: Vec<PinnedPath>) -> Result<Result<(), InstructionError>, NetworkGone> {
        pin_in_fabric(self, paths).map(Ok)
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

    /// Makes a robot's radio scan. The event `Scanned` reports the end.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    fn scan(&self, robot: &NodeId) -> Result<(), InstructionError> {
        scan_in_fabric(self, robot)
    }

    /// Hands a robot over to a radio unit. The event `Handover` reports the end.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    fn attach(&self, robot: &NodeId, radio_unit: &NodeId) -> Result<(), InstructionError> {
        attach_in_fabric(self, robot, radio_unit)
    }

    /// Lets a robot's radio unit suggest that it moves to another one. Returns the status of its answer, if that is known at once;
    /// otherwise an event reports it. Does nothing if the robot is there.
    ///
    /// # Errors
    /// [`InstructionError`]. No component was asked then.
    fn suggest(&self, robot: &NodeId, radio_unit: &NodeId) -> Result<Option<u8>, InstructionError> {
        suggest_in_fabric(self, robot, radio_unit)
    }

    /// Gives a robot the settings and the key with which it attaches to a vAP. Without a key, takes them back.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    fn provision(
        &self,
        robot: &NodeId,
        radio_unit: &NodeId,
        access_point: AccessPoint,
    ) -> Result<(), InstructionError> {
        provision_in_fabric(self, robot, radio_unit, access_point)
    }

    /// Checks whether [`Self::switch_on`] would succeed now. Returns who takes the deployment's time.
    ///
    /// # Errors
    /// [`InstructionError`].
    fn check_switch_on(
        &self,
        radio_unit: &NodeId,
        access_point: &AccessPoint,
    ) -> Result<Deployment, InstructionError> {
        check_switch_on_in_fabric(self, radio_unit, access_point)
    }

    /// Switches on a vAP on a radio unit.
    ///
    /// # Errors
    /// [`NetworkGone`]; in it, [`InstructionError`] if nothing has changed.
    fn switch_on(
        &self,
        radio_unit: &NodeId,
        access_point: AccessPoint,
    ) -> Result<Result<(), InstructionError>, NetworkGone> {
        switch_on_in_fabric(self, radio_unit, access_point)
    }

    /// Switches off a radio unit. Its stations lose it.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    fn switch_off(&self, radio_unit: &NodeId) -> Result<(), InstructionError> {
        switch_off_in_fabric(self, radio_unit)
    }

    /// Completes the fabric's contexts of links, if other networks carry packets, too.
    fn complete(&self, _now: Timestamp, contexts: Vec<LinkContext>) -> Vec<LinkContext> {
        contexts
    }

    /// Completes φ of a robot, if its radio is not the fabric's.
    fn complete_attachments(&self, _now: Timestamp, _robot: &NodeId, _attachments: &mut [Attachment]) {}

    /// Completes ι of a radio unit, if its radio is not the fabric's.
    fn complete_radio(&self, _context: &mut RadioContext) {}

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

/// [`Network::pin`] in the fabric alone.
///
/// # Errors
/// [`NetworkGone`].
///
/// # Panics
/// For an impossible path.
pub fn pin_in_fabric<N: Network + ?Sized>(network: &N, paths: Vec<PinnedPath>) -> Result<(), NetworkGone> {
    let pinned = network.with(move |fabric, now| fabric.pin(now, &paths))?;
    pinned.expect("paths are checked when they are mapped, and the graph is constant");
    Ok(())
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

/// [`Network::scan`] in the fabric alone.
///
/// # Errors
/// Those of [`Network::scan`].
pub fn scan_in_fabric<N: Network + ?Sized>(network: &N, robot: &NodeId) -> Result<(), InstructionError> {
    let robot = robot.clone();
    network.with(move |fabric, now| fabric.scan(now, &robot)).map_err(rejected)?.map_err(rejected)
}

/// [`Network::attach`] in the fabric alone.
///
/// # Errors
/// Those of [`Network::attach`].
pub fn attach_in_fabric<N: Network + ?Sized>(
    network: &N,
    robot: &NodeId,
    radio_unit: &NodeId,
) -> Result<(), InstructionError> {
    let (robot, radio_unit) = (robot.clone(), radio_unit.clone());
    let attach = move |fabric: &mut Fabric, now| fabric.attach(now, &robot, &radio_unit);
    network.with(attach).map_err(rejected)?.map_err(rejected)
}

/// [`Network::suggest`] in the fabric alone. The robot answers at once, by the signals that it heard last.
///
/// # Errors
/// Those of [`Network::suggest`].
pub fn suggest_in_fabric<N: Network + ?Sized>(
    network: &N,
    robot: &NodeId,
    radio_unit: &NodeId,
) -> Result<Option<u8>, InstructionError> {
    let (robot, radio_unit) = (robot.clone(), radio_unit.clone());
    let suggest = move |fabric: &mut Fabric, now| {
        let attachments = fabric.attachments(now, &robot);
        let own = attachments.iter().find(|its| its.attached);
        let other = attachments.iter().find(|its| its.radio_unit == radio_unit);
        match (own, other) {
            (Some(own), Some(other)) if own.radio_unit == other.radio_unit => return Ok(None),
            (Some(own), Some(other)) if is_too_weak(own.signal, other.signal) => {
                return Ok(Some(NO_CANDIDATE));
            }
            (None, Some(_)) => {
                return Err(InstructionError(format!(
                    "`{robot}` is at no radio unit, which could suggest another one"
                )));
            }
            // Unknown robots and radio units are rejected below.
            _ => {}
        }
        match fabric.attach(now, &robot, &radio_unit) {
            Ok(()) => Ok(Some(ACCEPTED)),
            Err(FabricError::OutOfReach { .. }) => Ok(Some(NO_CANDIDATE)),
            Err(error) => Err(rejected(error)),
        }
    };
    network.with(suggest).map_err(rejected)?
}

/// Status of a station that moves (IEEE 802.11-2020, table 9-428).
const ACCEPTED: u8 = 0;
/// Status of a station that finds no suitable candidate.
const NO_CANDIDATE: u8 = 7;

/// Whether a suggested radio unit is too weak for a station, by the signals that it heard last. This is the rule of wpa_supplicant
/// 2.10, which scans first if it has not heard the radio unit.
fn is_too_weak(own: Option<Dbm>, other: Option<Dbm>) -> bool {
    const WEAK: Dbm = Dbm(-80.0);
    other.is_some_and(|other| other < WEAK && own.is_some_and(|own| other < own))
}

/// [`Network::provision`] in the fabric alone.
///
/// # Errors
/// Those of [`Network::provision`].
pub fn provision_in_fabric<N: Network + ?Sized>(
    network: &N,
    robot: &NodeId,
    radio_unit: &NodeId,
    access_point: AccessPoint,
) -> Result<(), InstructionError> {
    let (robot, radio_unit) = (robot.clone(), radio_unit.clone());
    let provision = move |fabric: &mut Fabric, _| fabric.provision(&robot, &radio_unit, access_point);
    network.with(provision).map_err(rejected)?.map_err(rejected)
}

/// [`Network::check_switch_on`] in the fabric alone.
///
/// # Errors
/// Those of [`Network::check_switch_on`].
pub fn check_switch_on_in_fabric<N: Network + ?Sized>(
    network: &N,
    radio_unit: &NodeId,
    access_point: &AccessPoint,
) -> Result<Deployment, InstructionError> {
    let (unit, wanted) = (radio_unit.clone(), access_point.clone());
    let check = move |fabric: &mut Fabric, _| fabric.check_switch_on(&unit, &wanted);
    network.with(check).map_err(rejected)?.map_err(rejected)?;
    Ok(Deployment::Emulated)
}

/// [`Network::switch_on`] in the fabric alone.
///
/// # Errors
/// Those of [`Network::switch_on`].
pub fn switch_on_in_fabric<N: Network + ?Sized>(
    network: &N,
    radio_unit: &NodeId,
    access_point: AccessPoint,
) -> Result<Result<(), InstructionError>, NetworkGone> {
    let unit = radio_unit.clone();
    let on = move |fabric: &mut Fabric, now| fabric.switch_on(now, &unit, access_point);
    Ok(network.with(on)?.map_err(rejected))
}

/// [`Network::switch_off`] in the fabric alone.
///
/// # Errors
/// Those of [`Network::switch_off`].
pub fn switch_off_in_fabric<N: Network + ?Sized>(
    network: &N,
    radio_unit: &NodeId,
) -> Result<(), InstructionError> {
    let unit = radio_unit.clone();
    let off = move |fabric: &mut Fabric, now| fabric.switch_off(now, &unit);
    network.with(off).map_err(rejected)?.map_err(rejected)
}

/// The party that takes the time of a vAP's deployment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deployment {
    /// It is emulated: the radio unit's deployment time passes before the vAP is switched on, and it serves at once.
    Emulated,
    /// A real program: the vAP is switched on at once, and an event of the network reports when it serves.
    Real,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_radio_unit_is_too_weak_if_it_is_weaker_than_the_own_one_and_weak() {
        let is_too_weak = |own: f64, other: f64| is_too_weak(Some(Dbm(own)), Some(Dbm(other)));
        assert!(is_too_weak(-70.0, -81.0) && is_too_weak(-81.0, -82.0));
        assert!(!is_too_weak(-50.0, -79.0) && !is_too_weak(-85.0, -82.0));
        assert!(!super::is_too_weak(Some(Dbm(-70.0)), None), "it has not looked for it");
    }
}
