//! Machines with a radio each: a robot, and two access points. Machine `n` is the network namespace `un`, with the interface
//! `wlann`. All see one `/run`, where hostapd and wpa_supplicant have a socket for each interface.

use std::{
    env, fs,
    path::Path,
    process::{Child, Command, Stdio},
    thread,
    time::Duration,
};

/// Names of their agents.
pub const AGENTS: [&str; 3] = ["robot1", "ap1", "ap2"];
/// The address at which the core listens for agents.
pub const CORE: &str = "10.9.0.1:7448";

/// The owner's access point, `wlan1`.
pub const HOSTAPD: &str = "\
interface=wlan1
driver=nl80211
bridge=br0
ctrl_interface=/run/hostapd
ssid=home
hw_mode=g
channel=11
wpa=2
wpa_key_mgmt=WPA-PSK
rsn_pairwise=CCMP
wpa_passphrase=the owner's secret
";
/// The owner's station.
pub const SUPPLICANT: &str = "\
ctrl_interface=/run/wpa_supplicant
network={
 ssid=\"home\"
 key_mgmt=WPA-PSK
 psk=\"the owner's secret\"
 scan_freq=2412 2437 2462
}
";

/// Returns whether the environment promises radios that Linux simulates.
pub fn are_promised() -> bool {
    let are_promised = env::var_os("COTORRA_RADIOS").is_some();
    if !are_promised {
        eprintln!("skipped: COTORRA_RADIOS promises no radios");
    }
    are_promised
}

/// Runs a script, and returns what it printed.
pub fn sh(script: &str) -> String {
    let output = Command::new("sh").args(["-ec", script]).output().unwrap();
    assert!(output.status.success(), "{script}: {output:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// Makes the machines with the radios of these names, and connects them to the core by cables.
pub fn connect<P: AsRef<str>>(radios: [P; 3]) {
    sh("ip link add lan type bridge
        ip address add 10.9.0.1/24 dev lan
        ip address add 10.8.0.1/24 dev lan
        ip link set lan up");
    for (number, radio) in radios.iter().enumerate() {
        sh(&format!(
            "n={number}
            ip netns add u$n
            iw phy {} set netns name u$n
            wlan=$(ip netns exec u$n iw dev | sed -n 's/.*Interface //p')
            [ $wlan = wlan$n ] || ip -n u$n link set $wlan name wlan$n
            ip link add up$n type veth peer name eth0 netns u$n
            ip link set up$n master lan up
            ip -n u$n link set lo up
            ip -n u$n link add br0 type bridge
            ip -n u$n link set br0 up
            ip -n u$n link set eth0 master br0 up
            ip -n u$n address add 10.9.0.1$n/24 dev br0",
            radio.as_ref()
        ));
    }
}

/// Gives the robot's radio an address, and starts the programs of the owners: the first access point and the station.
pub fn start_owners(address: &str) {
    fs::write("/run/hostapd.conf", HOSTAPD).unwrap();
    fs::write("/run/supplicant.conf", SUPPLICANT).unwrap();
    sh(&format!(
        "ip -n u0 address add {address} dev wlan0
        ip netns exec u1 hostapd -B -f /run/hostapd.log /run/hostapd.conf
        ip netns exec u0 wpa_supplicant -B -f /run/supplicant.log -i wlan0 -D nl80211 -c /run/supplicant.conf"
    ));
}

/// Waits until each machine does what its owner wants, and the rest holds, too: the first access point serves, the second does
/// nothing, and the robot is at the first.
pub fn wait_for_owners(rest: impl Fn() -> bool) {
    let mut seen = String::new();
    // Longer than radios are kept without the core.
    for _ in 0..300 {
        seen = sh("ip netns exec u1 iw dev; ip netns exec u2 iw dev; ip netns exec u0 iw dev wlan0 link
            ip netns exec u0 wpa_cli -p /run/wpa_supplicant -i wlan0 list_networks");
        let signs = ["ssid home", "channel 11", "type managed", "SSID: home"];
        let is_home = signs.iter().all(|sign| seen.contains(sign)) && seen.matches("\tany\t").count() == 1;
        if is_home && rest() {
            return;
        }
        thread::sleep(Duration::from_millis(100));
    }
    panic!("not as their owners want it: {seen}");
}

/// Starts the agent of a machine, whose credentials are in `/run`. Its state is in [`state`], its log in [`log`].
pub fn start_agent(program: &Path, number: usize) -> Child {
    let log = fs::File::options().create(true).append(true).open(log(number)).unwrap();
    Command::new("ip")
        .args(["netns", "exec", &format!("u{number}")])
        .arg(program)
        .args(["run", &format!("/run/{}.agent", AGENTS[number]), "--state", &state(number)])
        .args(["--wifi", &format!("wlan{number}")])
        .stdout(Stdio::null())
        .stderr(log)
        .spawn()
        .unwrap()
}

pub fn state(number: usize) -> String {
    format!("/run/state-{}", AGENTS[number])
}

pub fn log(number: usize) -> String {
    format!("/run/{}.log", AGENTS[number])
}

/// Pings the core from the robot over its radio, each millisecond.
pub struct Ping(Child);

impl Ping {
    pub fn start() -> Self {
        let log = fs::File::create("/run/ping.log").unwrap();
        let arguments = "netns exec u0 ping -n -D -i 0.001 10.8.0.1".split(' ');
        Self(Command::new("ip").args(arguments).stdout(log).spawn().unwrap())
    }

    /// Ends it. Returns the longest time between two of its answers, more than 100.
    pub fn longest_gap(mut self) -> Duration {
        sh(&format!("kill {}", self.0.id()));
        self.0.wait().unwrap();
        let log = fs::read_to_string("/run/ping.log").unwrap();
        let answer = |line: &str| line.strip_prefix('[')?.split_once("] 64 bytes")?.0.parse::<f64>().ok();
        let answers: Vec<_> = log.lines().filter_map(answer).collect();
        assert!(answers.len() > 100, "{log}");
        Duration::from_secs_f64(answers.windows(2).map(|two| two[1] - two[0]).fold(0.0, f64::max))
    }
}
