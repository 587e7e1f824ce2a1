use super::*;
use cotorra_graph::{DecidesIn, Event, Instruction, NodeId, PluginDistance};
use cotorra_graph_testing as base;

struct Scripted(fn(&mut Actions));

impl Plugin for Scripted {
    fn handle(&mut self, _now: Timestamp, _event: &Event, actions: &mut Actions) {
        (self.0)(actions);
    }
}

/// Records faults, and counts instructions.
#[derive(Default)]
struct Faults(Vec<(PluginId, String)>, usize);

impl Controlled for Faults {
    fn instruct(&mut self, _now: Timestamp, _given: Given) -> Result<(), InstructionError> {
        self.1 += 1;
        Ok(())
    }

    fn cut_off(&mut self, _now: Timestamp, plugin: PluginId, fault: &Fault, _robots: &[NodeId]) {
        self.0.push((plugin, fault.to_string()));
    }

    fn publish(&mut self, _event: Stamped) {}
}

fn testbed() -> Arc<Testbed> {
    Arc::new(base::testbed(base::graph(Vec::new(), Vec::new())))
}

fn id() -> PluginId {
    "scripted".parse().unwrap()
}

/// Starts one plug-in in process. Returns its messages, too.
fn running(script: fn(&mut Actions)) -> (RunningPlugins, mpsc::Receiver<Message>) {
    running_at(script, Way::None)
}

fn spec(program: PluginProgram, way: Way) -> PluginSpec {
    PluginSpec {
        id: id(),
        program,
        domain: None,
        optional: false,
        instructions_per_second: Default::default(),
        distance: PluginDistance { way, decides_in: DecidesIn::fixed(Duration::from_secs(9)) },
        env: Vec::new(),
        settings: Default::default(),
    }
}

fn running_at(script: fn(&mut Actions), way: Way) -> (RunningPlugins, mpsc::Receiver<Message>) {
    let travel = Travel::in_real_time(&[spec(PluginProgram::Bundled("pace".to_owned()), way)]);
    let host = PluginHost::new([id()], LONGEST_CALL).with_travel(travel);
    let mut plugins = RunningPlugins::new(host, Ledgers::default());
    let (messages, said) = mpsc::channel();
    let now: Clock = Arc::new(|| Timestamp::from_secs_f64(1.0));
    plugins.spawn(id(), Box::new(Scripted(script)), &testbed(), None, &now, messages);
    let event = Event::Notice { message: String::new() };
    plugins.publish(Timestamp::ZERO, &Arc::new(Stamped { at: Timestamp::ZERO, event }));
    (plugins, said)
}

#[test]
fn an_instruction_arrives_with_its_reason() {
    let (_plugins, said) = running(|actions| {
        actions.instruct_because(Instruction::Scan { robot: "robot".parse().unwrap() }, "time to look");
    });
    let Message::Returned { plugin, outcome, .. } = said.recv().unwrap() else { panic!("no call") };
    let reason = outcome.unwrap().drain().next().unwrap().1;
    assert_eq!((plugin, reason.as_deref()), (id(), Some("time to look")));
}

#[test]
fn contexts_and_instructions_take_their_delay_in_real_time() {
    let way = Way::Delay { control_delay: Duration::from_millis(100) };
    let scan = |actions: &mut Actions| actions.instruct(Instruction::Scan { robot: "r".parse().unwrap() });
    let (mut plugins, said) = running_at(scan, way);
    let (at, mut core) = (Timestamp::from_secs_f64, Faults::default());
    assert_eq!(plugins.next_travel(), Some(at(0.1)));
    plugins.travel(at(0.1), &mut core);
    assert_eq!(plugins.next_travel(), None);
    let Message::Returned { plugin, handled, outcome, .. } = said.recv().unwrap() else { panic!("no call") };
    assert!(handled);
    plugins.handled(&plugin);
    plugins.returned(at(0.2), &plugin, outcome, &mut core);
    plugins.travel(at(0.29), &mut core);
    assert_eq!((core.1, plugins.next_travel()), (0, Some(at(0.3))), "the plug-in's own time counts");
    plugins.travel(at(0.3), &mut core);
    assert_eq!((core.1, plugins.next_travel()), (1, None));
}

#[test]
fn a_plugin_that_is_away_gets_its_next_context_when_it_has_handled_the_one_before() {
    let way = Way::Delay { control_delay: Duration::from_millis(100) };
    let (mut plugins, said) = running_at(|_| {}, way);
    let (at, mut core) = (Timestamp::from_secs_f64, Faults::default());
    let event = Event::Notice { message: String::new() };
    plugins.publish(at(0.05), &Arc::new(Stamped { at: at(0.05), event }));
    for later in [0.2, 0.3] {
        plugins.travel(at(later), &mut core);
        plugins.travel(at(later), &mut core);
        let Message::Returned { plugin, handled, outcome, .. } = said.recv().unwrap() else { panic!() };
        assert!(handled && outcome.unwrap().is_empty());
        assert!(said.try_recv().is_err(), "only one context was handed over");
        plugins.handled(&plugin);
    }
    assert_eq!(plugins.next_travel(), None);
}

#[test]
fn only_programs_that_are_away_have_a_stream_of_their_own() {
    let nodes = Way::Nodes { core: "edge".parse().unwrap(), plugin: "cloud".parse().unwrap() };
    let delay = Way::Delay { control_delay: Duration::from_millis(1) };
    let bundled = || PluginProgram::Bundled("pace".to_owned());
    let program = || PluginProgram::Command(vec!["true".to_owned()]);
    for (program, way, has_one) in [
        (program(), nodes.clone(), true),
        (program(), delay, true),
        (program(), Way::None, false),
        (bundled(), nodes, false),
    ] {
        let testbed = Testbed { plugins: vec![spec(program, way)], ..Testbed::clone(&testbed()) };
        assert_eq!(distant_programs(&testbed).contains_key(&id()), has_one, "{:?}", testbed.plugins);
    }
}

#[test]
fn a_panic_is_reported_and_ends_only_the_plugin() {
    let (_plugins, said) = running(|_| panic!("by design"));
    let Message::Returned { outcome, .. } = said.recv().unwrap() else { panic!("no report") };
    assert_eq!(outcome.unwrap_err().to_string(), "panicked: by design");
    assert!(said.recv().is_err(), "the plug-in's thread ended");
}

#[test]
fn a_plugin_that_does_not_return_is_cut_off() {
    // The plug-in hangs only later: the call that starts it makes it busy, too, and has to return.
    static HANGS: AtomicBool = AtomicBool::new(false);
    let (mut plugins, _said) = running(|_| {
        HANGS.store(true, Ordering::Release);
        loop {
            thread::park();
        }
    });
    while !HANGS.load(Ordering::Acquire) {
        thread::yield_now();
    }
    let mut told = Faults::default();
    plugins.check(Timestamp::from_secs_f64(2.9), &mut told);
    assert!(told.0.is_empty());
    plugins.check(Timestamp::from_secs_f64(3.1), &mut told);
    assert!(
        matches!(&told.0[..], [(who, why)] if *who == id() && why.contains("within 2 s")),
        "{:?}",
        told.0
    );
    let scan = Instruction::Scan { robot: "robot".parse().unwrap() };
    let refused = plugins.instruct(Timestamp::from_secs_f64(3.2), Given::new(id(), scan), &mut told);
    assert_eq!(refused, Err(InstructionError("this plug-in was cut off".to_owned())));
}
