//! An anvil node of our own: a ledger for one machine. It is one node, and makes blocks alone: there is no consensus.

use std::{
    env,
    ffi::OsString,
    io::{self, BufRead, BufReader},
    net::SocketAddr,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::Duration,
};

/// The environment variable that says which program to start.
pub const PROGRAM: &str = "COTORRA_ANVIL";

/// How a node is started.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// The program; without it what `COTORRA_ANVIL` says, or `anvil` on the path.
    pub program: Option<PathBuf>,
    /// Between blocks; without it there is one for each transaction, at once.
    pub block_period: Option<Duration>,
    /// Where the chain is kept; without it the chain ends with the node.
    pub state: Option<PathBuf>,
    /// The port of 127.0.0.1; 0 takes a free one.
    pub port: u16,
}

/// Why there is no node.
#[derive(Debug, thiserror::Error)]
pub enum AnvilError {
    /// There is no such program.
    #[error(
        "there is no program `{}`: anvil comes with `npm install @foundry-rs/anvil` (the program is then \
         node_modules/@foundry-rs/anvil-linux-amd64/bin/anvil) or with Foundry; put it on the path, or name it in \
         {PROGRAM}",
        program.display()
    )]
    Missing {
        /// What was looked for.
        program: PathBuf,
    },
    /// The program cannot be run.
    #[error("`{}` does not start: {reason}", program.display())]
    Start {
        /// What was run.
        program: PathBuf,
        /// Why not.
        reason: io::Error,
    },
    /// The program ended.
    #[error("`{}` ended before it listened; it said:\n{output}", program.display())]
    Ended {
        /// What was run.
        program: PathBuf,
        /// What it printed.
        output: String,
    },
}

/// A running node; it ends when this is dropped.
#[derive(Debug)]
pub struct Anvil {
    child: Child,
    address: SocketAddr,
}

impl Anvil {
    /// Starts a node, and waits until it listens.
    ///
    /// # Errors
    /// [`AnvilError`] if it does not.
    pub fn start(settings: &Settings) -> Result<Self, AnvilError> {
        let program = settings.program.clone().unwrap_or_else(Self::program);
        let mut command = Command::new(&program);
        command.args(["--host", "127.0.0.1", "--port", &settings.port.to_string()]);
        if let Some(period) = settings.block_period {
            // With slots of one block, what was mined is finalized two blocks later.
            command.args(["--slots-in-an-epoch", "1", "--block-time", &period.as_secs_f64().to_string()]);
        }
        if let Some(state) = &settings.state {
            command.arg("--state").arg(state);
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        let mut child = command.spawn().map_err(|reason| match reason.kind() {
            io::ErrorKind::NotFound => AnvilError::Missing { program: program.clone() },
            _ => AnvilError::Start { program: program.clone(), reason },
        })?;
        let mut lines =
            BufReader::new(child.stdout.take().expect("it is piped")).lines().map_while(Result::ok);
        let mut output = String::new();
        let address = lines.by_ref().find_map(|line| {
            output.push_str(&line);
            output.push('\n');
            line.strip_prefix("Listening on ")?.trim().parse().ok()
        });
        let Some(address) = address else {
            let _ = child.kill();
            let _ = child.wait();
            return Err(AnvilError::Ended { program, output });
        };
        // It goes on to print, and would stand still were nobody to read.
        thread::spawn(move || lines.for_each(drop));
        Ok(Self { child, address })
    }

    /// What is started where nothing is set.
    fn program() -> PathBuf {
        env::var_os(PROGRAM).map_or_else(|| Path::new("anvil").to_owned(), |name: OsString| name.into())
    }

    /// Ends the node, and lets it write its state first.
    pub fn stop(mut self) {
        // Its own way to end is an interrupt; whoever cannot send one loses what came since it was last written.
        let interrupt = ["-s", "INT", &self.child.id().to_string()];
        if Command::new("kill").args(interrupt).status().is_ok_and(|status| status.success()) {
            let _ = self.child.wait();
        }
    }

    /// Where it listens, for both HTTP and WebSocket.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Anvil {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
