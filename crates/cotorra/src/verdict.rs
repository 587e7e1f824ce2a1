//! Verdicts on services: a sentence for each robot on how often it kept its target, and one for each of its KPIs.

use std::collections::BTreeSet;

use cotorra_graph::Natural;
use cotorra_numbers::Quantiles;
use cotorra_testbed::{FEW_ROBOTS, Judged, Kept, ServiceParts, ServiceSummary, Verdict, WORST_ROBOTS};

use crate::{
    explanation::explanation,
    words::{count, demanded, percent, percent_apart},
};

/// Returns a sentence for each service, in their order, and one that names the worst of several. A service that missed its
/// target has the reasons of that. Of many robots, the worst services have a sentence each, and all services have one
/// together.
///
/// If the testbed file demands a share of samples, the sentence begins with PASS or FAIL. Without, a service "did not keep"
/// its target if most of its samples missed it.
pub fn verdicts(services: &[ServiceSummary], parts: &[ServiceParts]) -> Vec<String> {
    let sentence = |its: &ServiceSummary| {
        let verdict = verdict(its, &name(its, services));
        let judged =
            judged(&its.kept).map_or(verdict.clone(), |[word, why]| format!("{word}: {verdict} ({why})"));
        match reason(its, parts) {
            None => judged + ".",
            Some(reason) => format!("{judged}; {reason}."),
        }
    };
    let shown = by_name(services);
    let of_kpis = |its: &ServiceSummary| {
        let name = name(its, services);
        its.further_kpis().map(|kpi| kpi_sentence(kpi, &name)).collect::<Vec<_>>()
    };
    let mut sentences: Vec<_> =
        shown.iter().copied().flat_map(|its| [sentence(its)].into_iter().chain(of_kpis(its))).collect();
    if shown.len() < services.len() {
        sentences.push(all_together(services));
    }
    sentences.extend(worst(services));
    sentences
}

/// Returns the services to show by name: all of a few robots, in their order, or else the worst, from the worst. Those that
/// failed are worse than others, then those with the lower share within their target.
pub fn by_name(services: &[ServiceSummary]) -> Vec<&ServiceSummary> {
    let mut shown: Vec<_> = services.iter().collect();
    if services.iter().map(|its| &its.robot).collect::<BTreeSet<_>>().len() > FEW_ROBOTS {
        shown.sort_by_cached_key(|its| [its.robot.as_str(), its.service.as_str()].map(Natural::of));
        let has_failed = |its: &ServiceSummary| its.verdict == Some(Verdict::Fail);
        // A service without samples did not miss its target, unless a share is demanded.
        let kept = |its: &ServiceSummary| its.kept.kept.unwrap_or(if has_failed(its) { 0.0 } else { 2.0 });
        shown.sort_by(|a, b| has_failed(b).cmp(&has_failed(a)).then(kept(a).total_cmp(&kept(b))));
        shown.truncate(WORST_ROBOTS);
    }
    shown
}

/// Says how often services kept their targets, and how many passed and failed.
fn all_together(services: &[ServiceSummary]) -> String {
    let mut shares: Vec<_> = services.iter().filter_map(|its| its.kept.kept).collect();
    shares.sort_by(f64::total_cmp);
    let mut parts = Vec::new();
    if let (Some(least), Some(Quantiles { p50, max, .. })) = (shares.first(), Quantiles::of(shares.clone())) {
        let [least, median, most] = [*least, p50, max].map(percent);
        parts.push(format!("kept their targets in {least} to {most} of samples, median {median}"));
    }
    let silent = services.len() - shares.len();
    if silent > 0 {
        parts.push(format!("{silent} without samples"));
    }
    for verdict in [Verdict::Pass, Verdict::Fail] {
        let its = services.iter().filter(|its| its.verdict == Some(verdict)).count();
        if services.iter().any(|its| its.verdict.is_some()) {
            parts.push(format!("{its} {verdict}"));
        }
    }
    format!("All {}: {}.", count(services.len(), "service"), parts.join("; "))
}

/// Returns the robot's name, with the service's if the robot has several.
fn name(of: &ServiceSummary, services: &[ServiceSummary]) -> String {
    match services.iter().filter(|its| its.robot == of.robot).nth(1) {
        None => of.robot.to_string(),
        Some(_) => format!("{} of {}", of.service, of.robot),
    }
}

/// Explains the samples that missed the target; `None` if there are none, or nothing is known of them.
fn reason(its: &ServiceSummary, parts: &[ServiceParts]) -> Option<String> {
    its.above_target.filter(|above| *above > 0.0)?;
    explanation(parts.iter().find(|parts| parts.service == its.service)?)
}

fn verdict(its: &ServiceSummary, name: &str) -> String {
    let target = its.service_time_target_ms;
    let samples = count(its.samples, "sample");
    let Some(kept) = its.kept.kept else {
        return format!("{name} has no samples; its target is {target} ms");
    };
    let share = its.kept.keep.map_or_else(|| percent(kept), |keep| percent_apart(kept, keep));
    if kept >= 1.0 {
        format!("{name} kept {target} ms in all of {samples}")
    } else if kept >= 0.5 {
        format!("{name} kept {target} ms in {share} of {samples}")
    } else if kept > 0.0 {
        format!("{name} did not keep {target} ms: only {share} of {samples} did")
    } else {
        format!("{name} did not keep {target} ms in any of {samples}")
    }
}

/// Returns PASS or FAIL, and the figures behind it; `None` if the testbed file demands no share.
fn judged(kept: &Kept) -> Option<[String; 2]> {
    let Kept { kept_low, kept_high, keep, verdict, sure, .. } = *kept;
    let mut why = format!("{} demanded", demanded(keep?));
    if let (Some(low), Some(high)) = (kept_low, kept_high) {
        why += &format!(", 95 % interval {} to {}", percent(low), percent(high));
    }
    if sure == Some(false) {
        why += ", too few samples to be sure";
    }
    Some([verdict?.to_string(), why])
}

/// Says whether a KPI was kept, with its value.
fn kpi_sentence(Judged { kpi, measured, verdict, reason, .. }: &Judged, name: &str) -> String {
    match (verdict, measured) {
        (Some(verdict), Some(measured)) => format!("{verdict}: {name} has {kpi}: {measured}."),
        (Some(verdict), None) => {
            format!("{verdict}: {name} has {kpi}: {}.", reason.as_deref().unwrap_or("not measured"))
        }
        (None, _) => {
            format!("{name} has the KPI {kpi}, not judged: {}.", reason.as_deref().unwrap_or("unknown"))
        }
    }
}

/// Names the service that kept its target least; `None` if no service is worse than all others.
fn worst(services: &[ServiceSummary]) -> Option<String> {
    let mut measured: Vec<_> = services.iter().filter_map(|its| Some((its.kept.kept?, its))).collect();
    measured.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    match measured[..] {
        [(least, worst), (next, _), ..] if least < next => {
            Some(format!("{} kept its target least.", name(worst, services)))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a service with 1000 samples, or none if `above` is `None`.
    fn service(robot: &str, service: &str, above: Option<usize>) -> ServiceSummary {
        let samples = above.map_or(0, |_| 1000);
        ServiceSummary {
            robot: robot.parse().unwrap(),
            service: service.parse().unwrap(),
            in_total: service != "localization",
            samples,
            unanswered: 0,
            service_time_target_ms: 15.0,
            above_target: above.map(|above| above as f64 / 1000.0),
            kept: Kept::of(samples - above.unwrap_or(0), samples, None),
            verdict: None,
            kpis: Vec::new(),
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
                "r1 kept 15 ms in 99.2 % of 1000 samples.",
                "r2 kept 15 ms in all of 1000 samples.",
                "r3 kept 15 ms in 91.4 % of 1000 samples.",
                "r4 kept 15 ms in 50.0 % of 1000 samples.",
                "r4 kept its target least.",
            ]
        );
    }

    #[test]
    fn of_many_robots_the_worst_have_a_sentence_each_and_all_have_one_together() {
        let many = |keep: Option<f64>| -> Vec<ServiceSummary> {
            let of = |i: usize| {
                let its = service(&format!("r{i}"), &format!("navigation-{i}"), (i != 12).then_some(10 * i));
                let kept = Kept::of(1000 - 10 * i, its.samples, keep);
                ServiceSummary { kept, verdict: kept.verdict, ..its }
            };
            (1..=12).map(of).collect()
        };
        let sentences = verdicts(&many(None), &[]);
        assert!(sentences[0].starts_with("r11 kept 15 ms in 89.0 %"), "{sentences:?}");
        assert!(sentences[4].starts_with("r7 kept 15 ms in 93.0 %"), "{sentences:?}");
        assert_eq!(
            sentences[5..],
            [
                "All 12 services: kept their targets in 89.0 % to 99.0 % of samples, median 94.0 %; 1 without samples.",
                "r11 kept its target least.",
            ]
        );
        let judged = verdicts(&many(Some(0.985)), &[]);
        assert!(judged[0].starts_with("FAIL: r12 has no samples"), "{judged:?}");
        assert!(judged[5].ends_with("; 1 without samples; 1 PASS; 11 FAIL."), "{judged:?}");
    }

    #[test]
    fn a_robot_that_missed_its_target_mostly_did_not_keep_it() {
        let of = |above| verdicts(&[service("r1", "navigation", Some(above))], &[]);
        assert_eq!(of(501), ["r1 did not keep 15 ms: only 49.9 % of 1000 samples did."]);
        assert_eq!(of(1000), ["r1 did not keep 15 ms in any of 1000 samples."]);
    }

    #[test]
    fn a_demanded_share_passes_or_fails_with_its_interval() {
        let of = |within, samples, keep| {
            let kept = Kept::of(within, samples, Some(keep));
            let above_target = kept.kept.map(|kept| 1.0 - kept);
            verdicts(
                &[ServiceSummary { samples, above_target, kept, ..service("r1", "navigation", None) }],
                &[],
            )
        };
        assert_eq!(
            of(949, 1000, 0.99),
            [
                "FAIL: r1 kept 15 ms in 94.9 % of 1000 samples (99 % demanded, 95 % interval 93.4 % to 96.1 %)."
            ]
        );
        assert_eq!(
            of(1000, 1000, 0.99),
            ["PASS: r1 kept 15 ms in all of 1000 samples (99 % demanded, 95 % interval 99.6 % to 100.0 %)."]
        );
        assert_eq!(
            of(19, 20, 0.9),
            [
                "PASS: r1 kept 15 ms in 95.0 % of 20 samples (90 % demanded, 95 % interval 76.4 % to 99.1 %, too few samples \
              to be sure)."
            ]
        );
        assert_eq!(
            of(0, 0, 0.9),
            ["FAIL: r1 has no samples; its target is 15 ms (90 % demanded, too few samples to be sure)."]
        );
        assert!(of(98_996, 100_000, 0.99)[0].contains("98.996 % of"), "it does not look like 99 %");
    }

    #[test]
    fn each_kpi_has_a_sentence_with_its_value_beside_the_limit() {
        let judged = |kpi: &str, measured: Option<&str>, verdict| Judged {
            kpi: kpi.to_owned(),
            value: None,
            unit: String::new(),
            measured: measured.map(str::to_owned),
            verdict,
            reason: verdict.is_none().then(|| "no run can tell".to_owned()),
        };
        let kpis = vec![
            judged("kept >= 99 %", Some("99.2 %"), Some(Verdict::Pass)),
            judged("service_time p95 <= 15 ms", Some("12.5 ms"), Some(Verdict::Pass)),
            judged("localization_error p95 <= 0.1 m", None, Some(Verdict::Fail)),
            judged("area", None, None),
        ];
        let its = service("r1", "navigation", Some(8));
        let kept = Kept::of(992, 1000, Some(0.99));
        let its = ServiceSummary { kpis, kept, verdict: Some(Verdict::Fail), ..its };
        assert_eq!(
            verdicts(&[its], &[])[1..],
            [
                "PASS: r1 has service_time p95 <= 15 ms: 12.5 ms.",
                "FAIL: r1 has localization_error p95 <= 0.1 m: not measured.",
                "r1 has the KPI area, not judged: no run can tell.",
            ]
        );
    }

    #[test]
    fn services_of_one_robot_are_told_apart_and_missing_samples_are_said() {
        let of = |localization| {
            [service("r1", "navigation", Some(100)), service("r1", "localization", localization)]
        };
        assert_eq!(
            verdicts(&of(None), &[]),
            [
                "navigation of r1 kept 15 ms in 90.0 % of 1000 samples.",
                "localization of r1 has no samples; its target is 15 ms.",
            ]
        );
        assert_eq!(
            verdicts(&of(Some(0)), &[])[1..],
            [
                "localization of r1 kept 15 ms in all of 1000 samples.",
                "navigation of r1 kept its target least."
            ]
        );
        let equal = ["r1", "r2"].map(|robot| service(robot, "navigation", Some(10)));
        assert_eq!(verdicts(&equal, &[]).len(), 2, "none of them is the worst");
    }
}
