//! What is known right now, and instructions.

use axum::{Json, extract::State, http::HeaderMap};
use cotorra_graph::{LinkContext, NodeId, Placement, PluginId, RadioContext, RobotContext};

use super::{
    Answer, Context,
    types::{Body, Done, Failure, FailureBody, InstructionBody, NodeBody, Path, TestbedBody},
};
use crate::core_loop::Message;

/// The testbed: graph, services, walks and plug-ins.
#[utoipa::path(get, path = "/api/v1/testbed", tag = "network", responses((status = 200, body = TestbedBody)))]
pub(super) async fn testbed(State(context): State<Context>) -> Json<TestbedBody> {
    Json(TestbedBody::from(&*context.testbed))
}

/// A node, its addresses and its namespace.
#[utoipa::path(get, path = "/api/v1/network/nodes/{id}", tag = "network", params(("id" = String, Path)),
    responses((status = 200, body = NodeBody), (status = 404, body = FailureBody)))]
pub(super) async fn node(State(context): State<Context>, Path(id): Path<NodeId>) -> Answer<NodeBody> {
    let graph = &context.testbed.graph;
    let node = graph.node(&id).ok_or_else(|| Failure::not_found(format!("there is no node `{id}`")))?;
    let namespace = context.namespaces.get(&id).cloned();
    Ok(Json(NodeBody { node: node.clone(), address: graph.address(&id), namespace }))
}

/// κ of every robot.
#[utoipa::path(get, path = "/api/v1/robots", tag = "robots", responses((status = 200, body = Vec<RobotContext>)))]
pub(super) async fn robots(State(context): State<Context>) -> Json<Vec<RobotContext>> {
    Json(context.live.read(|now| now.robots.values().cloned().collect()))
}

/// κ of a robot.
#[utoipa::path(get, path = "/api/v1/robots/{id}", tag = "robots", params(("id" = String, Path)),
    responses((status = 200, body = RobotContext), (status = 404, body = FailureBody)))]
pub(super) async fn robot(State(context): State<Context>, Path(id): Path<NodeId>) -> Answer<RobotContext> {
    let robot = context.live.read(|now| now.robots.get(&id).cloned());
    robot
        .map(Json)
        .ok_or_else(|| Failure::not_found(format!("there is no robot `{id}`, or nothing is known of it yet")))
}

/// d, λ and conditions of every link, in both directions.
#[utoipa::path(get, path = "/api/v1/network/links", tag = "network",
    responses((status = 200, body = Vec<LinkContext>)))]
pub(super) async fn links(State(context): State<Context>) -> Json<Vec<LinkContext>> {
    Json(context.live.read(|now| now.links.values().cloned().collect()))
}

/// ι of every radio unit.
#[utoipa::path(get, path = "/api/v1/network/radio-units", tag = "network",
    responses((status = 200, body = Vec<RadioContext>)))]
pub(super) async fn radio_units(State(context): State<Context>) -> Json<Vec<RadioContext>> {
    Json(context.live.read(|now| now.radio_units.values().cloned().collect()))
}

/// a(n): where every VNF runs.
#[utoipa::path(get, path = "/api/v1/network/placements", tag = "network",
    responses((status = 200, body = Vec<Placement>)))]
pub(super) async fn placements(State(context): State<Context>) -> Json<Vec<Placement>> {
    Json(context.live.read(|now| now.placements.values().cloned().collect()))
}

/// Who asks, as the header says.
pub(super) fn plugin(headers: &HeaderMap) -> Result<Option<PluginId>, Failure> {
    let name = headers.get("x-cotorra-plugin").map(|name| name.to_str().unwrap_or_default());
    name.map(PluginId::new).transpose().map_err(|e| Failure::bad_request(e.to_string()))
}

/// Give an instruction: move or scan with a robot, attach it, place a VNF, change a link's conditions.
///
/// The header `X-Cotorra-Plugin` names who asks; the decision is recorded under that name.
#[utoipa::path(post, path = "/api/v1/instructions", tag = "instructions", request_body = InstructionBody,
    params(("X-Cotorra-Plugin" = Option<String>, Header)),
    responses((status = 200, body = Done), (status = 400, body = FailureBody), (status = 409, body = FailureBody)))]
pub(super) async fn instruct(
    State(context): State<Context>,
    headers: HeaderMap,
    Body(body): Body<InstructionBody>,
) -> Answer<Done> {
    let plugin = plugin(&headers)?.unwrap_or_else(|| "api".parse().expect("`api` is a name"));
    let (reply, answer) = tokio::sync::oneshot::channel();
    let message = Message::Instruct {
        plugin,
        instruction: body.instruction,
        reason: body.reason,
        reply: Some(Box::new(move |done| drop(reply.send(done)))),
    };
    context.core.send(message).map_err(|_| Failure::ended())?;
    match answer.await {
        Ok(Ok(())) => Ok(Json(Done { done: true })),
        Ok(Err(refused)) => Err(Failure::refused(refused.to_string())),
        Err(_) => Err(Failure::ended()),
    }
}
