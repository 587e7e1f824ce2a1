//! Tables and columns of figures over time.

use cotorra_graph::{Figure, NodeId, ServiceId};

use crate::kind::{Kind, Series};

/// Table and columns of a figure.
pub(crate) struct Kept<'a> {
    pub kind: Kind,
    /// The series, for kinds that make any.
    pub series: Option<Series>,
    /// Columns of a row, and the names that they must have.
    pub named: Vec<(&'static str, &'a str)>,
    /// For figures in child rows: the column, and the name that it must have.
    pub child: Option<(&'static str, &'a str)>,
    pub column: &'static str,
}

/// Returns the table and columns of a figure.
pub(crate) fn kept(figure: &Figure) -> Kept<'_> {
    let plain = |kind, column| Kept { kind, series: None, named: Vec::new(), child: None, column };
    let column = figure.declared().field;
    match figure {
        Figure::Link(link, direction, _) => {
            let series = Some(Series::new(Kind::Link, link, *direction));
            Kept { series, ..plain(Kind::Link, column) }
        }
        Figure::Robot(robot, _) => {
            Kept { series: Some(Series::new(Kind::Robot, robot, ())), ..plain(Kind::Robot, column) }
        }
        Figure::Signal { robot, radio_unit } => Kept {
            series: Some(Series::new(Kind::Robot, robot, ())),
            child: Some(("radio_unit", radio_unit.as_str())),
            ..plain(Kind::Robot, column)
        },
        Figure::Load(unit) => {
            Kept { series: Some(Series::new(Kind::Radio, unit, ())), ..plain(Kind::Radio, column) }
        }
        Figure::ServiceTime { service, robot } => {
            Kept { named: samples(service, robot), ..plain(Kind::ServiceTime, column) }
        }
        Figure::TimePart { part, service, robot } => Kept {
            named: samples(service, robot),
            child: Some(("part", part)),
            ..plain(Kind::ServiceTime, column)
        },
        Figure::HandoverGap { robot } => {
            let named = robot.iter().map(|robot| ("robot", robot.as_str())).collect();
            Kept { named, ..plain(Kind::Handover, column) }
        }
        Figure::Sensor { robot, sensor, component } => Kept {
            series: Some(Series::new(Kind::Sensor, robot, sensor)),
            child: Some(("component", component.as_str())),
            ..plain(Kind::Sensor, column)
        },
        Figure::Machine(node, _) => {
            Kept { series: Some(Series::new(Kind::Machine, node, ())), ..plain(Kind::Machine, column) }
        }
        Figure::Lateness(_) => plain(Kind::Lateness, column),
    }
}

/// Returns the columns of samples, and the names that they must have.
fn samples<'a>(service: &'a Option<ServiceId>, robot: &'a Option<NodeId>) -> Vec<(&'static str, &'a str)> {
    let service = service.iter().map(|service| ("service", service.as_str()));
    service.chain(robot.iter().map(|robot| ("robot", robot.as_str()))).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::testing::figure;

    proptest! {
        #[test]
        fn written_figures_are_read_back(figure in figure()) {
            prop_assert_eq!(figure.to_string().parse(), Ok(figure));
        }
    }
}
