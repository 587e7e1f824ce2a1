//! The figure in the letter's layout: negotiation and deployment as bars over time, above the robot's attachment.

use std::sync::Arc;

use cotorra_federation::Step;
use cotorra_testbed::svg;
use kuva::{
    plot::{LinePlot, annotations::TextAnnotation, legend::LegendPosition},
    render::{
        figure::Figure,
        layout::{Layout, TickFormat},
        plots::Plot,
    },
};

use super::federated::Federated;

const WIDTH: f64 = 1100.0;
const HEIGHT: f64 = 380.0;
/// Thickness of a bar, pixels.
const BAR: f64 = 34.0;
/// Time shown before the announcement and after the last step, as a share of the time between them.
const AROUND: f64 = 0.25;

/// A bar of the figure.
struct Bar {
    row: f64,
    from: Step,
    to: Step,
    label: &'static str,
    color: &'static str,
}

const NEGOTIATION: &str = "#4e79a7";
const DEPLOYMENT: &str = "#f28e2b";
const BEFORE: &str = "#bab0ac";
const AFTER: &str = "#59a14f";

const BARS: [Bar; 5] = [
    Bar {
        row: 3.0,
        from: Step::Announced,
        to: Step::AnnouncementReceived,
        label: "announcement",
        color: NEGOTIATION,
    },
    Bar { row: 3.0, from: Step::BidSent, to: Step::BidReceived, label: "bids", color: "#7ea6c9" },
    Bar { row: 3.0, from: Step::WinnerChosen, to: Step::WinnerReceived, label: "choice", color: NEGOTIATION },
    Bar {
        row: 2.0,
        from: Step::DeploymentStarted,
        to: Step::DeploymentFinished,
        label: "vAP",
        color: DEPLOYMENT,
    },
    Bar {
        row: 3.0,
        from: Step::ConfirmationSent,
        to: Step::ConfirmationReceived,
        label: "confirmation",
        color: "#7ea6c9",
    },
];

/// Returns the name of a row.
fn row_name(row: f64) -> String {
    let name = match row.round() as i64 {
        1 => "attachment",
        2 => "vAP deployment",
        3 => "DLT negotiation",
        _ => "",
    };
    name.to_owned()
}

/// Draws a run as SVG. Time begins at the announcement; `ledger` names the ledger of the negotiation.
pub(super) fn draw(run: &Federated, ledger: &str) -> String {
    let begin = run.at(Step::Announced);
    let since = |step: Step| run.at(step) - begin;
    let total = run.total_s();
    let around = AROUND * total;
    let mut plots = Vec::new();
    let mut names = Vec::new();
    let mut bar = |row: f64, from: f64, to: f64, label: &str, color: &'static str| {
        // A bar shorter than a pixel would not be drawn.
        let to = to.max(from + 0.002 * (total + 2.0 * around));
        let line =
            LinePlot::new().with_data([(from, row), (to, row)]).with_color(color).with_stroke_width(BAR);
        plots.push(Plot::Line(line));
        names.push((label.to_owned(), (from + to) / 2.0, row + 0.42));
    };
    for Bar { row, from, to, label, color } in BARS {
        bar(row, since(from), since(to), label, color);
    }
    let [before, after] = &run.attachments;
    bar(1.0, -around, total, &format!("{before} (own domain)"), BEFORE);
    bar(1.0, total, total + around, &format!("{after} (vAP)"), AFTER);
    let mut layout = Layout::auto_from_plots(&plots)
        .with_title(format!(
            "Federation with a block each {} s: {total:.2} s from the announcement to the attachment",
            run.block_period_s
        ))
        .with_x_label("time since the announcement (s)")
        .with_y_tick_step(1.0)
        .with_y_tick_format(TickFormat::Custom(Arc::new(row_name)))
        .with_show_grid(false)
        .with_x_axis_min(-around)
        .with_x_axis_max(total + around)
        .with_y_axis_min(0.0)
        .with_y_axis_max(4.0)
        .with_legend_position(LegendPosition::InsideBottomRight);
    for (name, x, y) in names {
        layout = layout.with_annotation(TextAnnotation::new(name, x, y).with_font_size(13));
    }
    let below = TextAnnotation::new(format!("on {ledger}"), total / 2.0, 0.25).with_font_size(11);
    layout = layout.with_annotation(below);
    let scene = Figure::new(1, 1)
        .with_plots(vec![plots])
        .with_layouts(vec![layout])
        .with_figure_size(WIDTH, HEIGHT)
        .render();
    svg(&scene)
}
