//! Allocations as a state machine.

use std::{collections::BTreeMap, sync::Arc};

use cotorra_graph::{BitRate, LinkId, NodeId, Testbed};
use cotorra_mec::{InvalidRequest, Limiter, MOST, RequestError, Resource, check_unchanged, etag};

use crate::{
    allocation::{Allocation, Path},
    change::Change,
    consumer::Consumer,
    error::BandwidthError,
    selection::Selection,
    session::{Seen, Survey},
    types::{AllocationDirection, BwInfo, BwInfoDeltas},
};

/// The most allocations of one application.
const MOST_OF_APPLICATION: usize = 16;

/// The allocations of a testbed.
#[derive(Debug)]
pub struct Bandwidth {
    testbed: Arc<Testbed>,
    allocations: BTreeMap<u64, Allocation>,
    last: u64,
    /// The limits on each consumer's changes.
    limiters: BTreeMap<Consumer, Limiter>,
}

impl Bandwidth {
    /// Creates the service of a testbed, without allocations.
    pub fn new(testbed: Arc<Testbed>) -> Self {
        Self { testbed, allocations: BTreeMap::new(), last: 0, limiters: BTreeMap::new() }
    }

    /// Whether there is any allocation.
    pub fn is_empty(&self) -> bool {
        self.allocations.is_empty()
    }

    /// Returns the selected allocations that a consumer sees.
    pub fn list(&self, consumer: &Consumer, selection: &Selection) -> Vec<&BwInfo> {
        let seen = self.allocations.values().filter(|allocation| consumer.sees(&allocation.owner));
        seen.map(|allocation| &allocation.info).filter(|info| selection.has(info)).collect()
    }

    /// Returns an allocation. `base` is the URI under which the consumer sees the service.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn get(&self, consumer: &Consumer, base: &str, id: &str) -> Result<Resource<BwInfo>, RequestError> {
        let (id, allocation) = self.find(consumer, id)?;
        Ok(resource(base, id, allocation))
    }

    fn find(&self, consumer: &Consumer, id: &str) -> Result<(u64, &Allocation), RequestError> {
        let found = id.parse().ok().and_then(|id: u64| Some((id, self.allocations.get(&id)?)));
        let seen = found.filter(|(_, allocation)| consumer.sees(&allocation.owner));
        seen.ok_or_else(|| RequestError::NotFound { what: "allocation", id: id.to_owned() })
    }

    fn admit(&mut self, seen: Seen<'_>) -> Result<(), RequestError> {
        let limiter = self.limiters.entry(seen.consumer.clone()).or_default();
        Ok(limiter.admit(seen.survey.at)?)
    }

    /// Plans a new allocation.
    ///
    /// # Errors
    /// [`BandwidthError`].
    pub fn create(&mut self, seen: Seen<'_>, info: BwInfo) -> Result<Change, BandwidthError> {
        self.admit(seen)?;
        let owner = seen.consumer.clone();
        let count = |is: &dyn Fn(&Consumer) -> bool| {
            self.allocations.values().filter(|allocation| is(&allocation.owner)).count()
        };
        if count(&|other| other.domain() == owner.domain()) >= MOST {
            return Err(RequestError::Full.into());
        }
        if owner.application().is_some() && count(&|other| *other == owner) >= MOST_OF_APPLICATION {
            let reason = format!("an application has at most {MOST_OF_APPLICATION} allocations");
            return Err(BandwidthError::Refused(reason));
        }
        let id = self.last + 1;
        Ok(Change::new(id, &[], self.allocation(seen, id, (owner, 1), info)?))
    }

    /// Plans the replacement of an allocation.
    ///
    /// # Errors
    /// [`BandwidthError`].
    pub fn replace(
        &mut self,
        seen: Seen<'_>,
        id: &str,
        if_match: Option<&str>,
        info: BwInfo,
    ) -> Result<Change, BandwidthError> {
        self.admit(seen)?;
        let (id, before) = self.find(seen.consumer, id)?;
        check_unchanged(if_match, id, before.version)?;
        if info.allocation_id.as_ref().is_some_and(|named| *named != id.to_string()) {
            return Err(InvalidRequest::Malformed(format!("the allocationId is {id}")).into());
        }
        let owner = before.owner.clone();
        if owner.application().is_some_and(|own| *own != *info.app_ins_id) {
            return Err(BandwidthError::Refused("it stays with the application that made it".to_owned()));
        }
        let after = self.allocation(seen, id, (owner, before.version + 1), info)?;
        Ok(Change::new(id, &before.paths, after))
    }

    /// Plans changes of an allocation.
    ///
    /// # Errors
    /// [`BandwidthError`].
    pub fn modify(
        &mut self,
        seen: Seen<'_>,
        id: &str,
        if_match: Option<&str>,
        deltas: BwInfoDeltas,
    ) -> Result<Change, BandwidthError> {
        let BwInfo { app_name, session_filter, fixed_allocation, allocation_direction, .. } =
            self.find(seen.consumer, id)?.1.info.clone();
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
        self.replace(seen, id, if_match, info)
    }

    /// Plans the end of an allocation.
    ///
    /// # Errors
    /// [`RequestError`].
    pub fn remove(
        &mut self,
        seen: Seen<'_>,
        id: &str,
        if_match: Option<&str>,
    ) -> Result<Change, RequestError> {
        self.admit(seen)?;
        let (id, before) = self.find(seen.consumer, id)?;
        check_unchanged(if_match, id, before.version)?;
        Ok(Change::end(id, before.paths.iter()))
    }

    /// Returns the ends of allocations whose time is over, with the reason. `now` is a survey of the whole testbed.
    pub fn ended(&mut self, now: &Survey) -> Vec<(Change, String)> {
        let is_there = |consumer: &Consumer| match consumer.application() {
            Some(application) => now.nodes.contains_key(application),
            None => true,
        };
        self.limiters.retain(|consumer, _| is_there(consumer));
        let end = |(id, allocation): (&u64, &Allocation)| {
            let reason = allocation.end(now)?;
            // What somebody else has mapped since is not the allocation's.
            let paths = allocation.paths.iter().filter(|path| path.is_in_force(now));
            Some((Change::end(*id, paths), reason))
        };
        self.allocations.iter().filter_map(end).collect()
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

    /// Returns the allocation with this number as an owner's next version of it.
    fn allocation(
        &self,
        seen: Seen<'_>,
        id: u64,
        (owner, version): (Consumer, u64),
        info: BwInfo,
    ) -> Result<Allocation, BandwidthError> {
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
        let [here, there] = seen.ends(&self.testbed.graph, &info)?;
        let away = [here.clone(), there.clone()];
        let towards = [there, here.clone()];
        let directions = match info.allocation_direction {
            AllocationDirection::Downlink => vec![away],
            AllocationDirection::Uplink => vec![towards],
            AllocationDirection::Symmetrical => vec![away, towards],
        };
        let kept = owner.kept();
        let path = |ends: [NodeId; 2]| Ok(Path { links: self.links(seen, &ends, id)?, ends, rate, kept });
        let paths = directions.into_iter().map(path).collect::<Result<_, BandwidthError>>()?;
        let info = BwInfo { allocation_id: Some(id.to_string()), ..info };
        Ok(Allocation { info, owner, version, node: here, paths })
    }

    /// Returns the links of the path between two nodes, unless it is mapped for something other than the allocation `own`.
    fn links(
        &self,
        Seen { consumer, part, survey }: Seen<'_>,
        ends: &[NodeId; 2],
        own: u64,
    ) -> Result<Vec<LinkId>, BandwidthError> {
        let [from, to] = ends;
        let has = |allocation: &Allocation| allocation.paths.iter().any(|path| path.ends == *ends);
        let is_own = self.allocations.get(&own).is_some_and(has);
        let other = self.allocations.iter().find(|(id, other)| **id != own && has(other));
        if let Some((id, _)) = other.filter(|(_, other)| consumer.sees(&other.owner)) {
            let reason = format!("the packets from `{from}` to `{to}` are those of the allocation {id}");
            return Err(BandwidthError::Refused(reason));
        }
        if other.is_some() || !is_own && survey.mapped.contains_key(ends) {
            let reason = format!("the packets from `{from}` to `{to}` have a mapped path already");
            return Err(BandwidthError::Refused(reason));
        }
        let route = part.graph.route(from, to, |robot| survey.attached.get(robot));
        let links = route.map(|route| route.links).unwrap_or_default();
        if !links.iter().any(|link| part.graph.links.iter().any(|wired| wired.id == *link)) {
            let reason = "the path has no wired link, and only these keep rates";
            return Err(InvalidRequest::Unsupported(reason).into());
        }
        Ok(links)
    }
}

fn resource(base: &str, id: u64, allocation: &Allocation) -> Resource<BwInfo> {
    let href = format!("{base}/bw_allocations/{id}");
    Resource { value: allocation.info.clone(), href, etag: etag(id, allocation.version) }
}

#[cfg(test)]
mod tests;
