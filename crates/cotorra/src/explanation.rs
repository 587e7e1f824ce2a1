//! The part that explains the samples above the target, for the sentence on how many were within it.

use cotorra_testbed::{PartSummary, ServiceParts};

/// Names the part that explains most samples above the target; `None` if no such sample has parts.
pub fn explanation(its: &ServiceParts) -> Option<String> {
    if its.samples == 0 {
        return Some("the reason is unknown, because the fabric did not carry the packets".to_owned());
    }
    let PartSummary { part, added_p95_ms, explains, .. } = its.parts.first()?;
    let (added, explains) = (added_p95_ms.as_ref()?, explains.as_ref()?);
    let who = match part.as_str() {
        "sender" => "the sender's host",
        "vnf" => "the VNF",
        "receiver" => "the receiver's host",
        "unknown" => "time outside all stamps",
        link => link,
    };
    let share = explains * 100.0;
    Some(format!("{who} added {added:.2} ms (p95), the most of all parts in {share:.0} % of the others"))
}

#[cfg(test)]
mod tests {
    use cotorra_testbed::MeanParts;

    use super::*;

    fn parts(explains: Option<f64>) -> ServiceParts {
        let part = PartSummary {
            part: "lan-cloud".to_owned(),
            within_p50_ms: Some(9.0),
            above_p95_ms: explains.map(|_| 31.0),
            added_p95_ms: explains.map(|_| 22.0),
            explains,
        };
        let service = "navigation".parse().unwrap();
        ServiceParts { service, samples: 3, without_parts: 0, mean: MeanParts::default(), parts: vec![part] }
    }

    #[test]
    fn the_first_part_explains_samples_above_the_target() {
        let expected = "lan-cloud added 22.00 ms (p95), the most of all parts in 75 % of the others";
        assert_eq!(explanation(&parts(Some(0.75))).as_deref(), Some(expected));
        assert_eq!(explanation(&parts(None)), None);
        let without = ServiceParts { samples: 0, without_parts: 3, parts: Vec::new(), ..parts(None) };
        assert!(explanation(&without).unwrap().contains("unknown"));
    }
}
