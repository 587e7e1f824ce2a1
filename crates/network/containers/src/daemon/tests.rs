//! Engines that hang, in virtual time.

use std::{path::PathBuf, time::Duration};

use tempfile::TempDir;
use tokio::{
    io::{AsyncBufReadExt as _, AsyncReadExt as _, AsyncWriteExt as _, BufReader},
    net::{UnixListener, UnixStream},
    task::{LocalSet, spawn_local},
    time::{Instant, sleep},
};

use super::*;

/// An engine's answer to a request such as `GET /version`, each part after a delay. It hangs after the last one.
pub(crate) type Answer = Vec<(Duration, String)>;

/// Returns an answer that comes at once.
pub(crate) fn at_once(status: &str, content: &str) -> Answer {
    let head =
        format!("HTTP/1.1 {status}\r\ncontent-type: application/json\r\ncontent-length: {}", content.len());
    vec![(Duration::ZERO, format!("{head}\r\n\r\n{content}"))]
}

/// Serves an engine's interface at a socket in a folder, which it returns.
pub(crate) fn serve(folder: &TempDir, answer: impl Fn(&str) -> Answer + 'static) -> PathBuf {
    let socket = folder.path().join("socket");
    let (listener, answer) = (UnixListener::bind(&socket).unwrap(), Rc::new(answer));
    spawn_local(async move {
        while let Ok((stream, _)) = listener.accept().await {
            let answer = Rc::clone(&answer);
            // The other end may be gone.
            spawn_local(async move { converse(BufReader::new(stream), &*answer).await.ok() });
        }
    });
    socket
}

async fn converse(mut stream: BufReader<UnixStream>, answer: &dyn Fn(&str) -> Answer) -> std::io::Result<()> {
    loop {
        let (mut request, mut length) = (String::new(), 0);
        if stream.read_line(&mut request).await? == 0 {
            return Ok(());
        }
        loop {
            let mut line = String::new();
            stream.read_line(&mut line).await?;
            let Some((name, value)) = line.split_once(':') else { break };
            if name.eq_ignore_ascii_case("content-length") {
                length = value.trim().parse().unwrap();
            }
        }
        stream.read_exact(&mut vec![0; length]).await?;
        for (delay, part) in answer(request.trim_end_matches(" HTTP/1.1\r\n")) {
            sleep(delay).await;
            stream.write_all(part.as_bytes()).await?;
        }
    }
}

/// Answers what every client asks first.
pub(crate) fn version(request: &str) -> Option<Answer> {
    request.contains("/version").then(|| at_once("200 OK", r#"{"ApiVersion":"1.41"}"#))
}

/// Returns the error of a request, and how long that took.
async fn error_of<T>(request: impl Future<Output = Result<T, DaemonError>>) -> (String, Duration) {
    let began = Instant::now();
    let error = request.await.err().unwrap().to_string();
    (error, began.elapsed())
}

#[tokio::test(start_paused = true)]
async fn a_request_to_an_engine_that_hangs_fails_within_the_limit() {
    let test = async {
        let folder = TempDir::new().unwrap();
        let late = ("the engine hangs: it did not answer within 20 s".to_owned(), ANSWER);
        let _mute = UnixListener::bind(folder.path().join("mute")).unwrap();
        assert_eq!(error_of(Daemon::connect(&folder.path().join("mute"))).await, late);
        let socket = serve(&folder, |request| version(request).unwrap_or_default());
        let daemon = Daemon::connect(&socket).await.unwrap();
        assert!(!daemon.is_silent());
        assert_eq!(error_of(daemon.has_image("a")).await, late);
        assert_eq!(error_of(daemon.import("a", "1", Vec::new())).await, late);
        assert_eq!(error_of(daemon.create("a", Container::default())).await, late);
        assert_eq!(error_of(daemon.start("a")).await, late);
        assert_eq!(error_of(daemon.state("a")).await, late);
        assert_eq!(error_of(daemon.signal("a", "SIGTERM")).await, late);
        assert_eq!(error_of(daemon.remove("a")).await, late);
        assert_eq!(error_of(daemon.containers_of("a")).await, late);
        assert!(daemon.is_silent());
    };
    LocalSet::new().run_until(test).await;
}

#[tokio::test(start_paused = true)]
async fn an_engine_that_hangs_within_an_answer_is_noticed_and_its_next_answer_too() {
    let test = async {
        let folder = TempDir::new().unwrap();
        let socket = serve(&folder, |request| match request.contains("/containers/half/") {
            _ if request.contains("/version") => version(request).unwrap(),
            true => vec![(Duration::ZERO, "HTTP/1.1 200 OK\r\ncontent-length: 9\r\n\r\n{".to_owned())],
            false => at_once("200 OK", "{}"),
        });
        let daemon = Daemon::connect(&socket).await.unwrap();
        assert_eq!(error_of(daemon.state("half")).await.1, ANSWER);
        assert!(daemon.is_silent());
        assert_eq!(daemon.state("whole").await.unwrap(), State::default());
        assert!(!daemon.is_silent());
    };
    LocalSet::new().run_until(test).await;
}

#[tokio::test(start_paused = true)]
async fn a_pull_goes_on_as_long_as_it_makes_progress() {
    let test = async {
        let folder = TempDir::new().unwrap();
        let step = |seconds: u64| {
            let step = "{\"status\":\"Extracting\"}\n";
            (Duration::from_secs(seconds), format!("{:x}\r\n{step}\r\n", step.len()))
        };
        let socket = serve(&folder, move |request| {
            let head = "HTTP/1.1 200 OK\r\ntransfer-encoding: chunked\r\n\r\n".to_owned();
            let head = (Duration::ZERO, head);
            let end = (Duration::ZERO, "0\r\n\r\n".to_owned());
            version(request).unwrap_or_else(|| match request.contains("slow") {
                true => vec![head, step(299), step(299), step(299), end],
                false => vec![head, step(299)],
            })
        });
        let daemon = Daemon::connect(&socket).await.unwrap();
        daemon.pull("slow").await.unwrap();
        let stuck = "the engine hangs: it did not answer within 300 s".to_owned();
        let after = Duration::from_secs(299) + PULL_PROGRESS;
        assert_eq!(error_of(daemon.pull("stuck")).await, (stuck, after));
    };
    LocalSet::new().run_until(test).await;
}
