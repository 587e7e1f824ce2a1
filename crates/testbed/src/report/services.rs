//! Tables of a run's services: exact for programs, rounded for readers.

use super::{
    kept::Kept,
    summary::{ServiceSummary, Summary},
    table::DataTable,
    times::Quantiles,
};

/// Returns a row for each service, with the names of `summary.json` and all digits.
pub(super) fn exact(services: &[ServiceSummary]) -> DataTable {
    let mut table = DataTable::new([
        "robot",
        "service",
        "service_time_target_ms",
        "samples",
        "unanswered",
        "above_target",
        "service_time_p50_ms",
        "service_time_p95_ms",
        "service_time_p99_ms",
        "service_time_max_ms",
        "kept",
        "kept_low",
        "kept_high",
        "keep",
        "verdict",
        "sure",
    ]);
    for its in services {
        let names = [its.robot.to_string(), its.service.to_string(), its.service_time_target_ms.to_string()];
        let counts = [its.samples.to_string(), its.unanswered.to_string(), or_empty(its.above_target)];
        let times = quantiles(its.service_time_ms).map(or_empty);
        let Kept { kept, kept_low, kept_high, keep, sure, .. } = its.kept;
        let shares = [kept, kept_low, kept_high, keep].map(or_empty);
        let judged = [its.verdict.map(|verdict| verdict.to_string()), sure.map(|sure| sure.to_string())];
        let judged = judged.map(Option::unwrap_or_default);
        table.row(names.into_iter().chain(counts).chain(times).chain(shares).chain(judged));
    }
    table
}

/// Returns a row for each service, rounded for readers.
pub fn by_service(services: &[ServiceSummary]) -> DataTable {
    let heads = ["robot", "service", "target (ms)", "samples", "unanswered", "kept (%)"];
    let quantiles = ["median (ms)", "p95 (ms)", "p99 (ms)", "max (ms)"];
    let mut table = DataTable::new(heads.into_iter().chain(quantiles)).right_after(2);
    for its in services {
        let names = [its.robot.to_string(), its.service.to_string(), its.service_time_target_ms.to_string()];
        let figures = figures(its.samples, its.unanswered, its.above_target, its.service_time_ms);
        table.row(names.into_iter().chain(figures));
    }
    table
}

impl Summary {
    /// Returns a row for each service, rounded for readers. Several services in the total also have a row for all of them.
    pub fn by_service(&self) -> DataTable {
        let mut table = by_service(&self.services);
        if let Some(name) = name_of_total(self.services.iter().map(|its| its.in_total)) {
            let figures = figures(self.samples, self.unanswered, self.above_target, self.service_time_ms);
            table.row([name, "", ""].map(str::to_owned).into_iter().chain(figures));
        }
        table
    }
}

/// Returns the name of a row for services together; `None` if it would say no more than that of a service. The items are
/// whether each service is in the total.
pub fn name_of_total(in_total: impl Iterator<Item = bool>) -> Option<&'static str> {
    let (counted, apart): (Vec<_>, Vec<_>) = in_total.partition(|in_total| *in_total);
    let name = if apart.is_empty() { "all" } else { "all but localization" };
    (counted.len() > 1).then_some(name)
}

fn figures(
    samples: usize,
    unanswered: usize,
    above_target: Option<f64>,
    times: Option<Quantiles>,
) -> impl Iterator<Item = String> {
    let rounded = |figure: Option<f64>| figure.map_or("-".to_owned(), |figure| format!("{figure:.2}"));
    let kept = above_target.map(|above| (1.0 - above) * 100.0);
    let figures = [kept].into_iter().chain(quantiles(times)).map(rounded);
    [samples.to_string(), unanswered.to_string()].into_iter().chain(figures)
}

fn quantiles(times: Option<Quantiles>) -> [Option<f64>; 4] {
    times.map_or([None; 4], |Quantiles { p50, p95, p99, max }| [p50, p95, p99, max].map(Some))
}

fn or_empty(figure: Option<f64>) -> String {
    figure.map(|figure| figure.to_string()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::kept::Verdict;

    fn services() -> [ServiceSummary; 2] {
        let service = |robot: &str, samples: usize| ServiceSummary {
            robot: robot.parse().unwrap(),
            service: "navigation".parse().unwrap(),
            in_total: true,
            samples,
            unanswered: samples / 4,
            service_time_target_ms: 15.0,
            above_target: (samples > 0).then_some(0.25),
            kept: Kept::of(samples * 3 / 4, samples, (robot == "r1").then_some(0.5)),
            verdict: (robot == "r1").then_some(Verdict::Pass),
            kpis: Vec::new(),
            service_time_ms: Quantiles::of(vec![10.0; samples]),
        };
        [service("r1", 4), service("r2", 0)]
    }

    #[test]
    fn a_row_for_several_services_says_what_it_leaves_out() {
        let name = |in_total: &[bool]| name_of_total(in_total.iter().copied());
        assert_eq!((name(&[]), name(&[true]), name(&[true, false])), (None, None, None));
        assert_eq!(
            (name(&[true, true]), name(&[true, false, true])),
            (Some("all"), Some("all but localization"))
        );
    }

    #[test]
    fn services_without_samples_have_a_row_without_figures() {
        let (exact, rounded) = (exact(&services()), by_service(&services()));
        let [_, first, second] = exact.rows() else { panic!() };
        let shares = "0.75,0.30064184258240184,0.9544127391902995,0.5,PASS,false";
        assert_eq!(first.join(","), format!("r1,navigation,15,4,1,0.25,10,10,10,10,{shares}"));
        assert_eq!(second.join(","), "r2,navigation,15,0,0,,,,,,,,,,,");
        let [_, first, second] = rounded.rows() else { panic!() };
        assert_eq!(first.join(" "), "r1 navigation 15 4 1 75.00 10.00 10.00 10.00 10.00");
        assert_eq!(second.join(" "), "r2 navigation 15 0 0 - - - - -");
    }
}
