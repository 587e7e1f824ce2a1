//! Requirements of the comparison on a testbed.

use cotorra_graph::{Program, Roaming, Testbed};

use super::compared;

/// A testbed cannot be walked by both contenders.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("OKpi and the state of the art cannot be compared on this testbed; it lacks: {}", lacking.join("; "))]
pub struct Unfit {
    lacking: Vec<String>,
}

/// Checks that a testbed has what both contenders need: a service that navigates, whose robot takes instructions on its
/// radio unit, radio units and servers. Each testbed file has the walk of a robot that navigates. Both plug-ins are bundled,
/// so that a file need not list them.
///
/// # Errors
/// [`Unfit`] names all that is missing.
pub fn check(testbed: &Testbed) -> Result<(), Unfit> {
    let mut lacking = Vec::new();
    let service = compared(testbed);
    match service {
        None => lacking.push("a service with a robot, and the VNFs robot_driver and navigation".to_owned()),
        Some(service) => {
            let has_navigation = service.vnfs.iter().any(|vnf| vnf.program == Program::Navigation);
            if !service.navigates() || !has_navigation {
                let id = &service.id;
                lacking
                    .push(format!("the programs robot_driver and navigation in `{id}`, its first service"));
            }
            let robot = &service.robot;
            let is_instructed = |(node, its): (&cotorra_graph::Node, &cotorra_graph::Robot)| {
                node.id == *robot && its.roaming == Roaming::Instructed
            };
            if !testbed.graph.robots().any(is_instructed) {
                lacking.push(format!("`roaming: instructed` of `{robot}`"));
            }
        }
    }
    if testbed.graph.radio_units().next().is_none() {
        lacking.push("a radio unit".to_owned());
    }
    if testbed.graph.servers().next().is_none() {
        lacking.push("a server".to_owned());
    }
    if lacking.is_empty() { Ok(()) } else { Err(Unfit { lacking }) }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::okpi::tests::TESTBED;

    fn lacking(text: &str) -> String {
        let testbed = cotorra_testbed_file::parse("test.yaml", text, Path::new("")).unwrap();
        check(&testbed).map_or_else(|unfit| unfit.lacking.join("; "), |()| String::new())
    }

    #[test]
    fn a_testbed_without_plugins_is_enough() {
        assert_eq!(lacking(TESTBED), "");
    }

    #[test]
    fn all_that_a_testbed_lacks_is_named() {
        assert_eq!(
            lacking(&TESTBED.replace("roaming: instructed", "roaming: signal")),
            "`roaming: instructed` of `robot`"
        );
        let nothing = "name: none\nnodes: { lan: { kind: switch } }\n";
        assert_eq!(
            lacking(nothing),
            "a service with a robot, and the VNFs robot_driver and navigation; a radio unit; a server"
        );
    }
}
