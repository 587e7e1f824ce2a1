//! The map, which walls of a graph need and which the API gives apart.

use std::{collections::BTreeMap, io::Read, sync::Arc};

use cotorra_graph::{Cell, HardwareGraph, OccupancyGrid, Position, WallLoss, Walls};
use serde::{Deserialize, Deserializer, de::Error};
use serde_json::Value;

use super::{Client, ClientError, LARGEST_ANSWER, PATIENCE};

#[derive(Deserialize)]
struct MapBody {
    width: usize,
    height: usize,
    resolution_m: f64,
    origin: Position,
}

/// A graph as the API gives it: without walls, whose losses stand beside it by the names of their networks.
pub(super) struct GraphBody {
    open: HardwareGraph,
    losses: BTreeMap<String, WallLoss>,
}

impl<'de> Deserialize<'de> for GraphBody {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut json = Value::deserialize(deserializer)?;
        let mut losses = BTreeMap::new();
        let networks = json.get_mut("wireless").and_then(Value::as_object_mut);
        for (name, network) in networks.into_iter().flatten() {
            if let Some(walls) = network.as_object_mut().and_then(|network| network.remove("walls")) {
                losses.insert(name.clone(), serde_json::from_value(walls).map_err(D::Error::custom)?);
            }
        }
        Ok(Self { open: serde_json::from_value(json).map_err(D::Error::custom)?, losses })
    }
}

impl Client {
    /// Gives a graph its walls. Asks for their map only if there are any.
    pub(super) fn walled(&self, GraphBody { open, losses }: GraphBody) -> Result<HardwareGraph, ClientError> {
        let mut graph = open;
        if !losses.is_empty() {
            let map = Arc::new(self.map()?);
            for (name, loss) in losses {
                if let Some(network) = graph.wireless.get_mut(&name) {
                    network.walls = Some(Walls { loss, map: Arc::clone(&map) });
                }
            }
        }
        Ok(graph)
    }

    fn map(&self) -> Result<OccupancyGrid, ClientError> {
        let MapBody { width, height, resolution_m, origin } = self.get("map", &[])?;
        let url = self.url("map/image");
        let request = self.identify(self.agent.get(&url)).config().timeout_global(Some(PATIENCE)).build();
        let answer = self.answer(&url, request.call())?.into_body().into_reader();
        let mut picture = Vec::new();
        let read = answer.take(LARGEST_ANSWER).read_to_end(&mut picture);
        let malformed = |reason: String| ClientError::Malformed { url: url.clone(), reason };
        read.map_err(|error| malformed(error.to_string()))?;
        cells(&picture, width, height)
            .and_then(|cells| OccupancyGrid::new(width, height, resolution_m, origin, cells))
            .ok_or_else(|| malformed(format!("not a PGM picture of {width} by {height} cells")))
    }
}

/// Reads the cells of a PGM picture as the API writes it, the uppermost row first. Returns them from the lower left.
fn cells(picture: &[u8], width: usize, height: usize) -> Option<Vec<Cell>> {
    let pixels = picture.strip_prefix(format!("P5\n{width} {height}\n255\n").as_bytes())?;
    if width == 0 || width.checked_mul(height) != Some(pixels.len()) {
        return None;
    }
    let cell = |shade: &u8| match shade {
        0 => Cell::Occupied,
        254 => Cell::Free,
        _ => Cell::Unknown,
    };
    Some(pixels.chunks_exact(width).rev().flatten().map(cell).collect())
}
