//! Errors of an estimate that its scan shows: parts of the scan that disagree about the pose.

use crate::{cluster::Cluster, field::LikelihoodField, scan::Beams};

/// Parts of a scan whose errors count as independent.
const PARTS: usize = 8;
/// Deviations of the pose without a scan, metres and radians. They bound what a scan with little information can show.
const UNKNOWN: [f64; 2] = [0.3, 0.1];

/// Returns the covariance of the pose by which the parts of a scan disagree, in cells; `sigma` is a beam's deviation from
/// the wall, metres.
///
/// The likelihood is only a model: maps, mounts and ranges have errors that it does not know. The pose of greatest
/// likelihood then has the covariance H⁻¹ · Σ gₖ·gₖᵀ · H⁻¹, the sandwich estimator (Huber 1967, White 1982), where gₖ is the
/// gradient of the log-likelihood of part k. H is the scan's information about the pose. Its normals are those of the
/// surfaces that the scan shows (Censi 2007), because the map's cells are too large to have any.
pub(crate) fn covariance(field: &LikelihoodField, beams: &Beams, sigma: f64, about: &Cluster) -> [f64; 9] {
    let resolution = field.resolution();
    let sigma = sigma / resolution;
    let (sin, cos) = about.heading.sin_cos();
    let ends: Vec<(f64, f64)> = beams
        .x
        .iter()
        .zip(&beams.y)
        .map(|(&x, &y)| (f64::from(x), f64::from(y)))
        .map(|(x, y)| (cos * x - sin * y, sin * x + cos * y))
        .collect();
    let [way, turn] = [resolution / UNKNOWN[0], UNKNOWN[1].recip()].map(|root| root * root);
    let mut information = [way, 0.0, 0.0, 0.0, way, 0.0, 0.0, 0.0, turn];
    let mut gradients = [[0.0; 3]; PARTS];
    for (nth, (&(x, y), &weight)) in ends.iter().zip(&beams.weight).enumerate() {
        let weight = f64::from(weight);
        // Change with column, row and heading of what changes so with the end's place.
        let by_pose = |x_part: f64, y_part: f64| [x_part, y_part, x * y_part - y * x_part];
        let at = |dx: f64, dy: f64| f64::from(field.at(about.column + x + dx, about.row + y + dy));
        let slope = by_pose(at(1.0, 0.0) - at(-1.0, 0.0), at(0.0, 1.0) - at(0.0, -1.0));
        let gradient = &mut gradients[nth * PARTS / ends.len()];
        gradient.iter_mut().zip(slope).for_each(|(sum, slope)| *sum += weight * slope / 2.0);
        let (from, to) = (ends[nth.saturating_sub(1)], ends[(nth + 1).min(ends.len() - 1)]);
        let length = (to.0 - from.0).hypot(to.1 - from.1);
        if length > 0.0 {
            let normal = by_pose((from.1 - to.1) / length, (to.0 - from.0) / length);
            let weight = weight * field.hit(at(0.0, 0.0)) / (sigma * sigma);
            for (entry, sum) in information.iter_mut().enumerate() {
                *sum += weight * normal[entry / 3] * normal[entry % 3];
            }
        }
    }
    let inverse = inverse(&information);
    let mut covariance = [0.0; 9];
    for gradient in gradients {
        let pull: [f64; 3] =
            std::array::from_fn(|row| (0..3).map(|k| inverse[row * 3 + k] * gradient[k]).sum());
        for (entry, sum) in covariance.iter_mut().enumerate() {
            *sum += pull[entry / 3] * pull[entry % 3];
        }
    }
    covariance
}

/// Returns the inverse of a symmetric, positive definite matrix.
fn inverse(&[a, b, c, _, d, e, _, _, f]: &[f64; 9]) -> [f64; 9] {
    let first = [d * f - e * e, c * e - b * f, b * e - c * d];
    let determinant = a * first[0] + b * first[1] + c * first[2];
    let [second, mixed, third] = [a * f - c * c, b * c - a * e, a * d - b * b];
    [first[0], first[1], first[2], first[1], second, mixed, first[2], mixed, third]
        .map(|cofactor| cofactor / determinant)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use cotorra_graph::{Cell, OccupancyGrid, Position};

    use super::*;
    use crate::{Parameters, Pose2, Scan};

    /// Returns the covariance in the middle of a room of 6 m × 4 m, if its left wall seems to be `nearer`, metres.
    fn in_a_room(nearer: f64) -> [f64; 9] {
        // The walls have two cells of the map behind them.
        let (width, height) = (126, 86);
        let is_wall = |cell: usize| {
            let (column, row) = (cell % width, cell / width);
            column == 2 || column == width - 3 || row == 2 || row == height - 3
        };
        let cells =
            (0..width * height).map(|cell| if is_wall(cell) { Cell::Occupied } else { Cell::Free }).collect();
        let map = OccupancyGrid::new(width, height, 0.05, Position::new(-3.15, -2.15), cells).unwrap();
        let parameters = Parameters::default();
        let field = LikelihoodField::new(&map, &parameters);
        // Beams end in the middle of the walls' cells.
        let range = |beam: u32| {
            let (sin, cos) = (f64::from(beam) * PI / 60.0 + 0.01 - PI).sin_cos();
            let x = if cos < 0.0 { nearer - 3.025 } else { 3.025 };
            (x / cos).min(2.025 / sin.abs()) as f32
        };
        let ranges: Vec<f32> = (0..120).map(range).collect();
        let scan = Scan {
            angle_min: 0.01 - PI,
            angle_increment: PI / 60.0,
            ranges: &ranges,
            mount: Pose2::default(),
            sweep: Pose2::default(),
        };
        let mut beams = Beams::default();
        beams.take(&scan, &parameters.beams, parameters.weighing);
        beams.x.iter_mut().chain(&mut beams.y).for_each(|end| *end *= 20.0);
        let centre = field.place(Pose2::default());
        let about = Cluster {
            column: centre.column.into(),
            row: centre.row.into(),
            heading: 0.0,
            covariance: [0.0; 9],
            share: 1.0,
        };
        covariance(&field, &beams, parameters.beams.sigma_hit, &about)
    }

    #[test]
    fn a_wall_beside_its_place_on_the_map_widens_the_covariance_across_it() {
        let [fits, off] = [0.0, 0.1].map(in_a_room);
        assert!(off[0] > 4.0 * fits[0] && off[0] > 4.0 * off[4], "{fits:?} {off:?}");
        // The opposite wall holds the robot back: it is off by half of the 0.1 m at most.
        let deviation = 0.05 * off[0].sqrt();
        assert!((0.01..0.06).contains(&deviation), "{deviation} m");
    }

    #[test]
    fn the_inverse_times_the_matrix_is_one() {
        let matrix = [4.0, 1.0, -2.0, 1.0, 3.0, 0.5, -2.0, 0.5, 5.0];
        let inverse = inverse(&matrix);
        for entry in 0..9 {
            let found: f64 = (0..3).map(|k| matrix[entry / 3 * 3 + k] * inverse[k * 3 + entry % 3]).sum();
            let expected = if entry % 4 == 0 { 1.0 } else { 0.0 };
            assert!((found - expected).abs() < 1e-12, "{entry}: {found}");
        }
    }
}
