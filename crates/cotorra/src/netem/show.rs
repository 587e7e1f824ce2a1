//! Conditions and counters of interfaces, as a table or as JSON.

use std::time::Duration;

use cotorra_graph::Probability;
use cotorra_netem::{Counters, Device, Loss, Netem, Rule, Side};
use serde_json::{Value, json};

use crate::table::Table;

fn percent(p: Probability) -> String {
    format!("{} %", round(p.get() * 100.0))
}

/// Rounds to six digits, which hides the rounding of the kernel's units.
fn round(value: f64) -> f64 {
    format!("{value:.6}").parse().unwrap_or(value)
}

fn time(duration: Duration) -> String {
    format!("{} ms", round(duration.as_secs_f64() * 1e3))
}

/// Describes the packets that a rule applies to.
pub fn packets(rule: &Rule) -> String {
    match (rule.side, rule.network) {
        (Side::Egress, None) => "leaving".to_owned(),
        (Side::Egress, Some(network)) => format!("to {network:#}"),
        (Side::Ingress, None) => "arriving".to_owned(),
        (Side::Ingress, Some(network)) => format!("from {network:#}"),
    }
}

/// Describes the conditions of a rule.
pub fn conditions(netem: &Netem) -> String {
    let mut parts = Vec::new();
    if !netem.delay.is_zero() || netem.jitter.is_some() {
        let mut delay = format!("delay {}", time(netem.delay));
        if let Some(jitter) = netem.jitter {
            delay += &format!(" ± {}", time(jitter.deviation));
            if let Some(distribution) = jitter.distribution {
                delay += &format!(" {}", distribution.name());
            }
        }
        parts.push(delay);
    }
    match netem.loss {
        Loss::None => {}
        Loss::Independent { rate } => parts.push(format!("loss {}", percent(rate))),
        Loss::GilbertElliott { to_good, .. } => {
            let share = round(netem.loss.share() * 100.0);
            parts.push(format!("loss {share} % in bursts of {}", round(1.0 / to_good.get())));
        }
    }
    let shares =
        [("duplicate", netem.duplication), ("corrupt", netem.corruption), ("reorder", netem.reordering)];
    parts.extend(
        shares.iter().filter(|(_, p)| p.get() > 0.0).map(|(name, p)| format!("{name} {}", percent(*p))),
    );
    parts.extend(netem.rate.map(|rate| format!("rate {rate}")));
    parts.push(format!("limit {}", netem.limit()));
    if !netem.in_order {
        parts.push("unordered".to_owned());
    }
    parts.join(", ")
}

/// Returns a table of all rules.
pub fn table(devices: &[Device]) -> String {
    let mut table = Table::new("<<<>>>");
    table.row(["interface", "packets", "conditions", "sent", "dropped", "waiting"]);
    let mut empty = true;
    for device in devices {
        for (rule, Counters { packets: sent, dropped, waiting, .. }) in device.rules() {
            empty = false;
            let cells = [device.interface().name.clone(), packets(&rule), conditions(&rule.netem)];
            table.row(cells.into_iter().chain([sent, dropped, waiting].map(|n| n.to_string())));
        }
    }
    if empty { "no conditions\n".to_owned() } else { table.render("") }
}

/// Returns all rules as JSON.
pub fn json(devices: &[Device]) -> Value {
    let rules = |device: &Device| {
        let name = device.interface().name.clone();
        device.rules().map(move |(rule, counters)| of_rule(&name, &rule, counters)).collect::<Vec<_>>()
    };
    devices.iter().flat_map(rules).collect()
}

fn of_rule(interface: &str, rule: &Rule, counters: Counters) -> Value {
    let netem = &rule.netem;
    let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
    let loss = match netem.loss {
        Loss::None => json!({ "kind": "none" }),
        Loss::Independent { rate } => json!({ "kind": "independent", "rate": rate }),
        Loss::GilbertElliott { to_bad, to_good, lost_in_bad, lost_in_good } => json!({
            "kind": "gilbert_elliott", "rate": netem.loss.share(), "to_bad": to_bad, "to_good": to_good,
            "lost_in_bad": lost_in_bad, "lost_in_good": lost_in_good,
        }),
    };
    json!({
        "interface": interface,
        "side": rule.side,
        "network": rule.network.map(|network| format!("{network:#}")),
        "delay_ms": ms(netem.delay),
        "jitter": netem.jitter.map(|jitter| {
            json!({ "deviation_ms": ms(jitter.deviation), "distribution": jitter.distribution })
        }),
        "loss": loss,
        "duplication": netem.duplication,
        "corruption": netem.corruption,
        "reordering": netem.reordering,
        "rate_bps": netem.rate,
        "limit": netem.limit(),
        "seed": netem.seed,
        "in_order": netem.in_order,
        "counters": {
            "packets": counters.packets, "bytes": counters.bytes, "dropped": counters.dropped,
            "waiting": counters.waiting,
        },
    })
}
