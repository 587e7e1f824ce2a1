use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Candidate, DelayFigure, Direction, FigureSource, HardwareGraph, LinkContext, LinkId, NodeId, NodeKind,
    RobotContext, WirelessNetwork, candidates,
};
use cotorra_graph_testing as base;

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Three robots in a network whose frames take 1 ms.
fn graph() -> HardwareGraph {
    let robots = ["r", "q", "p"].map(|robot| base::node(robot, NodeKind::Robot(base::robot("lab"))));
    let mut graph = base::graph(robots.to_vec(), Vec::new());
    let network = WirelessNetwork { delay: ms(1), ..base::wireless() };
    graph.wireless.insert("lab".to_owned(), network);
    graph
}

/// Returns the candidates of `r`, which is attached to `U` and hears `V` and `W`. `q` and `p` are at `V`.
fn of(measured: &[(&str, u64, u64)]) -> Vec<Candidate> {
    let attachments = [("U", true), ("V", false), ("W", false)];
    let attachments = attachments.map(|(unit, attached)| base::attachment(unit, attached, None)).to_vec();
    let context = RobotContext { attachments, ..base::robot_context("r", base::pose(0.0, 0.0, 0.0)) };
    let link = |&(name, delay, age): &(&str, u64, u64)| {
        let delay = Some(ms(delay));
        (base::id::<LinkId>(name), (LinkContext { delay, ..base::link_context(name) }, ms(age)))
    };
    let links: BTreeMap<_, _> = measured.iter().map(link).collect();
    let [r, q, p, at_u, at_v] = ["r", "q", "p", "U", "V"].map(base::id::<NodeId>);
    let stations = [(&r, &at_u), (&q, &at_v), (&p, &at_v)];
    candidates(&context, &graph(), &stations, |link, direction| {
        let (context, age) = links.get(link)?;
        (direction == Direction::Forward).then_some((context, *age))
    })
}

#[test]
fn the_own_radio_unit_is_measured_and_others_are_estimated_from_their_stations() {
    let candidates = of(&[("r~U", 7, 100), ("q~V", 10, 0), ("p~V", 20, 500)]);
    let uplinks: Vec<_> = candidates.iter().map(|candidate| candidate.uplink).collect();
    let expected = [
        DelayFigure { delay: ms(7), age: ms(1100), source: FigureSource::Carried },
        DelayFigure { delay: ms(15), age: ms(1500), source: FigureSource::Estimated },
        DelayFigure::configured(ms(1)),
    ];
    assert_eq!(uplinks, expected);
    assert!(candidates.iter().all(|candidate| candidate.downlink == DelayFigure::configured(ms(1))));
}

#[test]
fn the_configured_delay_is_the_least_and_old_contexts_do_not_count() {
    let candidates = of(&[("r~U", 7, 9001), ("q~V", 0, 0)]);
    assert_eq!(candidates[0].uplink.source, FigureSource::Configured);
    let estimated = DelayFigure { delay: ms(1), age: ms(1000), source: FigureSource::Estimated };
    assert_eq!(candidates[1].uplink, estimated);
}
