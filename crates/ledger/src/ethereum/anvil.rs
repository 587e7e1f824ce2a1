//! A local anvil node: a ledger for one machine. It is a single node that makes its own blocks, without consensus.

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

/// Environment variable with the program to start.
pub const PROGRAM: &str = "COTORRA_ANVIL";

/// Settings of a node.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// The program; by default the value of `COTORRA_ANVIL`, or `anvil` on the path.
    pub program: Option<PathBuf>,
    /// Time between blocks; by default each transaction gets a block at once.
    pub block_period: Option<Duration>,
    /// File that keeps the chain; by default the chain ends with the node.
    pub state: Option<PathBuf>,
    /// Port of 127.0.0.1; 0 chooses a free one.
    pub port: u16,
}

/// A node that could not be started.
#[derive(Debug, thiserror::Error)]
pub enum AnvilError {
    /// The program is not installed.
    #[error(
        "there is no program `{}`: anvil comes with `npm install @foundry-rs/anvil` (the program is then \
         node_modules/@foundry-rs/anvil-linux-amd64/bin/anvil) or with Foundry; put it on the path, or name it in \
         {PROGRAM}",
        program.display()
    )]
    Missing { program: PathBuf },
    /// The program could not be run.
    #[error("`{}` does not start: {reason}", program.display())]
    Start { program: PathBuf, reason: io::Error },
    /// The program ended.
    #[error("`{}` ended before it listened, with the output:\n{output}", program.display())]
    Ended {
        program: PathBuf,
        /// Its output.
        output: String,
    },
}

/// A running node. Dropping it ends the node.
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
            // With one-block slots, a block is finalized two blocks later.
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
        // The node keeps printing, and would block without a reader.
        thread::spawn(move || lines.for_each(drop));
        Ok(Self { child, address })
    }

    /// Returns the default program.
    fn program() -> PathBuf {
        env::var_os(PROGRAM).map_or_else(|| Path::new("anvil").to_owned(), |name: OsString| name.into())
    }

    /// Ends the node after it has written its state.
    pub fn stop(mut self) {
        // An interrupt makes it write its state. Without one, it loses what came since the last write.
        let interrupt = ["-s", "INT", &self.child.id().to_string()];
        if Command::new("kill").args(interrupt).status().is_ok_and(|status| status.success()) {
            let _ = self.child.wait();
        }
    }

    /// Returns the address where it listens for both HTTP and WebSocket.
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
