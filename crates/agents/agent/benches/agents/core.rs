//! The core's end as a run has it: a thread owns the router and the protocol's state.

use std::{
    collections::BTreeMap,
    sync::{Arc, mpsc},
    thread,
    time::Instant,
};

use cotorra_agent_protocol::{Controller, ControllerEvent, LEASE, MachineReading, Run, WantedInstance};
use cotorra_agent_transport::{Credentials, FromAgent, Receiver, Router};
use cotorra_engine::InstanceId;
use cotorra_graph::{AgentId, MachineContext, Timestamp};

use crate::lab::Lab;

const RUN: Run = Run(1);

pub enum Command {
    Start(AgentId, InstanceId, Box<WantedInstance>),
    Stop(InstanceId),
    Arrived(AgentId, FromAgent, Arc<()>),
}

/// Listens for the agents of a lab, and passes on what it has from them. Ends with the process.
pub fn start(
    lab: &Lab,
    on_event: impl Fn(ControllerEvent) + Send + 'static,
    on_context: impl Fn(MachineContext) + Send + 'static,
) -> mpsc::Sender<Command> {
    let (commands, inbox) = mpsc::channel();
    let arrived = commands.clone();
    let receiver: Receiver = Arc::new(move |agent, message, waiting| {
        arrived.send(Command::Arrived(agent, message, waiting)).unwrap();
    });
    let core = lab.core();
    let credentials = Credentials {
        authority: &core.authority_pem,
        certificate: &core.certificate_pem,
        key: &core.key_pem,
    };
    let router =
        Router::open(lab.address(), credentials, &lab.granted(), RUN, BTreeMap::new(), &receiver).unwrap();
    let controller = Controller::new(RUN, LEASE, Vec::new(), lab.agents.iter().cloned());
    thread::spawn(move || run(router, controller, &inbox, on_event, on_context));
    commands
}

fn run(
    router: Router,
    mut controller: Controller,
    inbox: &mpsc::Receiver<Command>,
    on_event: impl Fn(ControllerEvent),
    on_context: impl Fn(MachineContext),
) {
    let began = Instant::now();
    let now = || Timestamp::ZERO + began.elapsed();
    loop {
        controller.advance(now());
        while let Some(transmit) = controller.poll_transmit(now()) {
            router.send(RUN, &transmit).unwrap();
        }
        while let Some(event) = controller.poll_event() {
            on_event(event);
        }
        match inbox.recv_timeout(controller.next_deadline().since(now())) {
            Ok(Command::Start(agent, instance, wanted)) => {
                controller.start(&agent, instance, *wanted).unwrap();
            }
            Ok(Command::Stop(instance)) => controller.stop(instance),
            Ok(Command::Arrived(agent, message, _waiting)) => match message {
                FromAgent::Connection { boot, is_there } => {
                    controller.connection(now(), &agent, boot, is_there);
                }
                FromAgent::Report(report) => controller.receive(now(), &agent, report),
                FromAgent::Context(bytes) => {
                    let MachineReading { boot, read_ns, mut context, .. } =
                        MachineReading::decode(&bytes).unwrap();
                    assert!(context.is_valid());
                    context.reading = controller.core_time(&agent, boot, read_ns);
                    on_context(context);
                }
                FromAgent::Rejected(reason) => panic!("{reason}"),
                FromAgent::Reading(_) | FromAgent::Turn(_) => unreachable!("no robot is there"),
            },
            Err(mpsc::RecvTimeoutError::Timeout) => {}
            Err(mpsc::RecvTimeoutError::Disconnected) => return,
        }
    }
}
