//! The contract of [`Engine`], as tests that every engine passes.
//!
//! A test of an engine implements [`Subject`] and calls [`check`]. VNFs of the contract are small scripts for `sh`, of this
//! machine or of an image such as busybox. An engine that does not do what it promises makes the check panic, or wait for
//! ever.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt, fs, process,
    sync::atomic,
    thread,
};

use cotorra_graph::{Image, ListenPort, NodeId, Program, Pull, Rights, Transport, Vnf, VnfId};

use crate::{Engine, EngineEvent, InstanceId, Outcome, replica_name};

/// An engine under test, and what is around it.
pub trait Subject {
    /// The engine under test.
    type Engine: Engine;

    /// Creates an engine without instances. All write their logs into the same folder.
    fn engine(&self) -> Self::Engine;

    /// Blocks until an engine has woken its owner since the last call.
    fn wait(&self);

    /// Returns two nodes that can run instances.
    fn nodes(&self) -> [NodeId; 2];

    /// Returns the image whose containers run the scripts, with `sh`, `echo` and `sleep`; `None` for plain processes.
    fn image(&self) -> Option<Image>;

    /// Returns the content of a log; empty if there is none. `name` has no `.log`.
    fn log(&self, name: &str) -> String;

    /// Makes each later write to a log fail as on a full disk, for example by a link to `/dev/full` in its place. It is called
    /// before the first start. Returns whether it could.
    fn fill_disk(&self, _log: &str) -> bool {
        false
    }

    /// Returns a VNF that ends with status 3 before it is ready; `None` if every VNF is ready at once. By default, a
    /// container that never listens at its port.
    fn ends_before_ready(&self, id: VnfId) -> Option<Vnf> {
        let ports = vec![ListenPort { port: 9, transport: Transport::Tcp }];
        let image = Image { ports, ..self.image()? };
        Some(Vnf { image: Some(Box::new(image)), ..vnf(self, id.as_str(), &["sh", "-c", "exit 3"]) })
    }

    /// Returns the number of processes with this mark. By default, those of this machine.
    fn running(&self, _engine: &Self::Engine, mark: Mark) -> usize {
        processes(mark)
    }

    /// Returns the promises that the engine does not make, or that cannot be checked here, each with the reason.
    fn omitted(&self) -> Vec<(Promise, String)> {
        Vec::new()
    }
}

/// Argument of the processes of a script by which they are found on this machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mark(u32);

impl Mark {
    /// Creates a mark that no other process has. It is the time for which they sleep, s.
    fn new() -> Self {
        static NEXT: atomic::AtomicU32 = atomic::AtomicU32::new(0);
        let next = NEXT.fetch_add(1, atomic::Ordering::Relaxed);
        Self(1_000_000_000 + process::id() % 1_000_000 * 1000 + next % 1000)
    }
}

impl fmt::Display for Mark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Returns the number of processes of this machine that have a mark as one of their arguments.
pub fn processes(mark: Mark) -> usize {
    let mark = mark.to_string();
    let has_mark = |process: &fs::DirEntry| {
        let words = fs::read(process.path().join("cmdline")).unwrap_or_default();
        words.split(|byte| *byte == 0).any(|word| word == mark.as_bytes())
    };
    fs::read_dir("/proc").into_iter().flatten().flatten().filter(has_mark).count()
}

/// A promise of an engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Promise {
    /// A start reports one `Ready`, and the instance goes on.
    Starts,
    /// An instance that ends is reported as `Died`, with its status.
    Ends,
    /// An instance that ends before it is ready is reported as `Failed`, with its status.
    EndsBeforeReady,
    /// A start without its program or image fails, and the reason names it.
    Missing,
    /// The engine ignores a stop of an unknown instance, a stopped one, and one that ended.
    IgnoresUnknown,
    /// A stopped instance ends, also if it ignores SIGTERM.
    Stops,
    /// The children of an instance end with it, whether it is stopped or ends by itself.
    Children,
    /// A child with a session of its own ends with its instance, too.
    Daemons,
    /// An instance can be stopped while it starts.
    StopsDuringStart,
    /// A stopped instance's successor can start at once, on the same node as the same replica.
    Restarts,
    /// [`Engine::shut_down`] returns once all instances have ended.
    ShutsDown,
    /// The drop of an engine returns once all instances have ended.
    Drops,
    /// `<vnf>.log` has the line `--- instance N on NODE` for each instance, and then what it writes to standard output and
    /// standard error.
    Log,
    /// Instances have the variables `COTORRA_VNF`, `COTORRA_NODE` and `COTORRA_REPLICA`, and those given by the VNF.
    Environment,
    /// Two replicas on two nodes run, stop and write logs independently. Replicas from 1 write to `<vnf>@<replica>.log`.
    Replicas,
    /// An instance that takes more memory than its limit is killed, and reported as `Died`.
    MemoryLimit,
    /// An instance goes on if its log cannot be written.
    FullDisk,
    /// A VNF runs on its old and its new node until the old instance is stopped.
    Migration,
}

impl Promise {
    /// All promises.
    pub const ALL: [Self; 18] = [
        Self::Starts,
        Self::Ends,
        Self::EndsBeforeReady,
        Self::Missing,
        Self::IgnoresUnknown,
        Self::Stops,
        Self::Children,
        Self::Daemons,
        Self::StopsDuringStart,
        Self::Restarts,
        Self::ShutsDown,
        Self::Drops,
        Self::Log,
        Self::Environment,
        Self::Replicas,
        Self::MemoryLimit,
        Self::FullDisk,
        Self::Migration,
    ];

    /// Checks that an engine keeps the promise, even if the subject omits it. Panics if it does not.
    pub fn check<S: Subject + ?Sized>(self, subject: &S) {
        let mut run = Run::new(subject);
        match self {
            Self::Starts => starts(&mut run),
            Self::Ends => ends(&mut run),
            Self::EndsBeforeReady => ends_before_ready(&mut run),
            Self::Missing => missing(&mut run),
            Self::IgnoresUnknown => ignores_unknown(&mut run),
            Self::Stops => stops(&mut run),
            Self::Children => children(&mut run),
            Self::Daemons => daemons(&mut run),
            Self::StopsDuringStart => stops_during_start(&mut run),
            Self::Restarts => restarts(&mut run),
            Self::ShutsDown => shuts_down(&mut run),
            Self::Drops => return drops(run),
            Self::Log => log(&mut run),
            Self::Environment => environment(&mut run),
            Self::Replicas => replicas(&mut run),
            Self::MemoryLimit => memory_limit(&mut run),
            Self::FullDisk => full_disk(&mut run),
            Self::Migration => migration(&mut run),
        }
        run.end();
    }
}

/// Checks all promises that the subject does not omit. Panics if the engine breaks one.
pub fn check<S: Subject + ?Sized>(subject: &S) {
    let omitted: BTreeMap<_, _> = subject.omitted().into_iter().collect();
    for promise in Promise::ALL {
        match omitted.get(&promise) {
            Some(reason) => eprintln!("{promise:?}: skipped, because {reason}"),
            None => {
                eprintln!("{promise:?}");
                promise.check(subject);
            }
        }
    }
}

/// Goes on until it is stopped. SIGTERM ends it.
fn serve(mark: Mark) -> String {
    format!("trap 'exit 0' TERM; sleep {mark} & wait")
}

/// Goes on until it is killed.
fn stubborn(mark: Mark) -> String {
    format!("trap '' TERM; exec sleep {mark}")
}

/// Returns a VNF of these words, in the subject's image.
fn vnf<S: Subject + ?Sized>(subject: &S, id: &str, words: &[&str]) -> Vnf {
    let [node, _] = subject.nodes();
    Vnf {
        id: VnfId::new(id).expect("names of the contract are valid"),
        program: Program::Command(words.iter().map(ToString::to_string).collect()),
        cpus: 1.0,
        memory_bytes: 64 << 20,
        pinned_to: None,
        node: node.into(),
        env: Vec::new(),
        rights: Rights::default(),
        keep: false,
        image: subject.image().map(Box::new),
        cpu_limit: None,
        start: Default::default(),
        computing: None,
        state: None,
    }
}

/// An engine, and what it reported.
struct Run<'a, S: Subject + ?Sized> {
    subject: &'a S,
    engine: S::Engine,
    started: u64,
    outcomes: BTreeMap<InstanceId, Vec<Outcome>>,
    /// Instances that may end.
    may_end: BTreeSet<InstanceId>,
}

impl<'a, S: Subject + ?Sized> Run<'a, S> {
    fn new(subject: &'a S) -> Self {
        let (outcomes, may_end) = (BTreeMap::new(), BTreeSet::new());
        Self { subject, engine: subject.engine(), started: 0, outcomes, may_end }
    }

    /// Whether the subject does not omit a promise.
    fn keeps(&self, promise: Promise) -> bool {
        self.subject.omitted().iter().all(|(omitted, _)| *omitted != promise)
    }

    fn script(&self, id: &str, script: &str) -> Vnf {
        vnf(self.subject, id, &["sh", "-c", script])
    }

    /// Starts an instance. A start that is impossible counts as a failed one.
    fn start(&mut self, vnf: &Vnf, replica: u32, node: usize) -> InstanceId {
        self.started += 1;
        let id = InstanceId(self.started);
        self.outcomes.insert(id, Vec::new());
        let node = &self.subject.nodes()[node];
        if let Err(reason) = self.engine.start(id, vnf, replica, node) {
            self.note(EngineEvent { instance: id, outcome: Outcome::Failed(reason) });
        }
        id
    }

    /// Starts an instance, and waits until it is ready.
    fn ready(&mut self, vnf: &Vnf, replica: u32, node: usize) -> InstanceId {
        let id = self.start(vnf, replica, node);
        let outcomes = self.wait_for(id, |outcomes| !outcomes.is_empty());
        assert_eq!(outcomes[0], Outcome::Ready, "instance {} of {} does not start", id.0, vnf.id);
        id
    }

    fn stop(&mut self, id: InstanceId) {
        self.may_end.insert(id);
        self.engine.stop(id);
    }

    /// Records an event. Panics if it comes out of order.
    fn note(&mut self, EngineEvent { instance, outcome }: EngineEvent) {
        let before = self.outcomes.get_mut(&instance);
        let before = before.unwrap_or_else(|| panic!("{outcome:?} of {instance:?}, which was not started"));
        let is_next = match &outcome {
            Outcome::Ready | Outcome::Failed(_) => before.is_empty(),
            Outcome::Died(_) => before[..] == [Outcome::Ready],
        };
        assert!(is_next, "{outcome:?} of {instance:?} after {before:?}");
        before.push(outcome);
    }

    fn poll(&mut self) {
        while let Some(event) = self.engine.poll() {
            self.note(event);
        }
    }

    /// Waits for outcomes of an instance. The engine wakes its owner for each.
    fn wait_for(&mut self, id: InstanceId, is_enough: impl Fn(&[Outcome]) -> bool) -> Vec<Outcome> {
        loop {
            self.poll();
            let outcomes = &self.outcomes[&id];
            if is_enough(outcomes) {
                return outcomes.clone();
            }
            self.subject.wait();
        }
    }

    /// Waits for the end of an instance that is not stopped. Returns the reason, and whether it was ready before.
    fn wait_for_end(&mut self, id: InstanceId) -> (String, bool) {
        self.may_end.insert(id);
        let is_end = |outcome: &Outcome| !matches!(outcome, Outcome::Ready);
        let outcomes = self.wait_for(id, |outcomes| outcomes.iter().any(is_end));
        match &outcomes[..] {
            [Outcome::Ready, Outcome::Died(reason)] => (reason.clone(), true),
            [Outcome::Failed(reason)] => (reason.clone(), false),
            _ => unreachable!("Run::note checks the order"),
        }
    }

    /// Polls, and panics if an instance ended that should go on.
    fn poll_running(&mut self) {
        self.poll();
        for (id, outcomes) in self.outcomes.iter().filter(|(id, _)| !self.may_end.contains(id)) {
            let goes_on = matches!(outcomes[..], [] | [Outcome::Ready]);
            assert!(goes_on, "instance {} ended without a stop: {outcomes:?}", id.0);
        }
    }

    /// Waits until so many processes with a mark run. Their number changes without an event.
    fn until_running(&mut self, mark: Mark, count: usize) {
        while self.subject.running(&self.engine, mark) != count {
            self.poll_running();
            thread::yield_now();
        }
    }

    /// Waits until a log has a line. It can come without an event.
    fn until_logged(&mut self, log: &str, line: &str) {
        while !self.subject.log(log).lines().any(|its| its == line) {
            self.poll_running();
            thread::yield_now();
        }
    }

    /// Ends all instances. Panics if events that were left break the contract.
    fn end(mut self) {
        self.engine.shut_down();
        self.poll();
    }
}

fn starts<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let mark = Mark::new();
    let vnf = run.script("contract-starts", &serve(mark));
    run.ready(&vnf, 0, 0);
    run.until_running(mark, 1);
    run.poll_running();
}

fn ends<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let vnf = run.script("contract-ends", "exit 3");
    let id = run.start(&vnf, 0, 0);
    // An engine that waits for its readiness may find that it has ended already.
    let (reason, _) = run.wait_for_end(id);
    assert!(reason.contains("status 3"), "{reason}");
}

fn ends_before_ready<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let id = VnfId::new("contract-ends-early").expect("it is a name");
    let Some(vnf) = run.subject.ends_before_ready(id) else { return };
    let id = run.start(&vnf, 0, 0);
    let (reason, was_ready) = run.wait_for_end(id);
    assert!(!was_ready, "it was reported as ready");
    assert!(reason.contains("status 3"), "{reason}");
}

fn missing<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    const PROGRAM: &str = "/nowhere/contract";
    const IMAGE: &str = "localhost/cotorra/nowhere:contract";
    let program = vnf(run.subject, "contract-missing", &[PROGRAM]);
    let image =
        run.subject.image().map(|image| Image { reference: IMAGE.to_owned(), pull: Pull::Never, ..image });
    let image = image.map(|image| Vnf { image: Some(Box::new(image)), ..program.clone() });
    for (vnf, name) in [(Some(program), PROGRAM), (image, IMAGE)] {
        let Some(vnf) = vnf else { continue };
        let id = run.start(&vnf, 0, 0);
        let (reason, was_ready) = run.wait_for_end(id);
        assert!(!was_ready, "a VNF without {name} was reported as ready");
        assert!(reason.contains(name), "the reason does not name {name}: {reason}");
    }
}

fn ignores_unknown<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let mark = Mark::new();
    run.stop(InstanceId(4711));
    let ends = run.script("contract-unknown", "exit 3");
    let ended = run.start(&ends, 0, 0);
    if run.keeps(Promise::Ends) {
        run.wait_for_end(ended);
    } else {
        run.stop(ended);
    }
    let vnf = run.script("contract-unknown", &serve(mark));
    let stopped = run.ready(&vnf, 0, 0);
    run.until_running(mark, 1);
    for id in [ended, InstanceId(4711), stopped, stopped] {
        run.stop(id);
    }
    run.until_running(mark, 0);
    run.stop(stopped);
    run.ready(&vnf, 0, 0);
    run.until_running(mark, 1);
    run.stop(stopped);
    run.poll_running();
}

fn stops<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    for script in [serve, stubborn] {
        let mark = Mark::new();
        let vnf = run.script("contract-stops", &script(mark));
        let id = run.ready(&vnf, 0, 0);
        run.until_running(mark, 1);
        run.stop(id);
        run.until_running(mark, 0);
    }
}

fn children<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let mark = Mark::new();
    let child = format!("sh -c 'sleep {mark} & sleep {mark}' & sleep {mark} &");
    let vnf = run.script("contract-children", &format!("trap '' TERM; {child} wait"));
    let id = run.ready(&vnf, 0, 0);
    run.until_running(mark, 3);
    run.stop(id);
    run.until_running(mark, 0);
    let vnf = run.script("contract-children", &format!("trap '' TERM; {child} exit 3"));
    let id = run.start(&vnf, 0, 0);
    run.wait_for_end(id);
    run.until_running(mark, 0);
}

fn daemons<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let mark = Mark::new();
    let vnf = run.script("contract-daemons", &format!("setsid sleep {mark} & {}", serve(mark)));
    let id = run.ready(&vnf, 0, 0);
    run.until_running(mark, 2);
    run.stop(id);
    run.until_running(mark, 0);
}

fn stops_during_start<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let mark = Mark::new();
    let vnf = run.script("contract-cancelled", &serve(mark));
    for _ in 0..3 {
        let id = run.start(&vnf, 0, 0);
        run.stop(id);
    }
    run.ready(&vnf, 0, 0);
    run.until_running(mark, 1);
    run.poll_running();
}

fn restarts<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let mark = Mark::new();
    let vnf = run.script("contract-restarts", &stubborn(mark));
    let old = run.ready(&vnf, 0, 0);
    run.until_running(mark, 1);
    run.stop(old);
    let new = run.ready(&vnf, 0, 0);
    run.until_running(mark, 1);
    run.stop(new);
    run.until_running(mark, 0);
}

fn shuts_down<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let mark = Mark::new();
    let [vnf, other] = [serve, stubborn].map(|script| run.script("contract-shuts-down", &script(mark)));
    run.ready(&vnf, 0, 0);
    run.ready(&other, 1, 1);
    run.until_running(mark, 2);
    let stopped = run.ready(&other, 2, 0);
    run.until_running(mark, 3);
    run.stop(stopped);
    run.start(&vnf, 3, 1);
    run.engine.shut_down();
    assert_eq!(run.subject.running(&run.engine, mark), 0, "instances run after `shut_down`");
    run.poll();
    run.engine.shut_down();
}

fn drops<S: Subject + ?Sized>(mut run: Run<'_, S>) {
    let mark = Mark::new();
    let [vnf, other] = [serve, stubborn].map(|script| run.script("contract-drops", &script(mark)));
    run.ready(&vnf, 0, 0);
    run.ready(&other, 1, 1);
    run.until_running(mark, 2);
    run.start(&vnf, 2, 0);
    drop(run);
    assert_eq!(processes(mark), 0, "instances run after the drop of the engine");
}

fn log<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    const NAME: &str = "contract-log";
    let [a, b] = run.subject.nodes();
    let vnf = run.script(NAME, "echo said; echo wrong >&2; exit 3");
    let first = run.start(&vnf, 0, 0);
    run.wait_for_end(first);
    for line in ["said", "wrong"] {
        run.until_logged(NAME, line);
    }
    let mark = Mark::new();
    let vnf = run.script(NAME, &format!("echo again; {}", serve(mark)));
    let second = run.ready(&vnf, 0, 1);
    run.until_logged(NAME, "again");
    run.engine.shut_down();
    let log = run.subject.log(NAME);
    let headers = [(first, a), (second, b)].map(|(id, node)| format!("--- instance {} on {node}", id.0));
    let parts = log
        .split_once(&format!("{}\n", headers[1]))
        .and_then(|(former, latter)| Some((former.strip_prefix(&format!("{}\n", headers[0]))?, latter)));
    let Some((former, latter)) = parts else {
        panic!("the log does not begin with `{}`, or has no `{}`:\n{log}", headers[0], headers[1]);
    };
    // Both streams are in order, but not with each other.
    let mut former: Vec<_> = former.lines().collect();
    former.sort_unstable();
    assert_eq!((former, latter.lines().collect()), (vec!["said", "wrong"], vec!["again"]));
}

fn environment<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    const NAME: &str = "contract-environment";
    let [_, node] = run.subject.nodes();
    let script = "echo \"$COTORRA_VNF on $COTORRA_NODE as $COTORRA_REPLICA with $GIVEN\"";
    let vnf = Vnf { env: vec!["GIVEN=a value".to_owned()], ..run.script(NAME, script) };
    let id = run.start(&vnf, 7, 1);
    run.wait_for_end(id);
    let line = format!("{NAME} on {node} as 7 with a value");
    run.until_logged(&replica_name(&vnf.id, 7), &line);
}

fn replicas<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    const NAME: &str = "contract-replicas";
    let [a, b] = run.subject.nodes();
    let mark = Mark::new();
    let vnf = run.script(NAME, &format!("echo $COTORRA_NODE $COTORRA_REPLICA; {}", serve(mark)));
    let ids = [run.ready(&vnf, 0, 0), run.ready(&vnf, 1, 1)];
    run.until_running(mark, 2);
    let logs = [replica_name(&vnf.id, 0), replica_name(&vnf.id, 1)];
    let said = [format!("{a} 0"), format!("{b} 1")];
    if run.keeps(Promise::Log) {
        logs.iter().zip(&said).for_each(|(log, said)| run.until_logged(log, said));
        assert!(!run.subject.log(&logs[0]).contains(&said[1]), "replica 1 writes to the log of replica 0");
    }
    run.stop(ids[0]);
    run.until_running(mark, 1);
    run.poll_running();
    run.stop(ids[1]);
    run.until_running(mark, 0);
}

fn memory_limit<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    // Up to 512 MB, so that it ends without a limit, too.
    let script = "x=0123456789abcdef; i=0; while [ $i -lt 25 ]; do x=$x$x; i=$((i+1)); done; exit 5";
    let vnf = Vnf { memory_bytes: 32 << 20, ..run.script("contract-memory", script) };
    let id = run.start(&vnf, 0, 0);
    let (reason, _) = run.wait_for_end(id);
    assert!(!reason.contains("status 5"), "it took 512 MB, and its limit is 32 MB");
}

fn full_disk<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    const NAME: &str = "contract-full-disk";
    if !run.subject.fill_disk(NAME) {
        eprintln!("FullDisk: skipped, because the subject has no full disk");
        return;
    }
    // More than any pipe holds: it would stand still without a reader.
    let script = "x=0123456789abcdef; i=0; while [ $i -lt 16 ]; do x=$x$x; i=$((i+1)); done; \
                  echo $x || exit 5; echo $x || exit 5; exit 3";
    let vnf = run.script(NAME, script);
    let id = run.start(&vnf, 0, 0);
    let (reason, _) = run.wait_for_end(id);
    assert!(reason.contains("status 3"), "{reason}");
}

fn migration<S: Subject + ?Sized>(run: &mut Run<'_, S>) {
    let mark = Mark::new();
    let vnf = run.script("contract-migration", &serve(mark));
    let old = run.ready(&vnf, 0, 0);
    run.until_running(mark, 1);
    let new = run.ready(&vnf, 0, 1);
    run.until_running(mark, 2);
    run.poll_running();
    run.stop(old);
    run.until_running(mark, 1);
    run.poll_running();
    run.stop(new);
    run.until_running(mark, 0);
}
