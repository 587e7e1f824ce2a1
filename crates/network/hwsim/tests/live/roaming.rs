//! wpa_supplicant roams between two hostapds by 802.11r, as they are.

use std::{fs, os::unix::net::UnixDatagram, time::Duration};

use cotorra_datapath::Namespace;
use cotorra_hwsim::Phys;

use crate::rig::{Air, ap, is_installed};

const LONG: Duration = Duration::from_secs(30);

fn hostapd(index: usize, channel: u8) -> String {
    format!(
        "interface=ap{index}\ndriver=nl80211\nctrl_interface=/run/hostapd\nssid=lab\nhw_mode=g\nchannel={channel}\n\
         ieee80211n=1\nwmm_enabled=1\nwpa=2\nwpa_key_mgmt=FT-PSK\nrsn_pairwise=CCMP\nwpa_passphrase=correct horse\n\
         nas_identifier=ap{index}\nr1_key_holder=00000000000{index}\nmobility_domain=c0de\nft_psk_generate_local=1\n\
         ft_over_ds=0\n"
    )
}

const SUPPLICANT: &str = concat!(
    "ctrl_interface=/run/wpa\nnetwork={\n ssid=\"lab\"\n key_mgmt=FT-PSK\n psk=\"correct horse\"\n",
    " scan_freq=2412 2437\n freq_list=2412 2437\n bgscan=\"simple:2:-60:10\"\n}\n",
);

#[test]
fn a_supplicant_roams_by_instruction_and_when_its_signal_falls() {
    if !["hostapd", "wpa_supplicant"].iter().all(|program| is_installed(program)) {
        return eprintln!("there is no hostapd or no wpa_supplicant: nothing is tested");
    }
    let Some(mut air) = Air::new(&[(0.0, 1), (60.0, 6)]) else { return };
    let namespace = Namespace::new().unwrap();
    let mut phys = Phys::new();
    phys.move_to("robot", &namespace).unwrap();
    namespace.run(|| Phys::new().add_station("robot", "robot")).unwrap();
    for (index, channel) in [(0, 1), (1, 6)] {
        let name = format!("ap{index}");
        phys.add_station(&name, &name).unwrap();
        fs::write(format!("/run/{name}.conf"), hostapd(index, channel)).unwrap();
        air.sh(None, &format!("hostapd -B -t -P /run/{name}.pid -f /run/{name}.log /run/{name}.conf"));
    }
    fs::write("/run/robot.conf", SUPPLICANT).unwrap();
    air.sh(
        Some(&namespace),
        "wpa_supplicant -B -t -P /run/robot.pid -f /run/robot.log -D nl80211 -i robot -c /run/robot.conf",
    );
    let mut supplicant = Supplicant::open();
    supplicant.await_attachment(&mut air, 0);

    // By instruction, halfway between both.
    air.walk_to(30.0);
    let both = |results: &str| (0..2).all(|index| results.contains(&ap(index).to_string()));
    while !both(&supplicant.ask(&mut air, "SCAN_RESULTS")) {
        supplicant.ask(&mut air, "SCAN freq=2412,2437");
        air.run_until(Duration::from_secs(1), || false);
    }
    for to in [1, 0, 1, 0] {
        let before = air.now();
        assert_eq!(supplicant.ask(&mut air, &format!("ROAM {}", ap(to))).trim(), "OK");
        supplicant.await_attachment(&mut air, to);
        eprintln!("roamed to {} within {:?}", ap(to), air.now().since(before));
    }

    // By itself, on its way from one to the other and to and fro.
    let path = (30..60).chain((0..60).rev());
    let mut places = Vec::new();
    let mut attached = 0;
    for x in path {
        air.walk_to(f64::from(x));
        air.run_until(Duration::from_millis(500), || false);
        if !supplicant.is_attached(&mut air, attached) && supplicant.is_attached(&mut air, 1 - attached) {
            attached = 1 - attached;
            places.push(x);
        }
    }
    eprintln!("roamed at {places:?} m until {}", air.now());
    assert_eq!(places.len(), 2, "{}", log());
    assert!(places[0] > 30 && places[1] < 30, "it goes where the signal is better: {places:?}");
    air.sh(None, "kill $(cat /run/robot.pid) $(cat /run/ap0.pid) $(cat /run/ap1.pid)");
}

/// The control socket of wpa_supplicant.
struct Supplicant(UnixDatagram);

impl Supplicant {
    fn open() -> Self {
        let socket = UnixDatagram::bind("/run/test").unwrap();
        socket.connect("/run/wpa/robot").unwrap();
        socket.set_nonblocking(true).unwrap();
        Self(socket)
    }

    fn ask(&mut self, air: &mut Air, command: &str) -> String {
        self.0.send(command.as_bytes()).unwrap();
        let mut answer = vec![0; 4096];
        let mut length = None;
        air.run_until(LONG, || {
            length = self.0.recv(&mut answer).ok();
            length.is_some()
        });
        String::from_utf8_lossy(&answer[..length.expect("wpa_supplicant answers")]).into_owned()
    }

    fn is_attached(&mut self, air: &mut Air, to: usize) -> bool {
        let status = self.ask(air, "STATUS");
        status.contains(&format!("bssid={}", ap(to))) && status.contains("wpa_state=COMPLETED")
    }

    /// Waits until the robot is attached to an access point.
    fn await_attachment(&mut self, air: &mut Air, to: usize) {
        let end = air.now() + LONG;
        while !self.is_attached(air, to) {
            assert!(air.now() < end, "not attached to {}: {}\n{}", ap(to), self.ask(air, "STATUS"), log());
            air.run_until(Duration::from_millis(1), || false);
        }
    }
}

fn log() -> String {
    let logs = ["robot", "ap0", "ap1"]
        .map(|name| fs::read_to_string(format!("/run/{name}.log")).unwrap_or_default());
    logs.join("\n---\n")
}
