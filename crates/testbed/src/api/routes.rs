//! The current state, and instructions.

use axum::{Extension, Json, extract::State, http::HeaderMap};
use cotorra_graph::{
    Candidate, Instruction, LinkId, NodeId, Placement, PluginId, RadioContext, RobotContext, ThroughputTest,
    VirtualLinkMapping, VnfId,
};

use super::{
    auth::Caller,
    context::{Answer, Context},
    types::{
        AddVnfBody, AddedVnfBody, Body, Done, Failure, InstructionBody, LinkBody, MachineBody, NodeBody,
        Path, TestbedBody, ThroughputTestBody,
    },
};
use crate::{core::message::Message, given::Given};

/// Returns the testbed: graph, services, walks and plug-ins.
#[utoipa::path(get, path = "/api/v1/testbed", tag = "network",
    responses((status = 200, body = TestbedBody)))]
pub(super) async fn testbed(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
) -> Json<TestbedBody> {
    let testbed = caller.view.as_ref().map_or(&*context.testbed, |view| view.testbed());
    Json(TestbedBody::new(testbed, !context.replay))
}

/// Returns a node, its addresses and its namespace.
#[utoipa::path(get, path = "/api/v1/network/nodes/{id}", tag = "network",
    params(("id" = String, Path)),
    responses((status = 200, body = NodeBody)))]
pub(super) async fn node(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<NodeId>,
) -> Answer<NodeBody> {
    caller.sees(&id, |view| view.owns(&id))?;
    let graph = &context.testbed.graph;
    let node = graph.node(&id).ok_or_else(|| Failure::not_found(format!("there is no node `{id}`")))?;
    let namespace = context.namespaces.get(&id).cloned();
    Ok(Json(NodeBody { node: node.clone(), address: graph.address(&id), namespace }))
}

/// Returns the context of a node's machine: its CPUs, memory, network interfaces and Wi-Fi. Counters count since an
/// interface exists, and shares and throughputs are those since the machine's last reading.
#[utoipa::path(get, path = "/api/v1/network/nodes/{id}/machine", tag = "network",
    params(("id" = String, Path)),
    responses((status = 200, body = MachineBody)))]
pub(super) async fn machine(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<NodeId>,
) -> Answer<MachineBody> {
    caller.sees(&id, |view| view.owns(&id))?;
    if context.testbed.graph.node(&id).is_none() {
        return Err(Failure::not_found(format!("there is no node `{id}`")));
    }
    let body = context.live.read(|now| {
        let (at, machine) = now.machines.get(&id)?;
        Some(MachineBody::new(machine.clone(), now.at.since(*at)))
    });
    body.map(Json)
        .ok_or_else(|| Failure::not_found(format!("the machine of node `{id}` has reported nothing")))
}

/// Returns κ of every robot.
#[utoipa::path(get, path = "/api/v1/robots", tag = "robots",
    responses((status = 200, body = Vec<RobotContext>)))]
pub(super) async fn robots(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
) -> Json<Vec<RobotContext>> {
    let seen = |robot: &RobotContext| match &caller.view {
        Some(view) => view.robot(robot),
        None => Some(robot.clone()),
    };
    Json(context.live.read(|now| now.robots.values().filter_map(seen).collect()))
}

/// Returns κ of a robot.
#[utoipa::path(get, path = "/api/v1/robots/{id}", tag = "robots",
    params(("id" = String, Path)),
    responses((status = 200, body = RobotContext)))]
pub(super) async fn robot(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<NodeId>,
) -> Answer<RobotContext> {
    caller.sees(&id, |view| view.owns(&id))?;
    let robot = context.live.read(|now| now.robots.get(&id).cloned());
    let robot = match &caller.view {
        Some(view) => robot.and_then(|robot| view.robot(&robot)),
        None => robot,
    };
    robot.map(Json).ok_or_else(|| unknown_robot(&id))
}

/// Returns the radio units that a robot can use, with the delay over the air to each, d(r,R): measured on the own one, else
/// estimated from its other stations, else configured.
#[utoipa::path(get, path = "/api/v1/robots/{id}/candidates", tag = "robots",
    params(("id" = String, Path)),
    responses((status = 200, body = Vec<Candidate>)))]
pub(super) async fn candidates(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(id): Path<NodeId>,
) -> Answer<Vec<Candidate>> {
    caller.sees(&id, |view| view.owns(&id))?;
    let candidates = context.live.read(|now| {
        let robot = now.robots.get(&id)?;
        let seen = match &caller.view {
            Some(view) => view.robot(robot)?,
            None => robot.clone(),
        };
        let others = now.robots.values().filter(|other| caller.keeps(|view| view.owns(&other.robot)));
        let stations: Vec<_> =
            others.filter_map(|other| Some((&other.robot, other.attached_to()?))).collect();
        let link = |link: &LinkId, direction| {
            let key = (link.clone(), direction);
            Some((now.links.get(&key)?, now.at.since(*now.links_at.get(&key)?)))
        };
        Some(cotorra_graph::candidates(&seen, &context.testbed.graph, &stations, link))
    });
    candidates.map(Json).ok_or_else(|| unknown_robot(&id))
}

fn unknown_robot(id: &NodeId) -> Failure {
    Failure::not_found(format!("there is no robot `{id}`, or nothing is known of it yet"))
}

/// Returns d, λ and conditions of every link, in both directions, with configured, measured and available figures.
#[utoipa::path(get, path = "/api/v1/network/links", tag = "network",
    responses((status = 200, body = Vec<LinkBody>)))]
pub(super) async fn links(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
) -> Json<Vec<LinkBody>> {
    Json(context.live.read(|now| {
        let told = now.links.values().zip(now.links_at.values());
        let seen = told.filter(|(link, _)| caller.keeps(|view| view.sees_link(&link.link)));
        seen.map(|(link, at)| LinkBody::new(link.clone(), now.at.since(*at))).collect()
    }))
}

/// Measures the throughput of one direction of a wired link, by packets that cross it.
///
/// A test is bounded: 10 s and 1 Gbit/s at most, one test of a direction at a time, and a pause of four times its duration
/// afterwards. The result is in the link's `tested` a second after the last packet.
#[utoipa::path(post, path = "/api/v1/network/links/{id}/throughput-test", tag = "network",
    params(("id" = String, Path), ("X-Cotorra-Plugin" = Option<String>, Header)), request_body = ThroughputTestBody,
    responses((status = 200, body = Done), (status = 409, description = "refused, for the reason in the body", body = super::types::FailureBody)))]
pub(super) async fn test_throughput(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(link): Path<LinkId>,
    headers: HeaderMap,
    Body(body): Body<ThroughputTestBody>,
) -> Answer<Done> {
    let ThroughputTestBody { direction, duration_ms, rate_limit_bps } = body;
    let duration = duration_ms.map(|ms| std::time::Duration::try_from_secs_f64(ms / 1e3)).transpose();
    let duration = duration.map_err(|error| Failure::bad_request(format!("`duration_ms`: {error}")))?;
    let test = ThroughputTest {
        duration: duration.unwrap_or(ThroughputTest::default().duration),
        rate_limit: rate_limit_bps,
    };
    let instruction = Instruction::TestThroughput { link, direction, test };
    give(&context, &caller, &headers, InstructionBody { instruction, reason: None }).await
}

/// Returns ι of every radio unit.
#[utoipa::path(get, path = "/api/v1/network/radio-units", tag = "network",
    responses((status = 200, body = Vec<RadioContext>)))]
pub(super) async fn radio_units(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
) -> Json<Vec<RadioContext>> {
    let seen = |one: &&RadioContext| caller.keeps(|view| view.owns(&one.radio_unit));
    Json(context.live.read(|now| now.radio_units.values().filter(seen).cloned().collect()))
}

/// Returns a(n): the node of every VNF.
#[utoipa::path(get, path = "/api/v1/network/placements", tag = "network",
    responses((status = 200, body = Vec<Placement>)))]
pub(super) async fn placements(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
) -> Json<Vec<Placement>> {
    let seen = |one: &Placement| match &caller.view {
        Some(view) => view.placement(one),
        None => Some(one.clone()),
    };
    Json(context.live.read(|now| now.placements.values().filter_map(seen).collect()))
}

/// Returns a(n1,n2): the links that carry each direction of every virtual link, and the reason for them.
#[utoipa::path(get, path = "/api/v1/network/virtual-links", tag = "network",
    responses((status = 200, body = Vec<VirtualLinkMapping>)))]
pub(super) async fn virtual_links(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
) -> Json<Vec<VirtualLinkMapping>> {
    let seen = |one: &VirtualLinkMapping| match &caller.view {
        Some(view) => view.virtual_link(one),
        None => Some(one.clone()),
    };
    Json(context.live.read(|now| now.virtual_links.iter().filter_map(seen).collect()))
}

/// Returns the caller's plug-in, by its token or by the header.
pub(super) fn plugin(
    context: &Context,
    caller: &Caller,
    headers: &HeaderMap,
) -> Result<Option<PluginId>, Failure> {
    let name = headers.get("x-cotorra-plugin").map(|name| name.to_str().unwrap_or_default());
    let named = name.map(PluginId::new).transpose().map_err(|e| Failure::bad_request(e.to_string()))?;
    caller.name(named, &context.hosted)
}

/// Returns the VNFs that were added during the run, and their states.
#[utoipa::path(get, path = "/api/v1/vnfs", tag = "network",
    responses((status = 200, body = Vec<AddedVnfBody>)))]
pub(super) async fn vnfs(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
) -> Json<Vec<AddedVnfBody>> {
    Json(context.live.read(|now| {
        let body = |(id, vnf): (&VnfId, &cotorra_graph::Vnf)| {
            let node = now.nodes_of_added(id)?;
            let is_seen = caller.keeps(|view| node.all().iter().all(|node| view.owns(node)));
            let body = || AddedVnfBody { vnf: vnf.clone(), node, last: now.vnfs.get(id).cloned() };
            is_seen.then(body)
        };
        now.added.iter().filter_map(body).collect()
    }))
}

/// Adds a VNF that belongs to no service, and starts its instances.
///
/// It is a command or an image with the rights of a confined command, and ends with the run. `GET /api/v1/vnfs` has its
/// state.
#[utoipa::path(post, path = "/api/v1/vnfs", tag = "instructions",
    request_body = AddVnfBody,
    params(("X-Cotorra-Plugin" = Option<String>, Header)),
    responses((status = 200, body = Done), (status = 409, description = "refused, for the reason in the body", body = super::types::FailureBody)))]
pub(super) async fn add_vnf(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    Body(AddVnfBody { vnf, reason }): Body<AddVnfBody>,
) -> Answer<Done> {
    let instruction = Instruction::AddVnf { vnf };
    give(&context, &caller, &headers, InstructionBody { instruction, reason }).await
}

/// Removes a VNF that was added. Its instances stop once packets in flight to them have arrived.
#[utoipa::path(delete, path = "/api/v1/vnfs/{vnf}", tag = "instructions",
    params(("vnf" = String, Path), ("X-Cotorra-Plugin" = Option<String>, Header)),
    responses((status = 200, body = Done), (status = 409, description = "refused, for the reason in the body", body = super::types::FailureBody)))]
pub(super) async fn remove_vnf(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Path(vnf): Path<VnfId>,
    headers: HeaderMap,
) -> Answer<Done> {
    let instruction = Instruction::RemoveVnf { vnf };
    give(&context, &caller, &headers, InstructionBody { instruction, reason: None }).await
}

/// Gives an instruction: move, send, slow, halt or attach a robot, report its sensor, add, place or remove a VNF,
/// map a path, deploy a vAP, change a link.
///
/// The decision is recorded under the caller's name. A plug-in that the run started is identified by its token. Other
/// callers choose a name with the header `X-Cotorra-Plugin`, but not one of the run's plug-ins.
#[utoipa::path(post, path = "/api/v1/instructions", tag = "instructions",
    request_body = InstructionBody,
    params(("X-Cotorra-Plugin" = Option<String>, Header)),
    responses((status = 200, body = Done), (status = 409, description = "refused, for the reason in the body", body = super::types::FailureBody)))]
pub(super) async fn instruct(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    Body(body): Body<InstructionBody>,
) -> Answer<Done> {
    give(&context, &caller, &headers, body).await
}

/// Gives an instruction to the core, and waits for the outcome.
pub(super) async fn give(
    context: &Context,
    caller: &Caller,
    headers: &HeaderMap,
    body: InstructionBody,
) -> Answer<Done> {
    if let Some(view) = &caller.view {
        let added =
            |vnf: &VnfId| context.live.read(|now| now.nodes_of_added(vnf).map(|nodes| nodes.all().to_vec()));
        view.check(&body.instruction, added).map_err(|reason| Failure::not_own(reason.to_string()))?;
    }
    let plugin =
        plugin(context, caller, headers)?.unwrap_or_else(|| "api".parse().expect("`api` is a valid name"));
    let (reply, answer) = tokio::sync::oneshot::channel();
    let InstructionBody { instruction, reason } = body;
    let message = Message::Instruct {
        given: Given { plugin, instruction, reason },
        reply: Some(Box::new(move |done| drop(reply.send(done)))),
    };
    context.core.send(message).map_err(|_| Failure::ended())?;
    match answer.await {
        Ok(Ok(())) => Ok(Json(Done { done: true })),
        Ok(Err(refused)) => Err(Failure::refused(refused.to_string())),
        Err(_) => Err(Failure::ended()),
    }
}
