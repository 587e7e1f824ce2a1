//! The REST routes of Eclipse fog05 v0.2, below `/fog05`. Its answers are the same; an error also has a status.

use std::collections::BTreeMap;

use axum::{
    Json, Router,
    body::Bytes,
    extract::{Path, State},
    http::StatusCode,
    middleware,
    response::{IntoResponse, Response},
    routing::{get, post, put},
};
use cotorra_lifecycle::{Descriptor, LifecycleError, Network, NetworkDescriptor, fog05};
use serde_json::{Value, json};

use super::{
    super::auth::{self, Gate},
    Asked, Rejected, Served, to_the_end,
};

/// Reason of decisions.
const REASON: &str = "fog05";

type Answer = Result<Json<Value>, Rejected>;

impl IntoResponse for Rejected {
    fn into_response(self) -> Response {
        (self.status, Json(json!({ "error": self.reason }))).into_response()
    }
}

pub(super) fn router(served: Served, gate: Gate) -> Router {
    let routes = Router::new()
        .route("/", get(index))
        .route("/nodes/list", get(nodes))
        .route("/nodes/{node}/info", get(node_info))
        .route("/node/{node}/status", get(node_status))
        .route("/nodes/{node}/plugins/list", get(plugins))
        .route("/nodes/{node}/fdu/list", get(fdus_of_node))
        .route("/nodes/{node}/{fdu}/define", put(define))
        .route("/fdu/list", get(fdus))
        .route("/fdu/{fdu}/info", get(fdu).put(onboard).delete(offload))
        .route("/fdu/{fdu}/schedule", put(schedule))
        .route("/fdu/{fdu}/nodes/list", get(nodes_of_fdu))
        .route("/fdu/{fdu}/instances/list", get(instances))
        .route("/fdu/instances/{instance}/info", get(instance).delete(undefine))
        .route("/fdu/instances/{instance}/configure", post(configure))
        .route("/fdu/instances/{instance}/clean", post(clean))
        .route("/fdu/instances/{instance}/start", post(start))
        .route("/fdu/instances/{instance}/stop", post(stop))
        .route("/fdu/instances/{instance}/migrate/{node}", post(migrate))
        .route("/fdu/instances/{instance}/pause", post(unpausable))
        .route("/fdu/instances/{instance}/resume", post(unpausable))
        // fog05 has the output in its Python API only.
        .route("/fdu/instances/{instance}/log", get(log))
        .route("/network/list", get(networks))
        .route("/networks/{network}/info", get(network).put(add_network).delete(remove_network))
        .route("/nodes/{node}/network/{network}/info", put(connect).delete(disconnect))
        // There are none: images are those of registries.
        .route("/images/list", get(nothing))
        .route("/flavors/list", get(nothing))
        .fallback(not_served)
        .layer(middleware::from_fn_with_state(gate, auth::check))
        .with_state(served);
    Router::new().nest("/fog05", routes)
}

async fn not_served() -> Rejected {
    let reason = "this is not served here: of fog05 v0.2 there are nodes, networks and FDUs, which are defined, \
                  configured, started, migrated, stopped, cleaned and undefined; see docs/use/lifecycle.md";
    Rejected { status: StatusCode::NOT_FOUND, reason: reason.to_owned() }
}

async fn nothing() -> Json<Value> {
    Json(json!([]))
}

async fn index(State(served): State<Served>) -> Json<Value> {
    let system = &served.context.testbed.name;
    Json(json!({ "name": "cotorra", "version": "0.2.0", "system": system, "tenant": "0" }))
}

async fn nodes(State(served): State<Served>, asked: Asked) -> Json<Value> {
    Json(served.nodes(&asked).map(|node| Value::from(node.id.as_str())).collect())
}

async fn node_info(State(served): State<Served>, asked: Asked, Path(node): Path<String>) -> Answer {
    Ok(Json(fog05::node_info(served.node(&asked, &node)?)))
}

async fn node_status(State(served): State<Served>, asked: Asked, Path(node): Path<String>) -> Answer {
    let node = served.node(&asked, &node)?;
    let (_, bytes) = served.taken().get(&node.id).copied().unwrap_or_default();
    Ok(Json(fog05::node_status(node, bytes)))
}

/// A node has no plug-ins of fog05.
async fn plugins(State(served): State<Served>, asked: Asked, Path(node): Path<String>) -> Answer {
    served.node(&asked, &node)?;
    Ok(Json(json!([])))
}

async fn fdus(State(served): State<Served>, asked: Asked) -> Json<Value> {
    let all = served.all();
    Json(all.catalog(asked.viewer()).map(|(id, _)| Value::from(id)).collect())
}

async fn fdu(State(served): State<Served>, asked: Asked, Path(fdu): Path<String>) -> Answer {
    let all = served.all();
    let (id, descriptor) = all.descriptor(asked.viewer(), &fdu)?;
    Ok(Json(fog05::descriptor(id, descriptor)))
}

/// Adds the descriptor in the body to the catalog. The path's identifier is its own, or it gets that one.
async fn onboard(State(served): State<Served>, asked: Asked, Path(fdu): Path<String>, body: Bytes) -> Answer {
    let mut descriptor = Descriptor::read(&body).map_err(LifecycleError::from)?;
    match &descriptor.uuid {
        None => {
            // The reader of the body also checks an identifier.
            descriptor.keys.insert("uuid".to_owned(), fdu.into());
            let text = Value::Object(descriptor.keys).to_string();
            descriptor = Descriptor::read(text.as_bytes()).map_err(LifecycleError::from)?;
        }
        Some(own) if *own == fdu => {}
        Some(own) => {
            let reason = format!("the descriptor's `uuid` is `{own}`, and the path's is `{fdu}`");
            return Err(LifecycleError::Invalid(reason).into());
        }
    }
    let mut all = served.all();
    let id = all.onboard(asked.viewer(), descriptor)?;
    let (id, descriptor) = all.descriptor(asked.viewer(), &id)?;
    Ok(Json(fog05::descriptor(id, descriptor)))
}

async fn offload(State(served): State<Served>, asked: Asked, Path(fdu): Path<String>) -> Answer {
    Ok(Json(served.all().offload(asked.viewer(), &fdu)?.into()))
}

async fn define(
    State(served): State<Served>,
    asked: Asked,
    Path((node, fdu)): Path<(String, String)>,
) -> Answer {
    let node = served.node(&asked, &node)?.id.clone();
    define_on(&served, &asked, &fdu, node)
}

/// Defines an instance on the node with the most CPUs left, of those that have room.
async fn schedule(State(served): State<Served>, asked: Asked, Path(fdu): Path<String>) -> Answer {
    let node = {
        let all = served.all();
        let (_, descriptor) = all.descriptor(asked.viewer(), &fdu)?;
        let taken = served.taken();
        let free = |node: &cotorra_graph::Node| {
            let capacity = node.capacity()?;
            let (cpus, bytes) = taken.get(&node.id).copied().unwrap_or_default();
            let (cpus, bytes) = (capacity.cpus - cpus, capacity.memory_bytes.saturating_sub(bytes));
            let (needed_cpus, needed_bytes) = descriptor.needs();
            (cpus + 1e-9 >= needed_cpus && bytes >= needed_bytes).then(|| (cpus, node.id.clone()))
        };
        let fit = served.nodes(&asked).filter_map(free).max_by(|a, b| a.0.total_cmp(&b.0));
        fit.ok_or_else(|| Rejected::conflict(format!("no node has room for `{fdu}`")))?.1
    };
    define_on(&served, &asked, &fdu, node)
}

fn define_on(served: &Served, asked: &Asked, fdu: &str, node: cotorra_graph::NodeId) -> Answer {
    let mut all = served.all();
    let id = all.define(asked.viewer(), fdu, Some(node), [None, None])?.id.clone();
    let instance = all.instance(asked.viewer(), &id)?;
    let (_, of) = all.descriptor(None, &instance.descriptor)?;
    Ok(Json(fog05::record(instance, of)))
}

async fn instance(State(served): State<Served>, asked: Asked, Path(id): Path<String>) -> Answer {
    let all = served.all();
    let instance = all.instance(asked.viewer(), &id)?;
    let (_, of) = all.descriptor(None, &instance.descriptor)?;
    Ok(Json(fog05::record(instance, of)))
}

async fn undefine(State(served): State<Served>, asked: Asked, Path(id): Path<String>) -> Answer {
    served.all().undefine(asked.viewer(), &id)?;
    Ok(Json(id.into()))
}

async fn configure(State(served): State<Served>, asked: Asked, Path(id): Path<String>) -> Answer {
    served.all().configure(asked.viewer(), &id, served.context.now())?;
    Ok(Json(id.into()))
}

async fn clean(State(served): State<Served>, asked: Asked, Path(id): Path<String>) -> Answer {
    served.all().clean(asked.viewer(), &id, served.context.now())?;
    Ok(Json(id.into()))
}

/// Starts an instance, with the variables in the body: `NAME=VALUE,NAME2=VALUE2`.
async fn start(State(served): State<Served>, asked: Asked, Path(id): Path<String>, body: Bytes) -> Answer {
    let text = |_| LifecycleError::Invalid("the variables are not UTF-8".to_owned());
    let env = String::from_utf8(body.to_vec()).map_err(text)?;
    to_the_end(async move { served.start(&asked, &id, &env, REASON).await.map(|()| Json(id.into())) }).await
}

async fn unpausable() -> Rejected {
    let reason = "a VNF cannot be paused or resumed: stop it, and start it again";
    Rejected { status: StatusCode::NOT_IMPLEMENTED, reason: reason.to_owned() }
}

/// Returns the end of what an instance wrote since its last start.
async fn log(State(served): State<Served>, asked: Asked, Path(id): Path<String>) -> Answer {
    Ok(Json(served.output(&asked, &id).await?.into()))
}

async fn stop(State(served): State<Served>, asked: Asked, Path(id): Path<String>) -> Answer {
    to_the_end(async move { served.stop(&asked, &id, REASON).await.map(|()| Json(id.into())) }).await
}

async fn migrate(
    State(served): State<Served>,
    asked: Asked,
    Path((id, node)): Path<(String, String)>,
) -> Answer {
    let to = served.node(&asked, &node)?.id.clone();
    to_the_end(async move { served.migrate(&asked, &id, to, REASON).await.map(|()| Json(id.into())) }).await
}

/// Returns the nodes on which instances of an FDU are defined.
async fn nodes_of_fdu(State(served): State<Served>, asked: Asked, Path(fdu): Path<String>) -> Answer {
    let by_node = by_node(&served, &asked, &fdu)?;
    Ok(Json(by_node.into_keys().map(Value::from).collect()))
}

/// Returns the instances of an FDU, by node.
async fn instances(State(served): State<Served>, asked: Asked, Path(fdu): Path<String>) -> Answer {
    Ok(Json(json!(by_node(&served, &asked, &fdu)?)))
}

fn by_node(served: &Served, asked: &Asked, fdu: &str) -> Result<BTreeMap<String, Vec<String>>, Rejected> {
    let all = served.all();
    let (id, _) = all.descriptor(asked.viewer(), fdu)?;
    let mut by_node = BTreeMap::<_, Vec<_>>::new();
    for instance in all.instances(asked.viewer()).filter(|instance| instance.descriptor == id) {
        if let Some(node) = &instance.node {
            by_node.entry(node.to_string()).or_default().push(instance.id.clone());
        }
    }
    Ok(by_node)
}

/// Returns the FDUs with instances on a node.
async fn fdus_of_node(State(served): State<Served>, asked: Asked, Path(node): Path<String>) -> Answer {
    let node = &served.node(&asked, &node)?.id;
    let all = served.all();
    let here = all.instances(asked.viewer()).filter(|instance| instance.node.as_ref() == Some(node));
    let fdus: std::collections::BTreeSet<_> = here.map(|instance| instance.descriptor.as_str()).collect();
    Ok(Json(json!(fdus)))
}

async fn networks(State(served): State<Served>, asked: Asked) -> Json<Value> {
    Json(served.all().networks(asked.viewer()).map(Network::record).collect())
}

async fn network(State(served): State<Served>, asked: Asked, Path(network): Path<String>) -> Answer {
    Ok(Json(served.all().network(asked.viewer(), &network)?.record()))
}

/// Reads the descriptor of a network, whose identifier is that of the path.
fn read_network(body: &[u8], uuid: &str) -> Result<NetworkDescriptor, LifecycleError> {
    let descriptor = NetworkDescriptor::read(body)?;
    if descriptor.uuid != uuid {
        let own = descriptor.uuid;
        let reason = format!("the descriptor's `uuid` is `{own}`, and the path's is `{uuid}`");
        return Err(LifecycleError::Invalid(reason));
    }
    Ok(descriptor)
}

async fn add_network(
    State(served): State<Served>,
    asked: Asked,
    Path(network): Path<String>,
    body: Bytes,
) -> Answer {
    let descriptor = read_network(&body, &network)?;
    Ok(Json(served.all().add_network(asked.viewer(), descriptor)?.record()))
}

async fn remove_network(State(served): State<Served>, asked: Asked, Path(network): Path<String>) -> Answer {
    served.all().remove_network(asked.viewer(), &network)?;
    Ok(Json(network.into()))
}

/// Adds a network to a node. A descriptor in the body is added to the catalog first.
async fn connect(
    State(served): State<Served>,
    asked: Asked,
    Path((node, network)): Path<(String, String)>,
    body: Bytes,
) -> Answer {
    let node = served.node(&asked, &node)?.id.clone();
    let mut all = served.all();
    if !body.is_empty() {
        all.add_network(asked.viewer(), read_network(&body, &network)?)?;
    }
    Ok(Json(all.connect(asked.viewer(), &network, node)?.record()))
}

async fn disconnect(
    State(served): State<Served>,
    asked: Asked,
    Path((node, network)): Path<(String, String)>,
) -> Answer {
    let node = &served.node(&asked, &node)?.id;
    Ok(Json(served.all().disconnect(asked.viewer(), &network, node)?.record()))
}
