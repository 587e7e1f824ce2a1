//! Formatting of values for tables and messages.

use std::time::Duration;

use cotorra_experiments::LOGS;
use cotorra_graph::LinkId;

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

/// `98.96 %`: a share with the digits that distinguish it from another one.
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

/// `+0.57`, `-2.96`, `0.00`.
pub fn signed(figure: f64) -> String {
    let text = format!("{figure:+.2}");
    if matches!(&text[1..], "0.00") { "0.00".to_owned() } else { text }
}

/// Lists the links of a path.
pub fn over(links: &[LinkId]) -> String {
    links.iter().map(LinkId::as_str).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_that_round_to_zero_have_no_sign() {
        let texts = [0.57, -2.96, 0.004, -0.004].map(signed);
        assert_eq!(texts, ["+0.57", "-2.96", "0.00", "0.00"]);
    }

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
