//! Both ends as cotorra has them.

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc,
    },
    time::Instant,
};

use cotorra_agent_protocol::{Action, Agent, ControllerEvent, MachineReading};
use cotorra_agent_transport::{Credentials, Dialer, FromCore};
use cotorra_enrolment::CORE_COMMON_NAME;
use cotorra_graph::{MachineContext, Timestamp};

use crate::{
    core,
    lab::Lab,
    load::{COUNTED, Schedule, serve_agents, serve_core},
};

pub fn core(folder: &Path) {
    let (join, joined) = mpsc::channel();
    let counted = Arc::new(AtomicU64::new(0));
    let counts = Arc::clone(&counted);
    let on_event = move |event| {
        if let ControllerEvent::Joined(_) = event {
            join.send(()).unwrap();
        }
    };
    let on_context = move |context: MachineContext| {
        if context.node == COUNTED {
            counts.fetch_add(1, Ordering::Relaxed);
        }
    };
    let _commands = core::start(&Lab::open(folder), on_event, on_context);
    serve_core(&joined, &counted);
}

pub fn agents(folder: &Path) {
    serve_agents(&Arc::new(Lab::open(folder)), agent);
}

fn agent(lab: &Lab, number: usize, mut schedule: Schedule) {
    let bundle = lab.bundle(&lab.agents[number]);
    let credentials = Credentials {
        authority: bundle.authority_pem(),
        certificate: bundle.certificate_pem(),
        key: bundle.key_pem(),
    };
    let (messages, inbox) = mpsc::channel();
    let receive = move |message| drop(messages.send(message));
    let (core, name) = (bundle.core().to_string(), lab.agents[number].clone());
    let mut dialer = Dialer::open(&core, CORE_COMMON_NAME, name, credentials, receive).unwrap();
    let began = Instant::now();
    let now = || Timestamp::ZERO + began.elapsed();
    let boot = number as u64 + 1;
    let mut agent = Agent::new(now(), boot, None);
    loop {
        agent.advance(now());
        while let Some(action) = agent.poll(now()) {
            if let Action::Report(report) = action {
                dialer.report(&report);
            }
        }
        if let Some(context) = schedule.poll()
            && agent.run().is_some()
        {
            let reading = MachineReading {
                boot,
                read_ns: now().as_nanos(),
                context,
                links: Default::default(),
                heard: Default::default(),
                addresses: Default::default(),
            };
            dialer.context(reading.encode());
        }
        let deadline = agent.next_deadline().since(now());
        match inbox.recv_timeout(deadline.min(schedule.next().saturating_duration_since(Instant::now()))) {
            Ok(FromCore::Wanted(wanted)) => agent.want(now(), *wanted),
            Ok(FromCore::Beat(beat)) => agent.beat(now(), beat),
            Ok(FromCore::Rejected(reason)) => panic!("{reason}"),
            Ok(FromCore::Command(_)) => unreachable!("no robot is there"),
            Err(_) => {}
        }
    }
}
