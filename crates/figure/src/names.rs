//! Names of spots in a plot: each beside its spot, where it hides nothing.

use crate::{
    font,
    geometry::{Point, Rect},
    scene::{Anchor, Scene},
    style::{BLACK, SMALL, WHITE},
};

/// Room between a spot and its name, points: the nearest that is free is taken.
const APART: [f64; 3] = [4.5, 8.0, 12.0];
/// Half of the room that a spot needs, points.
const SPOT: f64 = 3.5;
/// Spots that are nearer than this share a name, points.
const SAME: f64 = 4.0;
/// White room around a name, points.
const PLATE: f64 = 0.8;
/// Room between a name and lines, points.
const ROOM: f64 = 1.6;

/// Draws names on white plates inside a plot, beside walls if there is room. A name without a free place near its spot is
/// left out.
pub(crate) fn draw(
    scene: &mut Scene,
    plot: &Rect,
    spots: &[(Point, &str)],
    lines: &[Vec<Point>],
    walls: &[Rect],
) {
    let mut groups: Vec<(Point, String)> = Vec::new();
    for ((x, y), name) in spots {
        match groups.iter_mut().find(|((near_x, near_y), _)| (near_x - x).hypot(near_y - y) < SAME) {
            Some((_, names)) => *names += &format!(", {name}"),
            None => groups.push(((*x, *y), (*name).to_owned())),
        }
    }
    let around = |(x, y): Point| Rect { left: x, top: y, right: x, bottom: y }.grown(SPOT);
    let begins = lines.iter().filter_map(|line| line.first());
    let mut taken: Vec<Rect> = spots.iter().map(|(at, _)| at).chain(begins).map(|at| around(*at)).collect();
    for (at, name) in groups {
        let is_free = |plate: &Rect| {
            let wide = plate.grown(ROOM);
            let is_inside = plate.left >= plot.left + 1.0
                && plate.right <= plot.right - 1.0
                && plate.top >= plot.top + 1.0
                && plate.bottom <= plot.bottom - 1.0;
            is_inside
                && !taken.iter().any(|other| other.overlaps(plate))
                && !lines.iter().any(|line| wide.is_crossed(line))
        };
        let hides_no_wall = |plate: &Rect| !walls.iter().any(|wall| wall.overlaps(plate));
        let free = || plates(at, &name).filter(is_free);
        if let Some(plate) = free().find(hides_no_wall).or_else(|| free().next()) {
            scene.area(plate.corners(), WHITE);
            let baseline = plate.bottom - PLATE - font::DESCENT * SMALL;
            scene.text((plate.left + PLATE, baseline), &name, SMALL, Anchor::Start, BLACK);
            taken.push(plate);
        }
    }
}

/// Returns the places of a name around its spot, from the best to the worst.
fn plates((x, y): Point, name: &str) -> impl Iterator<Item = Rect> {
    let width = font::width(name, SMALL) + 2.0 * PLATE;
    let height = (font::ASCENT + font::DESCENT) * SMALL + 2.0 * PLATE;
    // Right, left, above and below, then the corners.
    const SIDES: [(f64, f64); 8] = [
        (1.0, 0.0),
        (-1.0, 0.0),
        (0.0, -1.0),
        (0.0, 1.0),
        (0.8, -0.8),
        (-0.8, -0.8),
        (0.8, 0.8),
        (-0.8, 0.8),
    ];
    APART.into_iter().flat_map(move |apart| {
        SIDES.into_iter().map(move |(right, down)| {
            let along =
                |to: f64, size: f64| to * apart + (to.signum() * f64::from(to != 0.0) - 1.0) * size / 2.0;
            let (left, top) = (x + along(right, width), y + along(down, height));
            Rect { left, top, right: left + width, bottom: top + height }
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Item;

    const PLOT: Rect = Rect { left: 0.0, top: 0.0, right: 100.0, bottom: 60.0 };

    fn names(spots: &[(Point, &str)], lines: &[Vec<Point>]) -> Vec<(String, Rect)> {
        names_beside(&[], spots, lines)
    }

    fn names_beside(walls: &[Rect], spots: &[(Point, &str)], lines: &[Vec<Point>]) -> Vec<(String, Rect)> {
        let mut scene = Scene { height: 60.0, ..Scene::new() };
        draw(&mut scene, &PLOT, spots, lines, walls);
        assert_eq!(scene.collisions(), Vec::<String>::new());
        let text = |item: &Item| match item {
            Item::Text(text) => Some((text.text.clone(), text.bounds())),
            _ => None,
        };
        scene.items.iter().filter_map(text).collect()
    }

    #[test]
    fn names_stand_beside_their_spots() {
        let [(name, bounds)] = &names(&[((50.0, 30.0), "R1")], &[])[..] else { panic!("one name") };
        assert_eq!(name, "R1");
        assert!((bounds.left - 55.3).abs() < 1e-9 && bounds.top < 30.0 && bounds.bottom > 30.0, "{bounds:?}");
        let [(_, at_the_edge)] = &names(&[((97.0, 30.0), "R1")], &[])[..] else { panic!("one name") };
        assert!(at_the_edge.right < 97.0, "{at_the_edge:?}");
    }

    #[test]
    fn names_avoid_lines_and_each_other() {
        let line = vec![(0.0, 30.0), (100.0, 30.0)];
        let spots = [((50.0, 30.0), "R1"), ((58.0, 30.0), "R2"), ((66.0, 30.0), "R3")];
        let named = names(&spots, std::slice::from_ref(&line));
        assert_eq!(named.len(), 3);
        assert!(named.iter().all(|(_, bounds)| !bounds.is_crossed(&line)), "{named:?}");
    }

    #[test]
    fn names_hide_walls_only_without_another_place() {
        let spot = [((50.0, 30.0), "R1")];
        let wall = Rect { left: 56.0, top: 0.0, right: 58.0, bottom: 60.0 };
        let beside = names_beside(&[wall], &spot, &[]);
        assert!(beside[0].1.right < 50.0, "{beside:?}");
        let everywhere = names_beside(&[PLOT], &spot, &[]);
        assert_eq!(everywhere, names(&spot, &[]));
    }

    #[test]
    fn spots_at_one_place_share_a_name_and_names_without_room_are_left_out() {
        let together = names(&[((50.0, 30.0), "R1"), ((51.0, 30.0), "R2")], &[]);
        assert_eq!(together[0].0, "R1, R2");
        assert_eq!(together.len(), 1);
        assert_eq!(names(&[((50.0, 30.0), &"R".repeat(40))], &[]), []);
    }
}
