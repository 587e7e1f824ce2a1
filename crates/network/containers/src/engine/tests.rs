//! Instances of an engine in memory, in virtual time.

use std::{net::TcpListener, time::Duration};

use cotorra_graph::{Image, Pull, Transport};
use tempfile::TempDir;
use tokio::{
    sync::Notify,
    task::{JoinHandle, spawn_local},
    time::{Instant, sleep},
};

use super::*;
use crate::{
    daemon::tests::{Answer, at_once, serve, version},
    spec::tests::vnf,
};

/// A node in the machine's network.
#[derive(Default)]
struct Here(Notify);

impl Surroundings for Here {
    fn network(&self, _node: &NodeId) -> Result<Network, String> {
        Ok(Network::Machine)
    }

    fn wake(&self) {
        self.0.notify_one();
    }
}

struct Lab {
    commands: mpsc::UnboundedSender<Command>,
    serving: JoinHandle<bool>,
    events: events::Receiver<EngineEvent>,
    here: Arc<Here>,
    /// Whether the engine hangs.
    hangs: Rc<Cell<bool>>,
    folder: TempDir,
}

impl Lab {
    fn new() -> Self {
        let (folder, hangs) = (TempDir::new().unwrap(), Rc::new(Cell::new(false)));
        let does_hang = Rc::clone(&hangs);
        let hung = move |request: &str| if does_hang.get() { Answer::new() } else { answer(request) };
        let (kind, address) = (EngineKind::Podman, Address::Socket(serve(&folder, hung)));
        let marker = Arc::new(Marker::create_in(folder.path(), kind, &address).unwrap());
        let logs = folder.path().to_owned();
        let settings = Settings { kind, address, folder: logs.clone(), logs, guard: None };
        let (report, events) = events::channel();
        let here = Arc::new(Here::default());
        let surroundings: Arc<dyn Surroundings> = Arc::<Here>::clone(&here);
        let (daemon, holders, is_last) = (Mutex::default(), Holders::default(), Cell::new(false));
        let registries = Registries::default();
        let tasks = Tasks { settings, surroundings, marker, report, daemon, holders, registries, is_last };
        let tasks = Rc::new(tasks);
        let (commands, inbox) = mpsc::unbounded_channel();
        Self { commands, serving: spawn_local(tasks.serve(inbox)), events, here, hangs, folder }
    }

    fn start(&self, instance: u64, vnf: Vnf) {
        let log = File::create(self.folder.path().join("log")).unwrap();
        let node = vnf.node.first().clone();
        let wanted = Wanted { vnf, replica: 0, node, network: Network::Machine, log };
        let start = Command::Start(InstanceId(instance), Box::new(wanted), Arc::new(()));
        self.commands.send(start).ok().unwrap();
    }

    async fn next(&self) -> (u64, Outcome) {
        loop {
            match self.events.try_recv() {
                Ok(event) => return (event.instance.0, event.outcome),
                Err(_) => self.here.0.notified().await,
            }
        }
    }
}

/// Answers as an engine whose containers are this process.
fn answer(request: &str) -> Answer {
    let running = format!(r#"{{"State":{{"Running":true,"Pid":{}}}}}"#, process::id());
    version(request).unwrap_or_else(|| match request {
        _ if request.contains("/images/create") => {
            at_once("500 Internal Server Error", r#"{"message":"it was pulled"}"#)
        }
        _ if request.contains("/create") => at_once("201 Created", r#"{"Id":"1","Warnings":[]}"#),
        _ if request.contains("/start") => at_once("204 No Content", ""),
        _ if request.contains("/json") => at_once("200 OK", &running),
        // Its output has not begun.
        _ => Answer::new(),
    })
}

#[tokio::test(start_paused = true)]
async fn a_run_ends_soon_though_its_engine_hangs() {
    let test = async {
        let lab = Lab::new();
        lab.start(1, vnf());
        assert_eq!(lab.next().await, (1, Outcome::Ready));
        lab.hangs.set(true);
        let began = Instant::now();
        lab.start(2, vnf());
        let why = "cannot start its container: the engine hangs: it did not answer within 20 s".to_owned();
        assert_eq!(lab.next().await, (2, Outcome::Failed(why)));
        assert_eq!(began.elapsed(), ANSWER);
        // It is to be removed, again and again.
        sleep(ANSWER * 10).await;
        let began = Instant::now();
        drop(lab.commands);
        assert!(!lab.serving.await.unwrap(), "containers may be left");
        assert!(began.elapsed() <= ANSWER, "{:?}", began.elapsed());
    };
    LocalSet::new().run_until(test).await;
}

#[tokio::test(start_paused = true)]
async fn an_engine_that_no_longer_hangs_starts_instances() {
    let test = async {
        let lab = Lab::new();
        lab.hangs.set(true);
        lab.start(1, vnf());
        let why = "the engine hangs: it did not answer within 20 s".to_owned();
        assert_eq!(lab.next().await, (1, Outcome::Failed(why)));
        lab.hangs.set(false);
        lab.start(2, vnf());
        assert_eq!(lab.next().await, (2, Outcome::Ready));
    };
    LocalSet::new().run_until(test).await;
}

#[tokio::test(start_paused = true)]
async fn an_image_does_not_start_while_another_program_has_its_port() {
    let test = async {
        let lab = Lab::new();
        let other = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = ListenPort { port: other.local_addr().unwrap().port(), transport: Transport::Tcp };
        let image = Image { ports: vec![port], ..Image::default() };
        let vnf = Vnf { image: Some(Box::new(image)), ..vnf() };
        lab.start(1, vnf.clone());
        let taken = format!("another program of the machine listens at port {port}");
        assert_eq!(lab.next().await, (1, Outcome::Failed(taken)));
        drop(other);
        lab.start(2, vnf);
        sleep(Duration::from_secs(1)).await;
        let _container = TcpListener::bind(("127.0.0.1", port.port)).unwrap();
        assert_eq!(lab.next().await, (2, Outcome::Ready));
    };
    LocalSet::new().run_until(test).await;
}

#[tokio::test(start_paused = true)]
async fn an_image_of_another_registry_is_never_pulled() {
    let test = async {
        let lab = Lab::new();
        let image =
            Image { reference: "127.0.0.1:5000/x".to_owned(), pull: Pull::Always, ..Image::default() };
        lab.start(1, Vnf { image: Some(Box::new(image)), ..vnf() });
        let (_, outcome) = lab.next().await;
        let Outcome::Failed(why) = outcome else { panic!("{outcome:?}") };
        assert!(why.contains("start cotorra with COTORRA_REGISTRIES=127.0.0.1:5000"), "{why}");
    };
    LocalSet::new().run_until(test).await;
}
