//! OKpi's decision: the cheapest path through the decision graph, expanded over γ levels for each KPI (Martín-Pérez,
//! Malandrino, Chiasserini, Bernardos, "OKpi: All-KPI Network Slicing Through Efficient Resource Allocation", INFOCOM
//! 2020; "KPI Guarantees in Network Slicing", IEEE/ACM Transactions on Networking 30(2), 2022), or what stands against it.

use crate::{
    exploration::{Decision, EXACTLY, Exploration, Kpi},
    model::{Infrastructure, Service, Vnf},
    search::{Infeasible, Placed, Search},
};

/// Places a service at the least cost that keeps all its KPIs. Of equals, the one over the first wireless link is
/// taken.
///
/// # Errors
/// [`Infeasible`]: what stands against it, and by how much.
pub fn place(
    service: &Service,
    infrastructure: &Infrastructure,
    search: Search,
) -> Result<Placed, Infeasible> {
    if search.gamma == 0 {
        return Err(Infeasible::NoLevels);
    }
    let mut decision = Decision::new(service, infrastructure, search)?;
    let mut seek = |gamma, kpis, priced| Exploration::new(&mut decision, gamma, kpis, priced).run();
    if let Ok(placed) = seek(f64::from(search.gamma), [Kpi::Kept; 2], true) {
        return Ok(placed);
    }
    // Reach does not depend on cost, unless somebody is to pay it.
    let closest = match seek(EXACTLY, [Kpi::Relaxed; 2], search.relax) {
        Ok(closest) if search.relax => return Ok(closest),
        Ok(closest) => closest,
        Err(vnf) => {
            let Vnf { id, cpus, rate_bps, .. } = &service.vnfs[vnf];
            return Err(Infeasible::Unreachable { vnf: id.clone(), cpus: *cpus, mbps: rate_bps / 1e6 });
        }
    };
    let late = |placed: &Placed| placed.service_time > service.service_time;
    let failing = |placed: &Placed| placed.slack.reliability.is_some_and(|slack| slack < 0.0);
    if !late(&closest) && !failing(&closest) {
        return Err(Infeasible::Resolution { gamma: search.gamma });
    }
    let target = service.service_time;
    let fastest = seek(EXACTLY, [Kpi::Relaxed, Kpi::Ignored], false).unwrap_or_else(|_| closest.clone());
    if late(&fastest) {
        let least = fastest.service_time;
        return Err(Infeasible::ServiceTime { least, target, excess: least - target });
    }
    let safest = seek(EXACTLY, [Kpi::Ignored, Kpi::Relaxed], false).unwrap_or(closest);
    if let Some(target) = service.reliability.filter(|_| failing(&safest)) {
        let most = safest.reliability;
        return Err(Infeasible::Reliability { most, target, lack: target - most });
    }
    let both = seek(EXACTLY, [Kpi::Relaxed, Kpi::Kept], false).unwrap_or(safest);
    Err(Infeasible::Together { service_time: both.service_time, target })
}
