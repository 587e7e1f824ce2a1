//! The table of `cotorra link show`, which fits a terminal of 80 columns for links with delay and rate.

use std::time::Duration;

use cotorra_graph::{
    DelayFigure, Direction, FigureSource, LinkContext, LinkFigures, Probed, Scale, ThroughputFigure,
};

use crate::{
    table::Table,
    words::{ago, millis},
};

/// Age from which results of probes are shown with it.
const OLD: Duration = Duration::from_secs(10);

/// Lists both directions of links, and below them their queues and the results of their last tests.
pub fn table(links: &[LinkContext]) -> String {
    let mut table = Table::new("<<>>>><");
    table.row(["link", "", "d, ms", "λ, Mbit/s", "probed, ms", "lost", "conditions"]);
    let (mut queues, mut tests) = (String::new(), String::new());
    for context in links {
        let arrow = arrow(context.direction);
        let probed = context.probed.as_ref();
        table.row([
            context.link.to_string(),
            arrow.to_owned(),
            context.delay.map_or("-".to_owned(), millis),
            format!("{:.3}", context.throughput_bps / 1e6),
            probed.and_then(delay).unwrap_or("-".to_owned()),
            probed.and_then(loss).unwrap_or("-".to_owned()),
            context.effective.text() + &scale(context.scale),
        ]);
        if let Some(packets @ 1..) = context.queued_packets {
            let s = if packets == 1 { "" } else { "s" };
            queues += &format!(
                "{} {arrow} had up to {packets} packet{s} in its queue over the last second\n",
                context.link
            );
        }
        if let Some(tested) = &context.tested {
            tests += &format!(
                "{} {arrow} carried {:.3} of {:.3} Mbit/s in a test {}\n",
                context.link,
                tested.throughput_bps / 1e6,
                tested.offered_bps / 1e6,
                ago(tested.age)
            );
        }
    }
    table.render("") + &queues + &tests
}

/// Lists the figures of both directions of links that decisions count with.
pub fn figures(links: &[LinkContext]) -> String {
    let mut table = Table::new("<<>>>>>");
    table.row(["link", "", "d, ms", "measured", "λ, Mbit/s", "measured", "left"]);
    for context in links {
        let LinkFigures { delay, throughput } = context.figures();
        let rate = |figure: Option<ThroughputFigure>| {
            figure.map_or("-".to_owned(), |figure| format!("{:.3}", figure.throughput_bps / 1e6))
        };
        table.row([
            context.link.to_string(),
            arrow(context.direction).to_owned(),
            millis(delay.configured.delay),
            delay.measured.map_or("-".to_owned(), measured),
            rate(throughput.configured),
            rate(Some(throughput.measured)),
            rate(throughput.available),
        ]);
    }
    table.render("")
}

/// Names a measured delay, its source and its age.
fn measured(figure: DelayFigure) -> String {
    let by = match figure.source {
        FigureSource::Probed => "probes",
        FigureSource::Carried => "packets",
        FigureSource::Configured | FigureSource::Estimated => "others",
    };
    format!("{} ({by}, {} ms old)", millis(figure.delay), figure.age.as_millis())
}

/// Returns the sign of a direction, from the left end of a link's name to the right one or back.
fn arrow(direction: Direction) -> &'static str {
    match direction {
        Direction::Forward => "→",
        Direction::Backward => "←",
    }
}

fn delay(probed: &Probed) -> Option<String> {
    let jitter = probed.jitter.map(|jitter| format!(" ± {}", millis(jitter))).unwrap_or_default();
    Some(format!("{}{jitter}{}", millis(probed.delay?), old(probed.delay_age)))
}

fn loss(probed: &Probed) -> Option<String> {
    Some(format!("{:.1} %{}", probed.loss? * 100.0, old(Some(probed.loss_age))))
}

fn old(age: Option<Duration>) -> String {
    age.filter(|age| *age >= OLD).map(|age| format!(" ({})", ago(age))).unwrap_or_default()
}

/// Names the scales that the conditions have, if they change anything.
fn scale(scale: Scale) -> String {
    match scale == Scale::default() {
        true => String::new(),
        false => format!(" (ψ {}, δ {})", scale.delay_scale, scale.drop_scale),
    }
}

#[cfg(test)]
mod tests {
    use console::measure_text_width;
    use cotorra_graph::{BitRate, Conditions, Rate, Tested};
    use cotorra_graph_testing as base;

    use super::*;

    fn context(direction: Direction) -> LinkContext {
        let ms = |ms: f64| Duration::from_secs_f64(ms / 1e3);
        let probed = Probed {
            delay: Some(ms(13.512)),
            jitter: Some(ms(0.012)),
            delay_age: Some(ms(900.0)),
            loss: Some(0.001),
            loss_age: ms(900.0),
        };
        let rate = Rate::Fixed { bits_per_second: BitRate::from_mbps(30.0).unwrap() };
        LinkContext {
            direction,
            delay: Some(ms(13.621)),
            throughput_bps: 12_345_678.0,
            queued_packets: Some(0),
            probed: Some(probed),
            effective: Conditions { delay: ms(13.5), rate, ..Conditions::default() },
            ..base::link_context("robot~R1")
        }
    }

    #[test]
    fn links_fit_a_terminal_of_80_columns() {
        let tested = Tested { throughput_bps: 29e6, offered_bps: 33e6, age: Duration::from_secs(3) };
        let back = LinkContext { tested: Some(tested), ..context(Direction::Backward) };
        let text = table(&[context(Direction::Forward), back]);
        assert_eq!(text.lines().count(), 4, "{text}");
        assert!(text.lines().all(|line| measure_text_width(line) <= 80), "{text}");
        for part in [
            "13.512 ± 0.012",
            "0.1 %",
            "13.500 ms, 30 Mbit/s",
            "robot~R1 ← carried 29.000 of 33.000 Mbit/s",
            "3.0 s ago",
        ] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
    }

    #[test]
    fn figures_have_their_source_and_age() {
        let probed = context(Direction::Forward);
        let carried = LinkContext { probed: None, ..context(Direction::Backward) };
        let silent = LinkContext { delay: None, effective: Conditions::default(), ..carried.clone() };
        let text = figures(&[probed, carried, silent]);
        assert!(text.lines().all(|line| measure_text_width(line) <= 80), "{text}");
        let lines: Vec<_> =
            text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
        assert_eq!(
            lines[1..],
            [
                "robot~R1 → 13.500 13.512 (probes, 900 ms old) 30.000 12.346 17.654",
                "robot~R1 ← 13.500 13.621 (packets, 1000 ms old) 30.000 12.346 17.654",
                "robot~R1 ← 0.000 - - 12.346 -",
            ]
        );
    }

    #[test]
    fn queues_in_which_packets_waited_are_named() {
        let queued = |packets| {
            let context = LinkContext { queued_packets: packets, ..context(Direction::Backward) };
            table(&[context]).lines().skip(2).map(str::to_owned).collect::<Vec<_>>()
        };
        assert!([None, Some(0)].into_iter().all(|packets| queued(packets).is_empty()));
        assert_eq!(queued(Some(1)), ["robot~R1 ← had up to 1 packet in its queue over the last second"]);
        assert_eq!(queued(Some(42)), ["robot~R1 ← had up to 42 packets in its queue over the last second"]);
    }

    #[test]
    fn scales_and_old_results_of_probes_are_marked() {
        let mut context = context(Direction::Forward);
        assert!(!table(&[context.clone()]).contains(['ψ', '(']));
        context.scale.delay_scale = 2.5;
        context.probed.as_mut().unwrap().delay_age = Some(Duration::from_secs(12));
        let text = table(&[context]);
        assert!(text.contains("(ψ 2.5, δ 1)") && text.contains("13.512 ± 0.012 (12.0 s ago)"), "{text}");
    }
}
