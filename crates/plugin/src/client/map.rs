//! The map, which walls of a graph need and which the API gives apart.

use std::{io::Read, sync::Arc};

use cotorra_graph::{Cell, HardwareGraph, OccupancyGrid, Position};
use serde::Deserialize;

use super::{Client, ClientError, LARGEST_ANSWER, PATIENCE};

#[derive(Deserialize)]
struct MapBody {
    width: usize,
    height: usize,
    resolution_m: f64,
    origin: Position,
}

impl Client {
    /// Gives the walls of a graph their map. Asks for it only if there are walls.
    pub(super) fn complete_walls(&self, graph: &mut HardwareGraph) -> Result<(), ClientError> {
        if graph.wireless.values().all(|network| network.walls.is_none()) {
            return Ok(());
        }
        let map = Arc::new(self.map()?);
        for walls in graph.wireless.values_mut().filter_map(|network| network.walls.as_mut()) {
            walls.map = Some(Arc::clone(&map));
        }
        Ok(())
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
