//! The exact optimum of a placement, by a mixed integer program.
//!
//! It assigns VNFs to hosts, and each virtual link is a flow over hardware links. CPUs, memory, bandwidth, delay,
//! reliability and the radio unit are constraints. Nothing is rounded.

use std::collections::BTreeMap;

use cotorra_okpi::{Chain, Infrastructure};
use microlp::{ComparisonOp, Error, LinearExpr, OptimizationDirection, Problem, Variable};

/// Returns the least cost of all placements that keep every constraint; `None` if there is no such placement.
pub fn optimum(service: &Chain, infrastructure: &Infrastructure) -> Option<f64> {
    let Infrastructure { nodes, links } = infrastructure;
    let mut program = Problem::new(OptimizationDirection::Minimize);
    // Each VNF has one host.
    let mut hosted: Vec<BTreeMap<usize, Variable>> = Vec::new();
    for vnf in &service.vnfs {
        let on = |&host: &usize| (host, program.add_binary_var(vnf.cpus * nodes[host].cost));
        hosted.push(vnf.hosts.iter().map(on).collect());
    }
    for hosts in &hosted {
        program.add_constraint(sum(hosts.values().map(|&x| (x, 1.0))), ComparisonOp::Eq, 1.0);
    }
    for (i, node) in nodes.iter().enumerate() {
        let here = || service.vnfs.iter().zip(&hosted).filter_map(|(vnf, on)| Some((vnf, *on.get(&i)?)));
        let cpus = sum(here().map(|(vnf, x)| (x, vnf.cpus)));
        program.add_constraint(cpus, ComparisonOp::Le, node.cpus);
        // As shares: bytes and bits a second differ too much in magnitude.
        let all = node.memory_bytes.max(1) as f64;
        let memory = sum(here().map(|(vnf, x)| (x, vnf.memory_bytes as f64 / all)));
        program.add_constraint(memory, ComparisonOp::Le, 1.0);
    }
    // Each virtual link is a flow from the host of one VNF to that of the next, one direction of a link at a time.
    let mut flows: Vec<BTreeMap<usize, [Variable; 2]>> = Vec::new();
    for vnf in &service.vnfs[1..] {
        let wide = links.iter().enumerate().filter(|(_, link)| link.free_bps >= vnf.rate_bps);
        let both = |(i, _)| (i, [program.add_binary_var(0.0), program.add_binary_var(0.0)]);
        flows.push(wide.map(both).collect());
    }
    for (flow, ends) in flows.iter().zip(hosted.windows(2)) {
        for (n, node) in nodes.iter().enumerate() {
            let mut balance = LinearExpr::empty();
            let mut entering = LinearExpr::empty();
            for (link, [forth, back]) in flow.iter().map(|(&i, both)| (&links[i], *both)) {
                for (from, to, crosses) in
                    [(link.ends[0], link.ends[1], forth), (link.ends[1], link.ends[0], back)]
                {
                    if from == n {
                        balance.add(crosses, 1.0);
                    }
                    if to == n {
                        balance.add(crosses, -1.0);
                        entering.add(crosses, 1.0);
                    }
                }
            }
            if let Some(&starts) = ends[0].get(&n) {
                balance.add(starts, -1.0);
            }
            if let Some(&stops) = ends[1].get(&n) {
                balance.add(stops, 1.0);
                entering.add(stops, -1.0);
            }
            program.add_constraint(balance, ComparisonOp::Eq, 0.0);
            if !node.forwards {
                program.add_constraint(entering, ComparisonOp::Le, 0.0);
            }
        }
    }
    let crossing =
        |i: usize| flows.iter().enumerate().filter_map(move |(v, flow)| Some((v + 1, *flow.get(&i)?)));
    for (i, link) in links.iter().enumerate().filter(|(_, link)| link.free_bps.is_finite()) {
        let load = crossing(i).flat_map(|(v, both)| both.map(|f| (f, service.vnfs[v].rate_bps / 1e6)));
        program.add_constraint(sum(load), ComparisonOp::Le, link.free_bps / 1e6);
    }
    // A robot uses one radio unit.
    let mut units: BTreeMap<usize, LinearExpr> = BTreeMap::new();
    for (i, link) in links.iter().enumerate().filter(|(_, link)| link.wireless) {
        let used = program.add_var(0.0, (0.0, 1.0));
        at_least_each(&mut program, used, crossing(i).flat_map(|(_, both)| both));
        units.entry(link.ends[0]).or_insert_with(LinearExpr::empty).add(used, 1.0);
    }
    for used in units.into_values() {
        program.add_constraint(used, ComparisonOp::Le, 1.0);
    }
    // KPIs as shares of their budgets.
    let budget_ms = service.service_time.as_secs_f64() * 1e3;
    let processing = service.vnfs.iter().filter_map(|vnf| vnf.processing?.delay());
    let processing_ms: f64 = processing.map(|delay| delay.as_secs_f64() * 1e3).sum();
    let delays = (0..links.len()).flat_map(|i| {
        let share = links[i].round_trip.as_secs_f64() * 1e3 / budget_ms;
        crossing(i).flat_map(move |(_, both)| both.map(|f| (f, share)))
    });
    program.add_constraint(sum(delays), ComparisonOp::Le, 1.0 - processing_ms / budget_ms);
    if let Some(target) = service.reliability {
        let mut failure = LinearExpr::empty();
        let budget = -target.ln().min(-1e-9);
        for (i, node) in nodes.iter().enumerate().filter(|(_, node)| node.reliability < 1.0) {
            let used = program.add_var(0.0, (0.0, 1.0));
            at_least_each(&mut program, used, hosted.iter().filter_map(|on| on.get(&i).copied()));
            failure.add(used, -node.reliability.ln() / budget);
        }
        for (i, link) in links.iter().enumerate().filter(|(_, link)| link.reliability < 1.0) {
            let used = program.add_var(0.0, (0.0, 1.0));
            at_least_each(&mut program, used, crossing(i).flat_map(|(_, both)| both));
            failure.add(used, -link.reliability.ln() / budget);
        }
        program.add_constraint(failure, ComparisonOp::Le, 1.0);
    }
    let solution = match program.solve() {
        Ok(outcome) => outcome.into_solution().expect("no limit was set"),
        Err(Error::Infeasible) => return None,
        Err(error) => panic!("the oracle fails: {error}"),
    };
    // Integers are integers up to the solver's tolerance.
    let chosen = |on: &BTreeMap<usize, Variable>| {
        let host = on.iter().find(|(_, x)| solution.var_value(**x) > 0.5);
        *host.expect("each VNF has one host").0
    };
    Some(service.vnfs.iter().zip(&hosted).map(|(vnf, on)| vnf.cpus * nodes[chosen(on)].cost).sum())
}

fn sum(terms: impl IntoIterator<Item = (Variable, f64)>) -> LinearExpr {
    terms.into_iter().collect()
}

fn at_least_each(program: &mut Problem, upper: Variable, each: impl Iterator<Item = Variable>) {
    for lower in each {
        program.add_constraint(sum([(upper, 1.0), (lower, -1.0)]), ComparisonOp::Ge, 0.0);
    }
}
