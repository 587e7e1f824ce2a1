//! Three machines with real agents: a robot, and two access points. Each is a network namespace with one radio, whose air is the
//! kernel's own.

use std::{
    fs,
    path::PathBuf,
    process::{Child, Command, Stdio},
};

use cotorra_hwsim::{MacAddress, Radio, Radios};

use crate::harness::cotorra;

/// Where the core listens for agents.
pub const CORE: &str = "10.9.0.1:7448";
/// Folder of the authority that enrolled them.
pub const AUTHORITY: &str = "/run/authority";

const HOSTAPD: &str = "\
interface=wlan1
bridge=br0
ctrl_interface=/run/hostapd
ssid=home
channel=11
hw_mode=g
wpa=2
wpa_key_mgmt=WPA-PSK
rsn_pairwise=CCMP
wpa_passphrase=the owner's secret
";

const SUPPLICANT: &str = "\
ctrl_interface=/run/wpa_supplicant
network={
 ssid=\"home\"
 key_mgmt=WPA-PSK
 psk=\"the owner's secret\"
 scan_freq=2412 2437 2462
}
";

/// The machines: a robot, and two access points. Machine `n` is the namespace `un`, with the interface `wlann`: all see one
/// `/run`, where hostapd and wpa_supplicant have a socket for each interface.
const MACHINES: [&str; 3] = ["robot1", "ap1", "ap2"];

/// Runs a script, and returns what it printed.
pub fn sh(script: &str) -> String {
    let output = Command::new("sh").args(["-ec", script]).output().unwrap();
    assert!(output.status.success(), "{script}: {output:?}");
    String::from_utf8(output.stdout).unwrap()
}

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
        sh("ip link add lan type bridge
            ip address add 10.9.0.1/24 dev lan
            ip address add 10.8.0.1/24 dev lan
            ip link set lan up");
        for number in 0..3_u8 {
            let radio = Radio {
                permanent_address: Some(MacAddress([2, 0, 0, 9, number, 0])),
                channels: Some(1),
                ends_with_socket: true,
                ..Radio::default()
            };
            let phy = radios.create(&radio).and_then(|id| radios.name(id)).unwrap();
            sh(&format!(
                "n={number}
                ip netns add u$n
                iw phy {phy} set netns name u$n
                wlan=$(ip netns exec u$n iw dev | sed -n 's/.*Interface //p')
                [ $wlan = wlan$n ] || ip -n u$n link set $wlan name wlan$n
                ip link add up$n type veth peer name eth0 netns u$n
                ip link set up$n master lan up
                ip -n u$n link set lo up
                ip -n u$n link add br0 type bridge
                ip -n u$n link set br0 up
                ip -n u$n link set eth0 master br0 up
                ip -n u$n address add 10.9.0.1$n/24 dev br0"
            ));
        }
        if !robot_has_cable {
            sh("ip -n u0 link delete eth0");
        }
        fs::write("/run/hostapd.conf", HOSTAPD).unwrap();
        fs::write("/run/supplicant.conf", SUPPLICANT).unwrap();
        let address = if robot_has_cable { "10.8.0.10/24" } else { "10.9.0.10/24" };
        if !robot_has_cable {
            sh("ip -n u0 address flush dev br0");
        }
        sh(&format!("ip -n u0 address add {address} dev wlan0"));
        sh("ip netns exec u1 hostapd -B -f /run/hostapd.log /run/hostapd.conf
            ip netns exec u0 wpa_supplicant -B -f /run/supplicant.log -i wlan0 -D nl80211 -c /run/supplicant.conf");
        let agents = (0..3).inspect(|number| enrol(MACHINES[*number])).map(start_agent).collect();
        let machines = Self { agents, _radios: radios };
        machines.become_home();
        machines
    }

    /// Waits until each machine does what its owner wants: the first access point serves, the second does nothing, and the robot
    /// is at the first.
    pub fn become_home(&self) {
        let mut seen = String::new();
        for _ in 0..100 {
            seen =
                sh("ip netns exec u1 iw dev; ip netns exec u2 iw dev; ip netns exec u0 iw dev wlan0 link; \
                ip netns exec u0 wpa_cli -p /run/wpa_supplicant -i wlan0 list_networks");
            let signs = ["ssid home", "channel 11", "type managed", "SSID: home"];
            let is_home =
                signs.iter().all(|sign| seen.contains(sign)) && seen.matches("\tany\t").count() == 1;
            if is_home && robot_power_is(20) {
                return;
            }
            sh("sleep 0.1");
        }
        panic!("not as their owners want it: {seen}");
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
    let name = MACHINES[number];
    let program = PathBuf::from(cotorra([""; 0]).get_program()).with_file_name("cotorra-agent");
    let log = fs::File::options().create(true).append(true).open(format!("/run/{name}.log")).unwrap();
    Command::new("ip")
        .args(["netns", "exec", &format!("u{number}")])
        .arg(program)
        .args(["run", &format!("/run/{name}.agent"), "--state", &format!("/run/state-{name}")])
        .args(["--wifi", &format!("wlan{number}")])
        .stdout(Stdio::null())
        .stderr(log)
        .spawn()
        .unwrap()
}

/// Whether the robot's radio sends with this many dBm at most.
pub fn robot_power_is(dbm: u8) -> bool {
    sh("ip netns exec u0 iw dev wlan0 info").contains(&format!("txpower {dbm}.00 dBm"))
}
