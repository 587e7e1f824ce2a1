//! Time of a filter update. `cargo bench -p cotorra-localization`

use std::{f64::consts::PI, sync::Arc};

use cotorra_graph::{Cell, OccupancyGrid, Position};
use cotorra_localization::{LikelihoodField, Localizer, Parameters, Pose2, Scan, Weighing};
use cotorra_robot_middleware::World;
use divan::{Bencher, black_box};

fn main() {
    divan::main();
}

/// Rooms of 6 m × 5 m along a corridor, on a map of 60 m × 40 m in cells of 0.05 m.
fn office() -> OccupancyGrid {
    let (width, height) = (1200, 800);
    let wall = |row: usize, column: usize| {
        let beside = row.abs_diff(400) == 20;
        let door = column % 120 > 50 && column % 120 < 70;
        let between = column.is_multiple_of(120) && row.abs_diff(400) > 20;
        (beside && !door)
            || between
            || row.is_multiple_of(799)
            || column == width - 1
            || row.abs_diff(400) == 120
    };
    let cells = (0..width * height)
        .map(|i| if wall(i / width, i % width) { Cell::Occupied } else { Cell::Free })
        .collect();
    OccupancyGrid::new(width, height, 0.05, Position::default(), cells).expect("the numbers agree")
}

/// Fixes the number of particles at 1,000, regardless of KLD-sampling.
fn fixed(parameters: Parameters) -> Parameters {
    Parameters { min_particles: 1000, max_particles: 1000, ..parameters }
}

/// One update of a robot that drives along the corridor: motion, 120 beams, weights, estimate and resampling.
#[divan::bench(args = ["likelihood", "amcl"])]
fn update_of_1000_particles_with_120_beams(bencher: Bencher<'_, '_>, mode: &str) {
    let mut parameters = fixed(if mode == "amcl" { Parameters::amcl() } else { Parameters::default() });
    parameters.beams.range_max = 12.0;
    assert_eq!(parameters.weighing == Weighing::Amcl, mode == "amcl");
    let map = office();
    let world = World::new(&map);
    let seen: Vec<(Pose2, Vec<f32>)> = (0..150)
        .map(|step| {
            let pose = Pose2::new(10.0 + 0.26 * f64::from(step), 20.0, 0.1 * (f64::from(step) * 0.3).sin());
            let from = Position::new(pose.x, pose.y);
            // 120 beams, 3° apart.
            let range = |beam: usize| {
                let (sin, cos) = (pose.heading + beam as f64 * PI / 60.0 - PI).sin_cos();
                world.cast(from, (cos, sin), 11.9).map_or(11.9, |range| range) as f32
            };
            (pose, (0..120).map(range).collect())
        })
        .collect();
    let field = Arc::new(LikelihoodField::new(&map, &parameters));
    let start = || {
        Localizer::at(
            Arc::clone(&field),
            parameters,
            1,
            seen[0].0,
            &[0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01],
        )
        .expect("a pose")
    };
    let mut localizer = start();
    let mut step = 0;
    bencher.bench_local(|| {
        if step == seen.len() {
            (localizer, step) = (start(), 0);
        }
        let (pose, ranges) = &seen[step];
        step += 1;
        let scan = Scan {
            angle_min: -PI,
            angle_increment: PI / 60.0,
            ranges,
            mount: Pose2::default(),
            sweep: Pose2::default(),
        };
        let estimate = localizer.observe(black_box(*pose), &scan).expect("a pose");
        assert!(estimate.updated);
        estimate
    });
}

#[divan::bench]
fn prepare_a_map_of_a_million_cells(bencher: Bencher<'_, '_>) {
    let map = office();
    bencher.bench_local(|| LikelihoodField::new(black_box(&map), &Parameters::default()));
}
