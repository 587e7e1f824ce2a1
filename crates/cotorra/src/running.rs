//! Finds the run that a command addresses by its entry, and connects to its Unix socket.
//!
//! A program that took over the port of a run receives nothing.

use std::{
    env,
    io::{self, BufRead, IsTerminal, Read},
};

use clap::Args;
use cotorra_plugin::{
    client::{Client, ClientError},
    runs::{RunEntry, Runs, RunsError},
};

/// The environment variable with the API's token.
pub const TOKEN_VARIABLE: &str = "COTORRA_TOKEN";

/// Status of the API for a caller without a valid token.
const UNAUTHORIZED: u16 = 401;

/// Length in bytes from which an answer is not read.
const LONGEST_ANSWER: u64 = 64;

/// Returns the API's token, if the environment has one.
pub fn token_text() -> Option<String> {
    env::var(TOKEN_VARIABLE).ok().filter(|text| !text.is_empty())
}

/// Choice of a run.
#[derive(Debug, Args)]
pub struct WhichRun {
    /// The run: the name of its testbed, its folder, or the address of its API; default: your only run on this machine
    ///
    /// If there are several, the command asks on a terminal, and fails elsewhere. `cotorra ps` lists them.
    #[arg(long, visible_alias = "api", value_name = "NAME|FOLDER|URL", env = "COTORRA_API")]
    pub run: Option<String>,
}

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum Error {
    #[error(transparent)]
    #[diagnostic(help("{}", help_for(.0)))]
    NotFound(RunsError),
    #[error("the testbed on {api} does not answer: {reason}")]
    #[diagnostic(help("it may have ended just now; start one with `cotorra run`"))]
    Silent { api: String, reason: String },
    #[error("the testbed on {api} rejects the token")]
    #[diagnostic(help(
        "set {TOKEN_VARIABLE} to the token that the run was started with, or unset it if there was none"
    ))]
    Token { api: String },
    #[error("{0}")]
    Failed(ClientError),
}

/// Returns what to do about a run that is not found.
fn help_for(error: &RunsError) -> &'static str {
    match error {
        RunsError::None { .. } => {
            "start one with `cotorra run`; to reach a run of another user, become that user, as with sudo"
        }
        RunsError::Several(_) => {
            "choose one with --run, by its name, folder or address, as in `--run 127.0.0.1:7700`"
        }
        RunsError::NotThere { .. } => {
            "`cotorra ps` lists your runs; to reach a run of another user, become that user, as with sudo; for a run of \
             another machine, log in there, or use `cotorra link` with its https address and --ca"
        }
        RunsError::System { .. } | RunsError::NotPrivate { .. } | RunsError::Malformed { .. } => {
            "runs have their entries in the folder `cotorra` in XDG_RUNTIME_DIR or /run/user/UID, or in `cotorra-UID` in \
             the folder for temporary files"
        }
    }
}

impl WhichRun {
    /// Returns what names the run. An empty variable in the environment names none.
    pub fn named(&self) -> Option<&str> {
        self.run.as_deref().filter(|run| !run.is_empty())
    }

    /// Finds the run, and asks on a terminal which of several is meant.
    pub fn entry(&self, runs: &Runs) -> Result<RunEntry, Error> {
        let is_terminal = io::stdin().is_terminal() && io::stderr().is_terminal();
        match runs.find(self.named()) {
            Err(RunsError::Several(running)) if is_terminal => choose(running, &mut io::stdin().lock()),
            found => found,
        }
        .map_err(Error::NotFound)
    }

    /// Finds the run. Returns it with a client that shows `token` to it alone.
    pub fn find(&self, runs: &Runs, token: Option<String>) -> Result<(RunEntry, Client), Error> {
        let run = self.entry(runs)?;
        let client = with_token(Client::of(&run).map_err(Error::Failed)?, token);
        Ok((run, client))
    }
}

/// Asks which run is meant, until the answer is the number of one.
fn choose(mut running: Vec<RunEntry>, answers: &mut impl BufRead) -> Result<RunEntry, RunsError> {
    for (i, run) in running.iter().enumerate() {
        note!("{}: {run}", i + 1);
    }
    loop {
        note!("which run? 1 to {}", running.len());
        let mut answer = String::new();
        let read = answers.take(LONGEST_ANSWER).read_line(&mut answer).unwrap_or(0) as u64;
        // The rest of a longer line must not count as another answer.
        if read == 0 || read == LONGEST_ANSWER {
            return Err(RunsError::Several(running));
        }
        let number = answer.trim().parse::<usize>().ok();
        if let Some(number) = number.filter(|number| (1..=running.len()).contains(number)) {
            return Ok(running.swap_remove(number - 1));
        }
    }
}

/// Adds a token to a client, if there is one.
pub fn with_token(client: Client, token: Option<String>) -> Client {
    match token {
        Some(token) => client.with_token(token),
        None => client,
    }
}

/// Converts a client's error into one that names the run on `api`.
pub fn explained(api: impl ToString, error: ClientError) -> Error {
    let api = api.to_string();
    match error {
        ClientError::Unreachable { source, .. } => Error::Silent { api, reason: source.to_string() },
        ClientError::Failed { status: UNAUTHORIZED, .. } => Error::Token { api },
        other => Error::Failed(other),
    }
}

#[cfg(test)]
pub mod tests {
    use std::{
        io::{BufReader, ErrorKind, Write},
        net::{SocketAddr, TcpListener},
        thread::{self, JoinHandle},
    };

    use cotorra_plugin::runs::Announced;
    use tempfile::TempDir;

    use super::*;

    /// A program that listens on the port of a run, and must receive nothing.
    pub struct Squatter(TcpListener);

    impl Squatter {
        pub fn new() -> Self {
            let listener = TcpListener::bind("127.0.0.1:0").unwrap();
            listener.set_nonblocking(true).unwrap();
            Self(listener)
        }

        pub fn address(&self) -> SocketAddr {
            self.0.local_addr().unwrap()
        }

        /// Asserts that there was no connection.
        pub fn received_nothing(&self) {
            let received = self.0.accept().map(|(_, from)| from).map_err(|error| error.kind());
            assert_eq!(received, Err(ErrorKind::WouldBlock));
        }
    }

    /// The entry of a run whose API gives these answers, one for each connection.
    pub struct Served {
        pub runs: Runs,
        _folder: TempDir,
        _entry: Announced,
        answering: JoinHandle<Vec<String>>,
    }

    impl Served {
        pub fn on(api: SocketAddr, answers: Vec<String>) -> Self {
            let folder = TempDir::new().unwrap();
            let runs = Runs::in_folder(folder.path().join("cotorra"));
            let mut entry = runs.announce(api, "walk", "/runs/walk").unwrap();
            let listener = entry.listener().unwrap();
            let answering = thread::spawn(move || {
                let answer = |body: String| {
                    let mut stream = BufReader::new(listener.accept().unwrap().0);
                    let mut head = String::new();
                    while !head.ends_with("\r\n\r\n") {
                        assert_ne!(stream.read_line(&mut head).unwrap(), 0, "{head}");
                    }
                    let length = body.len();
                    write!(stream.get_mut(), "HTTP/1.1 200 OK\r\nContent-Length: {length}\r\n\r\n{body}")
                        .unwrap();
                    head
                };
                answers.into_iter().map(answer).collect()
            });
            Self { runs, _folder: folder, _entry: entry, answering }
        }

        /// Returns the heads of all requests, once all are answered.
        pub fn requests(self) -> Vec<String> {
            self.answering.join().unwrap()
        }
    }

    fn token() -> Option<String> {
        Some("operator-operator".to_owned())
    }

    #[test]
    fn a_program_that_took_the_port_gets_no_token() {
        let squatter = Squatter::new();
        let folder = TempDir::new().unwrap();
        let runs = Runs::in_folder(folder.path().join("cotorra"));
        let which = WhichRun { run: Some(squatter.address().to_string()) };
        let refused = which.find(&runs, token()).unwrap_err();
        assert!(matches!(refused, Error::NotFound(RunsError::NotThere { .. })), "{refused}");
        squatter.received_nothing();

        // Not even if the entry of a run names that port.
        let served = Served::on(squatter.address(), vec!["[]".to_owned()]);
        let (_, client) = which.find(&served.runs, token()).unwrap();
        assert!(client.links().unwrap().is_empty());
        squatter.received_nothing();
        let requests = served.requests();
        assert!(requests[0].starts_with("GET /api/v1/network/links HTTP/1.1\r\n"), "{requests:?}");
        assert!(requests[0].contains("Bearer operator-operator\r\n"), "{requests:?}");
    }

    #[test]
    fn a_run_that_moved_is_found_without_its_address() {
        let (squatter, moved) = (Squatter::new(), Squatter::new());
        let served = Served::on(moved.address(), vec!["[]".to_owned()]);
        let (run, client) = WhichRun { run: None }.find(&served.runs, token()).unwrap();
        assert_eq!((run.api, client.links().unwrap()), (moved.address(), vec![]));
        assert_eq!(served.requests().len(), 1);
        squatter.received_nothing();
    }

    #[test]
    fn an_answer_chooses_one_of_several_runs_and_no_answer_none() {
        let folder = TempDir::new().unwrap();
        let runs = Runs::in_folder(folder.path().join("cotorra"));
        let announce =
            |port: u16, name| runs.announce(([127, 0, 0, 1], port).into(), name, "/runs/x").unwrap();
        let _both = [announce(7701, "walk"), announce(7702, "drive")];
        let chosen = |answers: &str| choose(runs.running().0, &mut answers.as_bytes()).map(|run| run.name);
        assert_eq!(chosen("0\n3\nwalk\n\n2\n").unwrap(), "drive");
        assert_eq!(chosen("1\n2\n").unwrap(), "walk");
        for none in ["", "3\n", &"9".repeat(1 << 16), &format!("{}1\n", " ".repeat(64))] {
            assert!(matches!(chosen(none), Err(RunsError::Several(runs)) if runs.len() == 2));
        }
    }

    #[test]
    fn an_empty_name_counts_as_none() {
        assert_eq!(WhichRun { run: Some(String::new()) }.named(), None);
    }

    #[test]
    fn a_rejected_token_names_its_variable() {
        let error = ClientError::Failed { url: "x".to_owned(), status: 401, reason: "no".to_owned() };
        let error = explained("127.0.0.1:7700", error);
        let help = miette::Diagnostic::help(&error).map(|help| help.to_string());
        assert!(help.is_some_and(|help| help.contains(TOKEN_VARIABLE)), "{error}");
    }
}
