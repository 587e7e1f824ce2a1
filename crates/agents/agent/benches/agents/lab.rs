//! An authority with enrolled agents, in a folder that several processes share.

use std::{
    fs,
    net::{SocketAddr, TcpListener},
    path::{Path, PathBuf},
    time::Duration,
};

use chrono::{DateTime, Utc};
use cotorra_agent_transport::Granted;
use cotorra_enrolment::{Authority, Bundle, ServerCredentials};
use cotorra_graph::AgentId;

pub struct Lab {
    pub authority: Authority,
    pub folder: PathBuf,
    pub agents: Vec<AgentId>,
}

impl Lab {
    /// Enrols agents with a core on this machine.
    pub fn create(folder: &Path, agents: usize) -> Self {
        let authority = Authority::create_or_open(folder.join("authority"), today()).unwrap();
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let core = address.to_string().parse().unwrap();
        let agents: Vec<_> = (0..agents).map(|n| AgentId::new(&format!("agent{n}")).unwrap()).collect();
        for agent in &agents {
            let bundle = authority.enrol(agent, &core, Duration::from_hours(24), today()).unwrap();
            bundle.write(&credentials(folder, agent)).unwrap();
        }
        Self { authority, folder: folder.to_owned(), agents }
    }

    /// Opens what another process created.
    pub fn open(folder: &Path) -> Self {
        let authority = Authority::open(folder.join("authority")).unwrap();
        let agents = authority.agents().unwrap().into_iter().map(|agent| agent.name).collect();
        Self { authority, folder: folder.to_owned(), agents }
    }

    /// The file that [`Authority::enrol`] made for an agent.
    pub fn credentials(&self, agent: &AgentId) -> PathBuf {
        credentials(&self.folder, agent)
    }

    pub fn bundle(&self, agent: &AgentId) -> Bundle {
        Bundle::parse(&fs::read_to_string(self.credentials(agent)).unwrap()).unwrap()
    }

    /// Address at which the core listens.
    pub fn address(&self) -> SocketAddr {
        self.bundle(&self.agents[0]).core().to_string().parse().unwrap()
    }

    pub fn core(&self) -> ServerCredentials {
        self.authority.core(today()).unwrap()
    }

    pub fn granted(&self) -> Vec<Granted> {
        let granted = self.authority.granted(today()).unwrap().into_iter();
        granted.map(|its| Granted { agent: its.name, common_name: its.common_name }).collect()
    }
}

fn credentials(folder: &Path, agent: &AgentId) -> PathBuf {
    folder.join(format!("{agent}.agent"))
}

fn today() -> DateTime<Utc> {
    Utc::now()
}
