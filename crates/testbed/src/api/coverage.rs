//! Places at which radio units are heard.

use axum::{Extension, Json, extract::State};
use cotorra_graph::{Dbm, HardwareGraph, Node, NodeId, RadioUnit};
use serde::{Deserialize, Serialize};

use super::{
    auth::Caller,
    context::{Answer, Context},
    types::{Failure, Query},
};

/// Difference between the signals of two circles, dB.
const STEP_DB: f64 = 10.0;
/// Strongest signal of a circle.
const STRONGEST: Dbm = Dbm(-40.0);

/// The floor on which coverage is asked for.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Floor {
    /// Its height, metres; 0 by default.
    #[serde(default)]
    z: f64,
}

/// Mean signal around a radio unit: by path loss alone, without walls, shadowing and fading.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct CoverageBody {
    radio_unit: NodeId,
    /// The strongest signal first. The last is the weakest that the network's standard can use.
    circles: Vec<CircleBody>,
}

/// A circle around a radio unit, inside which its mean signal is stronger.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct CircleBody {
    #[serde(rename = "signal_dbm")]
    signal: Dbm,
    /// Metres, on the floor.
    radius_m: f64,
}

/// Returns the mean signal around each radio unit as circles on a floor. It is by path loss alone: walls, shadowing and
/// fading are left out. Radio units without a position are left out, too.
#[utoipa::path(get, path = "/api/v1/network/coverage", tag = "network",
    params(Floor), responses((status = 200, body = Vec<CoverageBody>)))]
pub(super) async fn coverage(
    State(context): State<Context>,
    Extension(caller): Extension<Caller>,
    Query(Floor { z }): Query<Floor>,
) -> Answer<Vec<CoverageBody>> {
    if !z.is_finite() {
        return Err(Failure::bad_request("`z` is a number"));
    }
    let testbed = caller.view.as_ref().map_or(&*context.testbed, |view| view.testbed());
    let graph = &testbed.graph;
    Ok(Json(graph.radio_units().filter_map(|(node, unit)| around(graph, node, unit, z)).collect()))
}

fn around(graph: &HardwareGraph, node: &Node, unit: &RadioUnit, z: f64) -> Option<CoverageBody> {
    let (network, position) = (graph.wireless.get(&unit.network)?, node.position?);
    let above = position.z - z;
    let circle = |signal: Dbm| {
        let range = network.range_m(unit, signal);
        let radius_m = (range * range - above * above).max(0.0).sqrt();
        (radius_m > 0.0).then_some(CircleBody { signal, radius_m })
    };
    let weakest = cotorra_fabric::sensitivity(network);
    let steps = std::iter::successors(Some(STRONGEST.0), |dbm| Some(dbm - STEP_DB));
    let signals = steps.take_while(|dbm| *dbm > weakest.0).chain([weakest.0]);
    let circles = signals.filter_map(|dbm| circle(Dbm(dbm))).collect();
    Some(CoverageBody { radio_unit: node.id.clone(), circles })
}
