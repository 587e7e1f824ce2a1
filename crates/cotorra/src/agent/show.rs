//! Agents as a table and as JSON.

use chrono::{DateTime, Local, SecondsFormat, Utc};
use cotorra_enrolment::{AgentState, Enrolled, Granted};
use serde_json::json;

use crate::table::Table;

/// Formats a time of day here.
pub fn local(time: DateTime<Utc>) -> String {
    time.with_timezone(&Local).format("%Y-%m-%d %H:%M:%S").to_string()
}

fn common_names<'a>(agent: &Enrolled, granted: &'a [Granted]) -> Vec<&'a str> {
    let its = granted.iter().filter(|granted| granted.name == agent.name);
    its.map(|granted| &*granted.common_name).collect()
}

pub fn table(agents: &[Enrolled], granted: &[Granted], now: DateTime<Utc>) -> String {
    if agents.is_empty() {
        return "no agent is enrolled\n".to_owned();
    }
    let mut table = Table::new("<<><<");
    table.row(["agent", "state", "generation", "until", "may connect"]);
    for agent in agents {
        let state = match agent.state {
            AgentState::Revoked => "revoked",
            AgentState::Enrolled if now < agent.not_after => "enrolled",
            AgentState::Enrolled => "expired",
        };
        table.row([
            agent.name.to_string(),
            state.to_owned(),
            agent.generation.to_string(),
            local(agent.not_after),
            common_names(agent, granted).join(", "),
        ]);
    }
    table.render("")
}

pub fn json(agents: &[Enrolled], granted: &[Granted]) -> String {
    let object = |agent: &Enrolled| {
        json!({
            "name": agent.name,
            "state": agent.state,
            "generation": agent.generation,
            "not_after": agent.not_after.to_rfc3339_opts(SecondsFormat::Secs, true),
            "granted": common_names(agent, granted),
        })
    };
    format!("{:#}\n", json!(agents.iter().map(object).collect::<Vec<_>>()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agents() -> ([Enrolled; 3], [Granted; 2], DateTime<Utc>) {
        let now = DateTime::from_timestamp(1_800_000_000, 0).unwrap();
        let agent = |name: &str, generation, seconds, state| Enrolled {
            name: name.parse().unwrap(),
            generation,
            not_after: DateTime::from_timestamp(1_800_000_000 + i64::from(seconds), 0).unwrap(),
            state,
        };
        let agents = [
            agent("edge", 1, 0, AgentState::Enrolled),
            agent("robot", 2, 60, AgentState::Enrolled),
            agent("spy", 7, 60, AgentState::Revoked),
        ];
        let granted = ["robot.1", "robot.2"].map(|common_name| Granted {
            name: "robot".parse().unwrap(),
            common_name: common_name.to_owned(),
        });
        (agents, granted, now)
    }

    #[test]
    fn the_table_says_who_may_connect() {
        let (agents, granted, now) = agents();
        let text = table(&agents, &granted, now);
        let lines: Vec<Vec<_>> = text
            .lines()
            .map(|line| line.split("  ").map(str::trim).filter(|cell| !cell.is_empty()).collect())
            .collect();
        let [end, later] = [agents[0].not_after, agents[1].not_after].map(local);
        assert_eq!(lines[1], ["edge", "expired", "1", &end]);
        assert_eq!(lines[2], ["robot", "enrolled", "2", &later, "robot.1, robot.2"]);
        assert_eq!(lines[3], ["spy", "revoked", "7", &later]);
        assert_eq!(table(&[], &[], now), "no agent is enrolled\n");
    }

    #[test]
    fn json_has_times_in_utc_and_common_names() {
        let (agents, granted, _) = agents();
        let read: serde_json::Value = serde_json::from_str(&json(&agents, &granted)).unwrap();
        let expected = json!({
            "name": "robot", "state": "enrolled", "generation": 2,
            "not_after": "2027-01-15T08:01:00Z", "granted": ["robot.1", "robot.2"],
        });
        assert_eq!(read[1], expected);
        assert_eq!((&read[2]["state"], &read[2]["granted"]), (&json!("revoked"), &json!([])));
    }
}
