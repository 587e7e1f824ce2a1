use super::*;
use crate::{
    format::Format,
    scene::{Item, Line},
};

fn sample(x: f64, y: f64) -> Sample {
    Sample { x, y, range: None }
}

fn series(name: &str, kind: SeriesKind, points: &[(f64, f64)]) -> Series {
    let parts = vec![points.iter().map(|(x, y)| sample(*x, *y)).collect()];
    Series { name: name.to_owned(), kind, look: None, parts }
}

/// A panel with everything: long bands, short bands, spikes above the axis, a target and missing values.
fn panel(title: &str) -> Panel {
    let band = |from, to, name: &str| Band { from, to, name: name.to_owned() };
    let spikes: Vec<_> = (0..400).map(|i| (f64::from(i), if i % 40 == 0 { 90.0 } else { 11.0 })).collect();
    Panel {
        title: title.to_owned(),
        x: Axis::around("time (s)", 0.0, 400.0),
        y: Axis::around("service time (ms)", 0.0, 38.0),
        bands: vec![band(0.0, 150.0, "R1"), band(150.0, 152.0, "a-unit-in-the-yard"), band(152.0, 400.0, "")],
        level: Some(Level { at: 15.0, name: "target 15 ms".to_owned() }),
        upright: None,
        series: vec![series("service time", SeriesKind::Dense, &spikes)],
        missing: ("no answer".to_owned(), vec![10.0, 10.1, 200.0]),
    }
}

fn lines(scene: &Scene, colour: Colour) -> Vec<&Line> {
    let lines = scene.items.iter().filter_map(|item| match item {
        Item::Line(line) if line.colour == colour => Some(line),
        _ => None,
    });
    lines.collect()
}

fn texts(scene: &Scene) -> Vec<&str> {
    let texts = scene.items.iter().filter_map(|item| match item {
        Item::Text(text) => Some(text.text.as_str()),
        _ => None,
    });
    texts.collect()
}

#[test]
fn no_text_collides_with_another_or_with_a_line() {
    for count in [1, 2, 3, 12, 13] {
        let panels = (0..count).map(|i| panel(&format!("robot-{i}: navigation"))).collect();
        let title = "corridor: service time and attachment ".repeat(count);
        let scene = Figure { title, panels, data: "service_time.csv".to_owned() }.draw();
        assert_eq!(scene.collisions(), Vec::<String>::new(), "{count}");
    }
}

#[test]
fn panels_are_bounded_and_a_note_counts_the_rest() {
    let panels = (0..30).map(|i| panel(&format!("robot-{i}"))).collect();
    let scene = Figure { panels, data: "service_time.csv".to_owned(), ..Figure::default() }.draw();
    let texts = texts(&scene);
    assert!(texts.contains(&"robot-11") && !texts.contains(&"robot-12"), "{texts:?}");
    assert!(texts.contains(&"12 of 30 panels; service_time.csv has all"), "{texts:?}");
}

#[test]
fn letters_are_legible_in_a_column_of_a_paper() {
    let scene = Figure { title: "run".to_owned(), panels: vec![panel("robot")], ..Figure::default() }.draw();
    for item in &scene.items {
        let Item::Text(text) = item else { continue };
        assert!(text.size >= 6.5, "{text:?}");
    }
    assert!((WIDTH / 72.0 * 2.54 - 8.5).abs() < 0.01);
}

#[test]
fn names_of_bands_are_in_the_strip_or_else_in_the_legend() {
    let scene = Figure { panels: vec![panel("robot")], ..Figure::default() }.draw();
    let texts = texts(&scene);
    let count = |name| texts.iter().filter(|text| **text == name).count();
    assert_eq!((count("R1"), count("a-unit-in-the-yard"), count("no answer")), (1, 1, 1), "{texts:?}");
    let mut roomy = panel("robot");
    roomy.bands.truncate(1);
    let scene = Figure { panels: vec![roomy], ..Figure::default() }.draw();
    assert!(!self::texts(&scene).contains(&"a-unit-in-the-yard"));
}

#[test]
fn spikes_end_at_the_top_of_the_plot() {
    let scene = Figure { panels: vec![panel("robot")], ..Figure::default() }.draw();
    let data: Vec<_> = lines(&scene, SERIES[0]).into_iter().filter(|line| line.width == FINE).collect();
    assert!(data.len() > 5, "spikes leave the plot: {}", data.len());
    let ys = || data.iter().flat_map(|line| &line.points).map(|point| point.1);
    let (top, bottom) = (ys().fold(f64::INFINITY, f64::min), ys().fold(0.0, f64::max));
    assert!(bottom - top <= 96.0 && top > 20.0, "{top} {bottom}");
}

#[test]
fn a_colour_of_several_names_has_them_all_in_the_legend() {
    // There are seven colours. The last two bands are too narrow for their names.
    let band =
        |i: u32| Band { from: f64::from(i) * 50.0, to: f64::from(i + 1) * 50.0, name: format!("R{i}") };
    let narrow =
        |i: u32| Band { from: 349.0 + f64::from(i), to: 350.0 + f64::from(i), name: format!("R{i}") };
    let bands = (0..7).map(band).chain([narrow(7), narrow(8)]).collect();
    let scene = Figure { panels: vec![Panel { bands, ..panel("robot") }], ..Figure::default() }.draw();
    let texts = texts(&scene);
    assert!(texts.contains(&"R0 or R7") && texts.contains(&"R1 or R8"), "{texts:?}");
    assert!(!texts.contains(&"R7") && texts.contains(&"R1"), "{texts:?}");
}

fn areas(scene: &Scene, colour: Colour) -> Vec<&[Point]> {
    let areas = scene.items.iter().filter_map(|item| match item {
        Item::Area(points, of) if *of == colour => Some(points.as_slice()),
        _ => None,
    });
    areas.collect()
}

#[test]
fn values_above_the_axis_are_marked_and_the_legend_has_the_highest() {
    let marks = |top: f64| {
        let panel = Panel { y: Axis::around("service time (ms)", 0.0, top), ..panel("robot") };
        let scene = Figure { panels: vec![panel], ..Figure::default() }.draw();
        assert_eq!(scene.collisions(), Vec::<String>::new());
        let legend = texts(&scene)
            .iter()
            .find_map(|text| text.strip_prefix("above the axis: up to "))
            .map(str::to_owned);
        (areas(&scene, SERIES[0]).len(), legend)
    };
    assert_eq!(marks(38.0), (10, Some("90".to_owned())));
    assert_eq!(marks(90.0), (0, None));
}

#[test]
fn values_above_the_axis_are_written_with_three_digits() {
    assert_eq!([155.3, 1234.5, 15.53, 15.0, 0.123].map(short), ["155", "1235", "15.5", "15", "0.12"]);
}

#[test]
fn names_of_narrow_bands_stand_over_their_ends_where_there_is_room() {
    let band = |from: f64, to: f64, name: &str| Band { from, to, name: name.to_owned() };
    let named = |bands: Vec<Band>| {
        let scene = Figure { panels: vec![Panel { bands, ..panel("robot") }], ..Figure::default() }.draw();
        assert_eq!(scene.collisions(), Vec::<String>::new());
        let in_strip =
            |text: &&crate::scene::Text| text.anchor == Anchor::Middle && text.text.starts_with('R');
        let texts = scene.items.iter().filter_map(|item| match item {
            Item::Text(text) => Some(text),
            _ => None,
        });
        texts.filter(in_strip).map(|text| text.text.clone()).collect::<Vec<_>>()
    };
    // The walk begins and ends near R1.
    let there_and_back = vec![band(0.0, 14.0, "R1"), band(14.0, 391.0, "R2"), band(391.0, 400.0, "R1")];
    assert_eq!(named(there_and_back), ["R2", "R1", "R1"]);
    // Of two neighbours without room for both, the first is named.
    let neighbours = vec![band(0.0, 200.0, "R2"), band(200.0, 211.0, "R1"), band(211.0, 222.0, "R3")];
    assert_eq!(named(neighbours), ["R2", "R1"]);
}

#[test]
fn series_on_the_same_values_are_all_visible() {
    let points = [(1.0, 20.0), (2.0, 20.0), (3.0, 20.0)];
    for count in 2..=MAX_SERIES {
        let series = (0..count).map(|i| series(&format!("s{i}"), SeriesKind::Marked, &points)).collect();
        let values = [1, 2, 3].map(|i| (f64::from(i), i.to_string()));
        let panel = Panel {
            x: Axis::values("delay scale", &values),
            y: Axis::around("ms", 0.0, 25.0),
            series,
            ..Panel::default()
        };
        let scene = Figure { panels: vec![panel], ..Figure::default() }.draw();
        assert_eq!(scene.collisions(), Vec::<String>::new());
        let mut markers: Vec<Rect> = Vec::new();
        for colour in SERIES.iter().take(count) {
            let its = lines(&scene, *colour);
            let joined = its.iter().filter(|line| line.width == BOLD && line.points.len() == 3);
            assert_eq!(joined.count(), 1);
            // The first outline of a marker is the legend's.
            for line in its.iter().filter(|line| line.width == 0.7).skip(1) {
                let of = |of: fn(&Point) -> f64, fold: fn(f64, f64) -> f64, from| {
                    line.points.iter().map(of).fold(from, fold)
                };
                markers.push(Rect {
                    left: of(|p| p.0, f64::min, f64::INFINITY),
                    right: of(|p| p.0, f64::max, 0.0),
                    top: of(|p| p.1, f64::min, f64::INFINITY),
                    bottom: of(|p| p.1, f64::max, 0.0),
                });
            }
        }
        assert_eq!(markers.len(), 3 * count);
        markers.sort_by(|a, b| a.left.total_cmp(&b.left));
        // Each marker shows at least a part as wide as an outline.
        assert!(markers.windows(2).all(|pair| pair[1].left - pair[0].left > 0.7), "{count}: {markers:?}");
    }
}

#[test]
fn further_series_are_counted_in_a_note() {
    let series = (0..11).map(|i| series(&format!("s{i}"), SeriesKind::Marked, &[(1.0, 1.0)])).collect();
    let panel =
        Panel { y: Axis::around("ms", 0.0, 1.0), x: Axis::around("n", 0.0, 2.0), series, ..Panel::default() };
    let scene = Figure { panels: vec![panel], data: "cells.csv".to_owned(), ..Figure::default() }.draw();
    assert!(texts(&scene).contains(&"8 of 11 lines; cells.csv has all"), "{:?}", texts(&scene));
}

#[test]
fn values_that_are_no_numbers_are_left_out() {
    let points = [(0.0, 1.0), (1.0, f64::NAN), (2.0, f64::INFINITY), (3.0, 2.0)];
    use SeriesKind::*;
    let kinds = [Faint, Dense, Line, Range, Marked];
    let panel = Panel {
        x: Axis::around("s", 0.0, f64::NAN),
        y: Axis::around("ms", 0.0, 3.0),
        series: kinds.map(|kind| series("", kind, &points)).into(),
        ..Panel::default()
    };
    let scene = Figure { panels: vec![panel, Panel::default()], ..Figure::default() }.draw();
    let svg = String::from_utf8(scene.render(Format::Svg)).unwrap();
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
}

#[test]
fn the_same_figure_has_the_same_bytes_in_every_format() {
    let draw =
        || Figure { title: "run".to_owned(), panels: vec![panel("robot")], ..Figure::default() }.draw();
    for format in Format::ALL {
        let bytes = draw().render(format);
        assert!(bytes == draw().render(format) && bytes.len() > 1000, "{format}");
    }
}

#[test]
fn faint_lines_are_pale_and_lie_behind_later_series() {
    let points = [(0.0, 1.0), (1.0, 2.0)];
    let all = Series { look: Some(1), ..series("all", SeriesKind::Faint, &points) };
    let some = Series { look: Some(1), ..series("some", SeriesKind::Dense, &points) };
    let panel = Panel { y: Axis::around("ms", 0.0, 2.0), series: vec![all, some], ..Panel::default() };
    let scene = Figure { panels: vec![panel], ..Figure::default() }.draw();
    let (pale, full) = (SERIES[1].lighter(LIGHT), SERIES[1]);
    let looks = scene.items.iter().filter_map(|item| match item {
        Item::Line(line) if [pale, full].contains(&line.colour) => Some((line.colour, line.width)),
        _ => None,
    });
    let looks: Vec<_> = looks.collect();
    // The legend has a sample of each, then the plot has both lines.
    assert_eq!(looks, [(pale, WIDE), (full, BOLD), (pale, WIDE), (full, FINE)]);
}

#[test]
fn a_level_of_the_horizontal_axis_stands_upright_at_its_value() {
    let with_upright = |at| {
        let panel = Panel {
            x: Axis::logarithmic("service time (ms)", 5.0, 200.0),
            y: Axis::logarithmic("samples above (%)", 0.01, 100.0),
            upright: Some(Level { at, name: "target".to_owned() }),
            ..Panel::default()
        };
        Figure { panels: vec![panel], ..Figure::default() }.draw()
    };
    let scene = with_upright(15.0);
    assert_eq!(scene.collisions(), Vec::<String>::new());
    assert!(texts(&scene).contains(&"target"));
    let dashed: Vec<_> =
        lines(&scene, ALERT).into_iter().filter(|line| line.points[0].0 == line.points[1].0).collect();
    let [line] = dashed[..] else { panic!("one upright line: {dashed:?}") };
    let axis = lines(&scene, crate::style::AXIS);
    let across = |x: f64| axis.iter().any(|tick| tick.points.iter().all(|point| point.0 < x));
    assert!(line.points[0].1 > line.points[1].1 && across(line.points[0].0), "{line:?}");
    let beyond = with_upright(500.0);
    assert!(lines(&beyond, ALERT).iter().all(|line| line.points[0].0 != line.points[1].0));
}

#[test]
fn a_distribution_rises_at_each_value_and_counts_values_without_a_step() {
    let steps: Vec<_> =
        shares_up_to(vec![4.0, f64::INFINITY, 2.0, 4.0]).iter().map(|step| (step.x, step.y)).collect();
    assert_eq!(
        steps,
        [(0.0, 0.0), (2.0, 0.0), (2.0, 25.0), (4.0, 25.0), (4.0, 50.0), (4.0, 50.0), (4.0, 75.0)]
    );
    assert_eq!(shares_up_to(Vec::new()).len(), 1);
}
