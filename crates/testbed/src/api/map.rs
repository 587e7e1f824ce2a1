//! The map that robots move on.

use std::sync::Arc;

use axum::{
    Json,
    body::{Body, Bytes},
    extract::State,
    http::header::CONTENT_TYPE,
    response::{IntoResponse, Response},
};
use cotorra_graph::{Cell, OccupancyGrid, Position, Testbed};
use serde::Serialize;

use super::{
    context::{Answer, Context},
    types::Failure,
};

/// The size and the place of a map.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct MapBody {
    /// Cells in a row.
    width: usize,
    /// Rows.
    height: usize,
    /// Side of a cell, metres.
    resolution_m: f64,
    /// The lower left corner of the lower left cell.
    origin: Position,
}

fn grid(testbed: &Testbed) -> Result<&OccupancyGrid, Failure> {
    testbed.map.as_ref().ok_or_else(|| Failure::not_found("this testbed has no map"))
}

impl From<&OccupancyGrid> for MapBody {
    fn from(grid: &OccupancyGrid) -> Self {
        let (width, height) = (grid.width(), grid.height());
        Self { width, height, resolution_m: grid.resolution(), origin: grid.origin() }
    }
}

/// Returns the size and the place of the map.
#[utoipa::path(get, path = "/api/v1/map", tag = "robots",
    responses((status = 200, body = MapBody)))]
pub(super) async fn map(State(context): State<Context>) -> Answer<MapBody> {
    Ok(Json(grid(&context.testbed)?.into()))
}

/// Returns the map as a picture: PGM, with a byte for each cell, the uppermost row first. 0 is occupied, 254 free and 205
/// unknown, as ROS's map_server writes it.
#[utoipa::path(get, path = "/api/v1/map/image", tag = "robots",
    responses((status = 200, body = String, content_type = "image/x-portable-graymap")))]
pub(super) async fn image(State(context): State<Context>) -> Result<Response, Failure> {
    picture(context.testbed)
}

/// Returns the map of a testbed as a picture.
pub(super) fn picture(testbed: Arc<Testbed>) -> Result<Response, Failure> {
    let (width, height) = grid(&testbed).map(|grid| (grid.width(), grid.height()))?;
    let head = Bytes::from(format!("P5\n{width} {height}\n255\n"));
    // Row by row, so that a large map is in memory only once.
    let rows = (0..height).rev().map(move |row| {
        let grid = grid(&testbed).map_err(|_| "a map does not vanish")?;
        Ok((0..width).map(|column| shade(grid.cell(column, row))).collect::<Bytes>())
    });
    let parts = tokio_stream::iter(std::iter::once(Ok::<_, &str>(head)).chain(rows));
    Ok(([(CONTENT_TYPE, "image/x-portable-graymap")], Body::from_stream(parts)).into_response())
}

fn shade(cell: Cell) -> u8 {
    match cell {
        Cell::Free => 254,
        Cell::Occupied => 0,
        Cell::Unknown => 205,
    }
}
