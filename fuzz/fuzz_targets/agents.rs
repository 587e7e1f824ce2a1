//! What a core wants of an agent, and what an agent reports: no bytes panic either end. What an agent reports of anything that
//! it was told, the core takes.
#![no_main]

use cotorra_agent_protocol::{Action, Agent, Beat, Controller, LEASE, MachineReading, Report, Wanted};
use cotorra_graph::{AgentId, Timestamp};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let now = Timestamp::from_nanos(1 << 40);
    let name = AgentId::new("ap1").expect("a name");
    if let Ok(wanted) = Wanted::decode(bytes) {
        Wanted::decode(&wanted.encode()).expect("it was wanted");
        let mut agent = Agent::new(now, 1, Some(wanted.clone()));
        agent.want(now, Wanted { generation: wanted.generation.saturating_add(1), ..wanted });
        while let Some(action) = agent.poll(now) {
            if let Action::Report(report) = action {
                Report::decode(&report.encode()).expect("a report");
            }
        }
    }
    if let Ok(report) = Report::decode(bytes) {
        let mut controller = Controller::new(report.run, LEASE, Vec::new(), [name.clone()]);
        for _ in 0..2 {
            let report = Report::decode(&report.encode()).expect("it was a report");
            controller.receive(now, &name, report);
        }
        while controller.poll_event().is_some() || controller.poll_transmit(now).is_some() {}
    }
    if let Ok(beat) = Beat::decode(bytes) {
        assert_eq!(Beat::decode(&beat.encode()).expect("it was a beat"), beat);
    }
    if let Ok(reading) = MachineReading::decode(bytes) {
        MachineReading::decode(&reading.encode()).expect("it was a reading");
    }
});
