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
use parking_lot::Mutex;

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
    on_context: impl Fn(MachineContext) + Send + Sync + 'static,
) -> mpsc::Sender<Command> {
    let (commands, inbox) = mpsc::channel();
    let controller = Controller::new(RUN, LEASE, Vec::new(), lab.agents.iter().cloned());
    let controller = Arc::new(Mutex::new(controller));
    let (arrived, clocks) = (commands.clone(), Arc::clone(&controller));
    let receiver: Receiver = Arc::new(move |agent, message, waiting| match message {
        FromAgent::Context(bytes) => {
            let MachineReading { boot, read_ns, mut context, .. } = MachineReading::decode(&bytes).unwrap();
            assert!(context.is_valid());
            context.reading = clocks.lock().core_time(&agent, boot, read_ns);
            on_context(context);
        }
        message => arrived.send(Command::Arrived(agent, message, waiting)).unwrap(),
    });
    let core = lab.core();
    let credentials = Credentials {
        authority: &core.authority_pem,
        certificate: &core.certificate_pem,
        key: &core.key_pem,
    };
    let router =
        Router::open(lab.address(), credentials, &lab.granted(), BTreeMap::new(), &receiver).unwrap();
    thread::spawn(move || run(router, &controller, &inbox, on_event));
    commands
}

fn run(
    router: Router,
    controller: &Mutex<Controller>,
    inbox: &mpsc::Receiver<Command>,
    on_event: impl Fn(ControllerEvent),
) {
    let began = Instant::now();
    let now = || Timestamp::ZERO + began.elapsed();
    loop {
        controller.lock().advance(now());
        loop {
            let Some(transmit) = controller.lock().poll_transmit(now()) else { break };
            router.send(&transmit);
        }
        loop {
            let Some(event) = controller.lock().poll_event() else { break };
            on_event(event);
        }
        let deadline = controller.lock().next_deadline();
        match inbox.recv_timeout(deadline.since(now())) {
            Ok(Command::Start(agent, instance, wanted)) => {
                controller.lock().start(&agent, instance, *wanted).unwrap();
            }
            Ok(Command::Stop(instance)) => controller.lock().stop(instance),
            Ok(Command::Arrived(agent, message, _waiting)) => match message {
                FromAgent::Connection { boot, is_there } => {
                    controller.lock().connection(now(), &agent, boot, is_there);
                }
                FromAgent::Report(report) => controller.lock().receive(now(), &agent, report),
                FromAgent::Rejected(reason) => panic!("{reason}"),
                FromAgent::Context(_) | FromAgent::Reading(_) | FromAgent::Turn(_) => unreachable!(),
            },
            Err(mpsc::RecvTimeoutError::Timeout) => {}
            Err(mpsc::RecvTimeoutError::Disconnected) => return,
        }
    }
}
