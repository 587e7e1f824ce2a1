//! Verdicts on services: a sentence for each robot on how often it kept its target.

use cotorra_testbed::{ServiceParts, ServiceSummary};

use crate::{explanation::explanation, words::percent};

/// Returns a sentence for each service, in their order, and one that names the worst of several. A service that missed its
/// target has the part of its service times that explains most of that.
///
/// A testbed file demands no share of samples, so a service "did not keep" its target if most of its samples missed it.
pub fn verdicts(services: &[ServiceSummary], parts: &[ServiceParts]) -> Vec<String> {
    let sentence = |its: &ServiceSummary| {
        let verdict = verdict(its, &name(its, services));
        match reason(its, parts) {
            None => verdict + ".",
            Some(reason) => format!("{verdict}; {reason}."),
        }
    };
    let mut sentences: Vec<_> = services.iter().map(sentence).collect();
    sentences.extend(worst(services));
    sentences
}

/// Returns the robot's name, with the service's if the robot has several.
fn name(of: &ServiceSummary, services: &[ServiceSummary]) -> String {
    match services.iter().filter(|its| its.robot == of.robot).nth(1) {
        None => of.robot.to_string(),
        Some(_) => format!("{} of {}", of.service, of.robot),
    }
}

/// Explains the samples above the target; `None` if there are none, or none with parts.
fn reason(its: &ServiceSummary, parts: &[ServiceParts]) -> Option<String> {
    its.above_target.filter(|above| *above > 0.0)?;
    explanation(parts.iter().find(|parts| parts.service == its.service)?)
}

fn verdict(its: &ServiceSummary, name: &str) -> String {
    let target = its.service_time_target_ms;
    let Some(kept) = kept(its) else {
        return format!("{name} has no samples; its target is {target} ms");
    };
    if kept >= 1.0 {
        format!("{name} kept {target} ms in all samples")
    } else if kept >= 0.5 {
        format!("{name} kept {target} ms in {} of samples", percent(kept))
    } else if kept > 0.0 {
        format!("{name} did not keep {target} ms: only {} of samples did", percent(kept))
    } else {
        format!("{name} did not keep {target} ms in any sample")
    }
}

/// Names the service that kept its target least; `None` if no service is worse than all others.
fn worst(services: &[ServiceSummary]) -> Option<String> {
    let mut measured: Vec<_> = services.iter().filter_map(|its| Some((kept(its)?, its))).collect();
    measured.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    match measured[..] {
        [(least, worst), (next, _), ..] if least < next => {
            Some(format!("{} kept its target least.", name(worst, services)))
        }
        _ => None,
    }
}

/// Returns the share of samples within the target; `None` without samples.
fn kept(its: &ServiceSummary) -> Option<f64> {
    its.above_target.map(|above| 1.0 - above)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a service with 1000 samples, or none if `above` is `None`.
    fn service(robot: &str, service: &str, above: Option<usize>) -> ServiceSummary {
        ServiceSummary {
            robot: robot.parse().unwrap(),
            service: service.parse().unwrap(),
            in_total: service != "localization",
            samples: above.map_or(0, |_| 1000),
            unanswered: 0,
            service_time_target_ms: 15.0,
            above_target: above.map(|above| above as f64 / 1000.0),
            service_time_ms: None,
        }
    }

    #[test]
    fn each_robot_is_named_with_its_share_and_the_worst_once_more() {
        let robots = [("r1", Some(8)), ("r2", Some(0)), ("r3", Some(86)), ("r4", Some(500))];
        let services = robots.map(|(robot, above)| service(robot, &format!("navigation-{robot}"), above));
        assert_eq!(
            verdicts(&services, &[]),
            [
                "r1 kept 15 ms in 99.2 % of samples.",
                "r2 kept 15 ms in all samples.",
                "r3 kept 15 ms in 91.4 % of samples.",
                "r4 kept 15 ms in 50.0 % of samples.",
                "r4 kept its target least.",
            ]
        );
    }

    #[test]
    fn a_robot_that_missed_its_target_mostly_did_not_keep_it() {
        let of = |above| verdicts(&[service("r1", "navigation", Some(above))], &[]);
        assert_eq!(of(501), ["r1 did not keep 15 ms: only 49.9 % of samples did."]);
        assert_eq!(of(1000), ["r1 did not keep 15 ms in any sample."]);
    }

    #[test]
    fn services_of_one_robot_are_told_apart_and_missing_samples_are_said() {
        let of = |localization| {
            [service("r1", "navigation", Some(100)), service("r1", "localization", localization)]
        };
        assert_eq!(
            verdicts(&of(None), &[]),
            [
                "navigation of r1 kept 15 ms in 90.0 % of samples.",
                "localization of r1 has no samples; its target is 15 ms.",
            ]
        );
        assert_eq!(
            verdicts(&of(Some(0)), &[])[1..],
            ["localization of r1 kept 15 ms in all samples.", "navigation of r1 kept its target least."]
        );
        let equal = ["r1", "r2"].map(|robot| service(robot, "navigation", Some(10)));
        assert_eq!(verdicts(&equal, &[]).len(), 2, "none of them is the worst");
    }
}
