//! Three machines with real agents: a robot, and two access points. Each is a network namespace with one radio, whose air is the
//! kernel's own.

use std::process::Child;

use cotorra_hwsim::{MacAddress, Radio, Radios};
use cotorra_testing::radios::{self, AGENTS, CORE, sh};

use crate::harness::{agent_program, cotorra};

/// Folder of the authority that enrolled them.
pub const AUTHORITY: &str = "/run/authority";

/// The machines with their agents. Their radios go with this.
pub struct Machines {
    pub agents: Vec<Child>,
    _radios: Radios,
}

impl Machines {
    /// Connects the machines to the core, starts their owners' programs, and then the agents. Access points have a cable; a robot
    /// without one reaches the core by the first access point.
    pub fn start(robot_has_cable: bool) -> Self {
        let mut radios = Radios::new();
        radios::connect([0, 1, 2].map(|number| {
            let radio = Radio {
                permanent_address: Some(MacAddress([2, 0, 0, 9, number, 0])),
                channels: Some(1),
                ends_with_socket: true,
                ..Radio::default()
            };
            radios.create(&radio).and_then(|id| radios.name(id)).unwrap()
        }));
        if !robot_has_cable {
            sh("ip -n u0 link delete eth0; ip -n u0 address flush dev br0");
        }
        radios::start_owners(if robot_has_cable { "10.8.0.10/24" } else { "10.9.0.10/24" });
        let agents = (0..3).inspect(|number| enrol(AGENTS[*number])).map(start_agent).collect();
        let machines = Self { agents, _radios: radios };
        machines.become_home();
        machines
    }

    /// Waits until each machine does what its owner wants.
    pub fn become_home(&self) {
        radios::wait_for_owners(|| robot_power_is(20));
    }
}

impl Drop for Machines {
    fn drop(&mut self) {
        for agent in &mut self.agents {
            sh(&format!("kill {}", agent.id()));
            agent.wait().unwrap();
        }
        sh("kill $(ip netns pids u0) $(ip netns pids u1)
            for n in 0 1 2; do ip netns delete u$n; done
            ip link delete lan
            rm -r /run/authority /run/*.agent /run/state-*");
    }
}

/// Writes the credentials of an agent.
fn enrol(name: &str) {
    let enrolled = cotorra(["agent", "enrol", name, "--core", CORE, "--authority", AUTHORITY])
        .current_dir("/run")
        .output()
        .unwrap();
    assert!(enrolled.status.success(), "{enrolled:?}");
}

/// Starts the agent of a machine.
pub fn start_agent(number: usize) -> Child {
    radios::start_agent(&agent_program(), number)
}

/// Whether the robot's radio sends with this many dBm at most.
pub fn robot_power_is(dbm: u8) -> bool {
    sh("ip netns exec u0 iw dev wlan0 info").contains(&format!("txpower {dbm}.00 dBm"))
}
