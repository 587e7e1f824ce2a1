//! The reasons for which samples missed their target, for the sentence on how many kept it.

use cotorra_graph::{LostAt, LostCause};
use cotorra_testbed::{LostSummary, PartSummary, ServiceParts};

use crate::words::count;

/// Most places that are named.
const MOST_PLACES: usize = 3;

/// Explains the samples that missed the target: says where those without an answer ended, and names the part that explains most
/// of the others. `None` if nothing is known of them.
pub fn explanation(its: &ServiceParts) -> Option<String> {
    match (unanswered(its), late(its)) {
        (Some(unanswered), Some(late)) => Some(format!("{unanswered}; {late}")),
        (unanswered, late) => unanswered.or(late),
    }
}

/// Says how many samples had no answer, and where these ended.
fn unanswered(its: &ServiceParts) -> Option<String> {
    let missed = its.unanswered + its.late_answers;
    let all = match (its.unanswered, missed) {
        (0, _) => return None,
        (1, 1) => "the one that missed it had no answer".to_owned(),
        (n, all) if n == all => format!("all {n} that missed it had no answer"),
        (n, all) => format!("{n} of the {all} that missed it had no answer"),
    };
    let mut places: Vec<_> = its.lost_at.iter().take(MOST_PLACES).map(place).collect();
    let more: usize = its.lost_at.iter().skip(MOST_PLACES).map(|place| place.samples).sum();
    if more > 0 {
        places.push(format!("{more} elsewhere"));
    }
    Some(format!("{all}: {}", places.join(", ")))
}

/// Says where samples ended.
fn place(LostSummary { at, samples }: &LostSummary) -> String {
    let Some(LostAt { link, back, cause }) = at else {
        return format!("{samples} for an unknown reason, because the fabric did not follow their packets");
    };
    let what = count(*samples, if *back { "answer" } else { "request" });
    let on = |words: &str| match link {
        Some(link) => format!("{what} {words} on {link}"),
        None => format!("{what} {words}"),
    };
    match cause {
        LostCause::Loss => on("lost"),
        LostCause::Corruption => on("damaged"),
        LostCause::FullQueue => on("dropped by a full queue"),
        LostCause::NoAttachment => on("dropped without attachment or in a handover"),
        LostCause::NoRoute => on("dropped without a route"),
        LostCause::OtherCore => on("handed to another core"),
        LostCause::NoAnswer => on("not answered by the VNF in time"),
        LostCause::Late => on("still under way when given up"),
        LostCause::Rejected => on("rejected by the robot"),
        LostCause::NotSent => on("due and not sent"),
    }
}

/// Names the part that explains most answered samples above the target; `None` if there are none.
fn late(its: &ServiceParts) -> Option<String> {
    let samples = count(its.late_with_parts, "late answer");
    if its.late_answers == 0 {
        return None;
    }
    if its.late_with_parts == 0 {
        let late = count(its.late_answers, "late answer");
        return Some(format!(
            "the reason of {late} is unknown, because the fabric did not carry the packets"
        ));
    }
    let PartSummary { part, added_p95_ms, explains, .. } = its.parts.first()?;
    let (added, explains) = (added_p95_ms.as_ref()?, explains.as_ref()?);
    let who = match part.as_str() {
        "sender" => "the sender's host",
        "vnf" if its.mean.processor_ms > its.mean.vnf_ms => "the VNF, which mostly waited for a processor,",
        "vnf" => "the VNF",
        "receiver" => "the receiver's host",
        "unknown" => "time outside all stamps",
        link => link,
    };
    let share = explains * 100.0;
    Some(format!("{who} added {added:.2} ms (p95), the most of all parts in {share:.0} % of {samples}"))
}

#[cfg(test)]
mod tests {
    use cotorra_testbed::MeanParts;

    use super::*;

    fn parts(late: usize, lost: &[(Option<LostAt>, usize)]) -> ServiceParts {
        let explains = (late > 0).then_some(0.75);
        let part = PartSummary {
            part: "lan-cloud".to_owned(),
            within_p50_ms: Some(9.0),
            above_p95_ms: explains.map(|_| 31.0),
            added_p95_ms: explains.map(|_| 22.0),
            explains,
        };
        ServiceParts {
            service: "navigation".parse().unwrap(),
            samples: 30,
            without_parts: 0,
            late_answers: late,
            late_with_parts: late,
            unanswered: lost.iter().map(|(_, samples)| samples).sum(),
            lost_at: lost
                .iter()
                .map(|(at, samples)| LostSummary { at: at.clone(), samples: *samples })
                .collect(),
            mean: MeanParts::default(),
            parts: vec![part],
        }
    }

    #[test]
    fn a_vnf_that_waited_for_a_processor_is_not_blamed_alone() {
        let mut its = parts(20, &[]);
        its.parts[0].part = "vnf".to_owned();
        let said = |its: &ServiceParts| explanation(its).unwrap();
        its.mean = MeanParts { vnf_ms: 3.0, processor_ms: 2.0, ..MeanParts::default() };
        assert!(said(&its).starts_with("the VNF added 22.00 ms"), "{}", said(&its));
        its.mean = MeanParts { vnf_ms: 2.0, processor_ms: 3.0, ..MeanParts::default() };
        assert!(said(&its).starts_with("the VNF, which mostly waited for a processor, added 22.00 ms"));
    }

    fn at(link: Option<&str>, back: bool, cause: LostCause) -> Option<LostAt> {
        Some(LostAt { link: link.map(|link| link.parse().unwrap()), back, cause })
    }

    #[test]
    fn the_first_part_explains_late_answers_and_says_of_how_many() {
        let expected = "lan-cloud added 22.00 ms (p95), the most of all parts in 75 % of 20 late answers";
        assert_eq!(explanation(&parts(20, &[])).as_deref(), Some(expected));
        assert_eq!(explanation(&parts(0, &[])), None);
        let without = ServiceParts { late_with_parts: 0, parts: Vec::new(), ..parts(3, &[]) };
        let expected =
            "the reason of 3 late answers is unknown, because the fabric did not carry the packets";
        assert_eq!(explanation(&without).as_deref(), Some(expected));
    }

    #[test]
    fn samples_without_an_answer_come_first_with_the_places_where_they_ended() {
        let lost = [
            (at(Some("r2~AP3"), false, LostCause::Loss), 590),
            (at(Some("lan-edge"), true, LostCause::FullQueue), 3),
            (at(None, false, LostCause::NoAnswer), 1),
        ];
        assert_eq!(
            explanation(&parts(6, &lost)).unwrap(),
            "594 of the 600 that missed it had no answer: 590 requests lost on r2~AP3, 3 answers dropped by a full queue on \
             lan-edge, 1 request not answered by the VNF in time; lan-cloud added 22.00 ms (p95), the most of all parts in \
             75 % of 6 late answers"
        );
    }

    #[test]
    fn places_that_nobody_knows_are_said_to_be_unknown() {
        assert_eq!(
            explanation(&parts(0, &[(None, 7)])).unwrap(),
            "all 7 that missed it had no answer: 7 for an unknown reason, because the fabric did not follow their packets"
        );
    }

    #[test]
    fn a_few_places_are_named_and_the_others_counted() {
        let lost: Vec<_> =
            (0..5).map(|link| (at(Some(&format!("r~A{link}")), false, LostCause::Loss), 10 - link)).collect();
        assert!(explanation(&parts(0, &lost)).unwrap().ends_with(", 8 requests lost on r~A2, 13 elsewhere"));
    }
}
