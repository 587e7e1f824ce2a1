//! Allocations as a state machine.

use std::{collections::BTreeMap, sync::Arc};

use cotorra_graph::{BitRate, Instruction, LinkId, MapReservation, NodeId, Reservations, Testbed};
use cotorra_mec::{InvalidRequest, MOST, Problem, RequestError, Resource, check_unchanged, etag};

use crate::{
    session::{Survey, ends},
    types::{AllocationDirection, BwInfo, BwInfoDeltas},
};

/// The allocations of a testbed.
#[derive(Debug)]
pub struct Bandwidth {
    testbed: Arc<Testbed>,
    allocations: BTreeMap<u64, Allocation>,
    last: u64,
}

#[derive(Debug, Clone, PartialEq)]
struct Allocation {
    info: BwInfo,
    version: u64,
    paths: Vec<Path>,
}

/// A reserved path.
#[derive(Debug, Clone, PartialEq)]
struct Path {
    ends: [NodeId; 2],
    links: Vec<LinkId>,
    rate: BitRate,
}

/// A rejected request. Nothing has changed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BandwidthError {
    /// The request is invalid, or asks for what no link can keep.
    #[error(transparent)]
    Request(#[from] RequestError),
    /// The state of the testbed does not allow it.
    #[error("{0}")]
    Refused(String),
}

impl From<InvalidRequest> for BandwidthError {
    fn from(error: InvalidRequest) -> Self {
        Self::Request(error.into())
    }
}

impl From<BandwidthError> for Problem {
    fn from(error: BandwidthError) -> Self {
        match error {
            BandwidthError::Request(error) => error.into(),
            BandwidthError::Refused(reason) => Self::forbidden(reason),
        }
    }
}

/// A change of one allocation, which is not in force yet.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    id: u64,
    after: Option<Allocation>,
    steps: Vec<Step>,
}

#[derive(Debug, Clone, PartialEq)]
struct Step {
    before: Option<Path>,
    after: Option<Path>,
}

impl Path {
    fn map(&self) -> Instruction {
        let [from, to] = self.ends.clone();
        let reservation = MapReservation { kept: Reservations::Limited, rate: Some(self.rate) };
        Instruction::Map { from, to, links: self.links.clone(), reservation: Some(reservation) }
    }

    fn unmap(&self) -> Instruction {
        let [from, to] = self.ends.clone();
        Instruction::Map { from, to, links: Vec::new(), reservation: None }
    }
}

impl Change {
    /// Returns instructions that bring it about, in order. If one is rejected, [`Self::undo`] has those that take back the ones
    /// before it.
    pub fn instructions(&self) -> impl Iterator<Item = Instruction> {
        self.steps.iter().filter_map(|step| Step::instruction(&step.before, &step.after))
    }

    /// Returns the instructions that take back the first so many.
    pub fn undo(&self, done: usize) -> impl Iterator<Item = Instruction> {
        let done = &self.steps[..done.min(self.steps.len())];
        done.iter().rev().filter_map(|step| Step::instruction(&step.after, &step.before))
    }
}

impl Step {
    fn instruction(from: &Option<Path>, to: &Option<Path>) -> Option<Instruction> {
        to.as_ref().map(Path::map).or_else(|| from.as_ref().map(Path::unmap))
    }
}

/// Which allocations a list has.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Selection {
    apps: Vec<String>,
    names: Vec<String>,
    sessions: Vec<String>,
}

impl Selection {
    /// Reads the parameters of a query. Only one kind may be given.
    ///
    /// # Errors
    /// [`InvalidRequest::Malformed`].
    pub fn read(parameters: &[(String, String)]) -> Result<Self, InvalidRequest> {
        let mut selection = Self::default();
        for (name, value) in parameters {
            let list = match name.as_str() {
                "app_instance_id" => &mut selection.apps,
                "app_name" => &mut selection.names,
                "session_id" => &mut selection.sessions,
                _ => {
                    return InvalidRequest::malformed(format!(
                        "there is no parameter `{name}`; there are app_instance_id, app_name, session_id"
                    ));
                }
            };
            list.extend(value.split(',').map(str::to_owned));
        }
        let kinds = [&selection.apps, &selection.names, &selection.sessions];
        if kinds.iter().filter(|list| !list.is_empty()).count() > 1 {
            return InvalidRequest::malformed(
                "only one of app_instance_id, app_name and session_id can be given",
            );
        }
        Ok(selection)
    }

    fn has(&self, info: &BwInfo) -> bool {
        let among = |list: &[String], value: &Option<String>| {
            list.is_empty() || value.as_ref().is_some_and(|value| list.contains(value))
        };
        let is_session = info.request_type == 1;
        (self.apps.is_empty() || self.apps.contains(&info.app_ins_id))
            && among(&self.names, &info.app_name)
            && (self.sessions.is_empty() || is_session && among(&self.sessions, &info.allocation_id))
    }
}

impl Bandwidth {
    /// Creates the service of a testbed, without allocations.
    pub fn new(testbed: Arc<Testbed>) -> Self {
        Self { testbed, allocations: BTreeMap::new(), last: 0 }
    }

    /// Returns the selected allocations.
    pub fn list(&self, selection: &Selection) -> Vec<&BwInfo> {
        self.allocations
            .values()
            .map(|allocation| &allocation.info)
            .filter(|info| selection.has(info))
            .collect()
    }

    /// Returns an allocation. `base` is the URI under which the consumer sees the service.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn get(&self, base: &str, id: &str) -> Result<Resource<BwInfo>, RequestError> {
        let (id, allocation) = self.find(id)?;
        Ok(resource(base, id, allocation))
    }

    fn find(&self, id: &str) -> Result<(u64, &Allocation), RequestError> {
        let found = id.parse().ok().and_then(|id: u64| Some((id, self.allocations.get(&id)?)));
        found.ok_or_else(|| RequestError::NotFound { what: "allocation", id: id.to_owned() })
    }

    /// Plans a new allocation.
    ///
    /// # Errors
    /// [`BandwidthError`].
    pub fn create(&self, survey: &Survey, info: BwInfo) -> Result<Change, BandwidthError> {
        if self.allocations.len() >= MOST {
            return Err(RequestError::Full.into());
        }
        let id = self.last + 1;
        let paths = self.paths(survey, &info, None)?;
        Ok(change(id, info, 1, &[], paths))
    }

    /// Plans the replacement of an allocation.
    ///
    /// # Errors
    /// [`BandwidthError`].
    pub fn replace(
        &self,
        survey: &Survey,
        id: &str,
        if_match: Option<&str>,
        info: BwInfo,
    ) -> Result<Change, BandwidthError> {
        let (id, before) = self.find(id)?;
        check_unchanged(if_match, id, before.version)?;
        if info.allocation_id.as_ref().is_some_and(|named| *named != id.to_string()) {
            return Err(InvalidRequest::Malformed(format!("the allocationId is {id}")).into());
        }
        let paths = self.paths(survey, &info, Some(id))?;
        Ok(change(id, info, before.version + 1, &before.paths, paths))
    }

    /// Plans changes of an allocation.
    ///
    /// # Errors
    /// [`BandwidthError`].
    pub fn modify(
        &self,
        survey: &Survey,
        id: &str,
        if_match: Option<&str>,
        deltas: BwInfoDeltas,
    ) -> Result<Change, BandwidthError> {
        let BwInfo { app_name, session_filter, fixed_allocation, allocation_direction, .. } =
            self.find(id)?.1.info.clone();
        let info = BwInfo {
            allocation_id: deltas.allocation_id,
            app_ins_id: deltas.app_ins_id,
            app_name,
            request_type: deltas.request_type,
            session_filter: deltas.session_filter.or(session_filter).filter(|_| deltas.request_type != 0),
            fixed_bw_priority: deltas.fixed_bw_priority,
            fixed_allocation: deltas.fixed_allocation.unwrap_or(fixed_allocation),
            allocation_direction: deltas.allocation_direction.unwrap_or(allocation_direction),
        };
        self.replace(survey, id, if_match, info)
    }

    /// Plans the end of an allocation.
    ///
    /// # Errors
    /// [`RequestError`].
    pub fn remove(&self, id: &str, if_match: Option<&str>) -> Result<Change, RequestError> {
        let (id, before) = self.find(id)?;
        check_unchanged(if_match, id, before.version)?;
        let steps = before.paths.iter().map(|path| Step { before: Some(path.clone()), after: None });
        Ok(Change { id, after: None, steps: steps.collect() })
    }

    /// Records that a change is in force. Returns the allocation, if it has not ended.
    pub fn commit(&mut self, base: &str, change: Change) -> Option<Resource<BwInfo>> {
        let Change { id, after, .. } = change;
        self.last = self.last.max(id);
        match after {
            None => {
                self.allocations.remove(&id);
                None
            }
            Some(allocation) => {
                let resource = resource(base, id, &allocation);
                self.allocations.insert(id, allocation);
                Some(resource)
            }
        }
    }

    /// Returns the paths of an allocation. `own` is one that it replaces.
    fn paths(&self, survey: &Survey, info: &BwInfo, own: Option<u64>) -> Result<Vec<Path>, BandwidthError> {
        if info.fixed_bw_priority.is_some() {
            let reason = "links keep rates, not priorities: leave fixedBWPriority out";
            return Err(InvalidRequest::Unsupported(reason).into());
        }
        let rate = info.fixed_allocation.parse().ok().and_then(BitRate::from_bits_per_second);
        let rate = rate.ok_or_else(|| {
            InvalidRequest::Malformed(format!(
                "fixedAllocation is in bit/s, above 0, not `{}`",
                info.fixed_allocation
            ))
        })?;
        let [here, there] = ends(&self.testbed, survey, info)?;
        let away = [here.clone(), there.clone()];
        let towards = [there, here];
        let directions = match info.allocation_direction {
            AllocationDirection::Downlink => vec![away],
            AllocationDirection::Uplink => vec![towards],
            AllocationDirection::Symmetrical => vec![away, towards],
        };
        directions.into_iter().map(|ends| self.path(survey, ends, rate, own)).collect()
    }

    fn path(
        &self,
        survey: &Survey,
        ends: [NodeId; 2],
        rate: BitRate,
        own: Option<u64>,
    ) -> Result<Path, BandwidthError> {
        let [from, to] = &ends;
        let allocated = |(id, _): &(&u64, &Allocation)| Some(**id) != own;
        let of_others = self.allocations.iter().filter(allocated);
        let mut others =
            of_others.flat_map(|(id, allocation)| allocation.paths.iter().map(move |path| (id, path)));
        if let Some((id, _)) = others.find(|(_, path)| path.ends == ends) {
            let reason = format!("the packets from `{from}` to `{to}` are those of the allocation {id}");
            return Err(BandwidthError::Refused(reason));
        }
        let owned =
            own.and_then(|id| self.allocations.get(&id)).map(|own| own.paths.as_slice()).unwrap_or_default();
        if !owned.iter().any(|path| path.ends == ends) && survey.is_mapped(from, to) {
            let reason = format!("the packets from `{from}` to `{to}` have a mapped path already");
            return Err(BandwidthError::Refused(reason));
        }
        let graph = &self.testbed.graph;
        let route = graph.route(from, to, |robot| survey.attached.get(robot));
        let links = route.map(|route| route.links).unwrap_or_default();
        if !links.iter().any(|link| graph.links.iter().any(|wired| wired.id == *link)) {
            let reason = "the path has no wired link, and only these keep rates";
            return Err(InvalidRequest::Unsupported(reason).into());
        }
        Ok(Path { ends, links, rate })
    }
}

/// Returns the change from some paths to others. Paths that go come first.
fn change(id: u64, info: BwInfo, version: u64, before: &[Path], after: Vec<Path>) -> Change {
    let info = BwInfo { allocation_id: Some(id.to_string()), ..info };
    let same = |a: &Path, among: &[Path]| among.iter().find(|b| b.ends == a.ends).cloned();
    let gone = before.iter().filter(|path| same(path, &after).is_none());
    let gone = gone.map(|path| Step { before: Some(path.clone()), after: None });
    let kept = after.iter().map(|path| Step { before: same(path, before), after: Some(path.clone()) });
    let steps = gone.chain(kept).filter(|step| step.before != step.after).collect();
    Change { id, after: Some(Allocation { info, version, paths: after }), steps }
}

fn resource(base: &str, id: u64, allocation: &Allocation) -> Resource<BwInfo> {
    let href = format!("{base}/bw_allocations/{id}");
    Resource { value: allocation.info.clone(), href, etag: etag(id, allocation.version) }
}

#[cfg(test)]
mod tests;
