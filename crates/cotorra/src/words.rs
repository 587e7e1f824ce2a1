//! Formatting of values for tables and messages.

use std::time::Duration;

use cotorra_experiments::LOGS;
use cotorra_graph::{Conditions, LinkId, Loss, Probed, QueueLimit, Rate, TraceName};

/// `1 link`, `2 links`, `3 switches`.
pub fn count(n: usize, what: &str) -> String {
    match n {
        1 => format!("1 {what}"),
        _ if what.ends_with("ch") => format!("{n} {what}es"),
        _ => format!("{n} {what}s"),
    }
}

/// `, 2 of them from before, 1 of them void`; nothing of what there is none.
pub fn of_them(resumed: usize, void: usize) -> String {
    let part = |n: usize, what| if n > 0 { format!(", {n} of them {what}") } else { String::new() };
    part(resumed, "from before") + &part(void, "void")
}

/// Says where the output of plug-ins is whose runs are void.
pub fn logs() -> String {
    format!("{LOGS}/ has the output of plug-ins in void runs. The same command makes these runs again.")
}

/// `28.7 ms`.
pub fn in_ms(ms: f64) -> String {
    format!("{ms:.1} ms")
}

/// `99.2 %`. A share that is not quite all or none is not rounded to it.
pub fn percent(share: f64) -> String {
    let percent = (share * 1000.0).round() / 10.0;
    let percent = if share <= 0.0 || share >= 1.0 { percent } else { percent.clamp(0.1, 99.9) };
    format!("{percent:.1} %")
}

/// `98.96 %`: a share with the digits that tell it from another one.
pub fn percent_apart(share: f64, other: f64) -> String {
    let with = |digits: usize, share: f64| format!("{:.digits$} %", share * 100.0);
    let digits = (1..=6).find(|digits| with(*digits, share) != with(*digits, other));
    match digits {
        Some(digits) if digits > 1 => with(digits, share),
        _ => percent(share),
    }
}

/// `99 %`, `99.5 %`: a share as people write it.
pub fn demanded(share: f64) -> String {
    format!("{} %", (share * 1e8).round() / 1e6)
}

/// `0:07`, `6:52`, `1:02:03`.
pub fn clock(seconds: f64) -> String {
    let seconds = seconds as u64;
    let (h, min, s) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    if h > 0 { format!("{h}:{min:02}:{s:02}") } else { format!("{min}:{s:02}") }
}

/// Formats a duration in milliseconds, without the unit.
pub fn millis(duration: Duration) -> String {
    format!("{:.3}", duration.as_secs_f64() * 1e3)
}

/// `1.5 s ago`.
pub fn ago(age: Duration) -> String {
    format!("{:.1} s ago", age.as_secs_f64())
}

/// Describes the delay, jitter and loss that probes measured.
pub fn probed(probed: &Probed) -> String {
    let delay = probed.delay.map(|delay| {
        let jitter = probed.jitter.map(|jitter| format!(" ± {}", millis(jitter))).unwrap_or_default();
        let age = probed.delay_age.map(|age| format!(" ({})", ago(age))).unwrap_or_default();
        format!("{}{jitter} ms{age}", millis(delay))
    });
    let loss = probed.loss.map(|loss| format!("{:.1} % lost ({})", loss * 100.0, ago(probed.loss_age)));
    [delay, loss].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// Describes a trace by its mean rate.
fn traced(trace: &TraceName) -> String {
    format!("a trace of {:.3} Mbit/s", trace.mean_bits_per_second() / 1e6)
}

/// Describes what a link does to packets.
pub fn conditions(conditions: &Conditions) -> String {
    let percent = |share: f64| format!("{:.3} %", share * 100.0);
    let mut parts = vec![format!("{} ms", millis(conditions.delay))];
    if let Some(jitter) = conditions.jitter {
        parts[0] = format!("{} ± {} ms", millis(conditions.delay), millis(jitter.deviation));
        if !jitter.correlation.is_none() {
            parts.push(format!("correlation {}", jitter.correlation));
        }
    }
    parts.push(match &conditions.rate {
        Rate::Unlimited => "unlimited".to_owned(),
        Rate::Fixed { bits_per_second } => bits_per_second.to_string(),
        Rate::Trace { trace } => traced(trace.name()),
        Rate::NamedTrace(name) => traced(name),
    });
    match conditions.loss {
        Loss::None => {}
        Loss::Independent { rate } => parts.push(format!("loss {}", percent(rate.get()))),
        Loss::Bursty { rate, mean_burst } => {
            parts.push(format!("loss {} in bursts of {mean_burst}", percent(rate.get())));
        }
    }
    let shares = [
        ("duplication", conditions.duplication),
        ("corruption", conditions.corruption),
        ("reordering", conditions.reordering),
    ];
    parts.extend(
        shares.iter().filter(|(_, p)| p.get() > 0.0).map(|(name, p)| format!("{name} {}", percent(p.get()))),
    );
    match conditions.queue {
        QueueLimit::Packets(1000) => {}
        QueueLimit::Packets(packets) => parts.push(format!("queue {packets} packets")),
        QueueLimit::Bytes(bytes) => parts.push(format!("queue {bytes} B")),
    }
    if !conditions.queue_discipline.is_drop_tail() {
        parts.push(conditions.queue_discipline.name().to_owned());
    }
    parts.join(", ")
}

/// Lists the links of a path.
pub fn over(links: &[LinkId]) -> String {
    links.iter().map(LinkId::as_str).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_told_from_the_demanded_one() {
        let apart =
            [(0.9896, 0.99), (0.98999, 0.99), (0.99, 0.99), (0.95, 0.99)].map(|(a, b)| percent_apart(a, b));
        assert_eq!(apart, ["98.96 %", "98.999 %", "99.0 %", "95.0 %"]);
        assert_eq!([0.99, 0.995, 1.0, 0.07].map(demanded), ["99 %", "99.5 %", "100 %", "7 %"]);
    }

    #[test]
    fn only_all_samples_are_100_percent_and_only_none_are_0() {
        let shares = [0.0, 0.0001, 0.0123, 0.992, 0.99999, 1.0];
        assert_eq!(shares.map(percent), ["0.0 %", "0.1 %", "1.2 %", "99.2 %", "99.9 %", "100.0 %"]);
    }
}
