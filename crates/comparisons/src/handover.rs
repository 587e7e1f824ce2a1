//! Handovers on several kinds of radio: the model of the radio, real Wi-Fi software on the same air, and real radios. On each of
//! them a robot walks twice. On one walk it is sent to another radio unit every few seconds, which measures gaps and scans. On
//! the other it roams by itself, which shows where. A robot with a real radio is only sent: nothing here moves it.
//!
//! [`Comparison`] says whether the model's gaps lie in the confidence intervals of the real software's. Results can be
//! [read] again, because not every machine has all kinds of radio.

mod drawn;
mod figures;
mod measured;
mod places;
#[cfg(test)]
mod tests;

use std::{
    collections::BTreeSet,
    fs,
    io::{self, Read as _},
    path::Path,
};

use cotorra_figure::Format;
use cotorra_graph::{NodeId, NodeKind, Testbed};
use cotorra_testbed::{DataTable, FolderError, write_file};
use serde::{Deserialize, Serialize};

pub use self::{
    figures::{Row, Verdict},
    measured::{Roam, Scan, Walked},
    places::Place,
};

/// A kind of radio.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kind {
    /// Its name, also that of `wifi` of a wireless network in testbed files.
    pub name: &'static str,
    /// The software of its stations.
    pub software: &'static str,
    /// Whether it needs a run in real time.
    pub is_real: bool,
    /// Whether the run moves the robot and carries its packets. Otherwise it has no services, and neither gaps by packets nor
    /// places are measured.
    pub is_emulated: bool,
}

impl Kind {
    /// Returns the walks that it can have. It is unknown where a robot that is not emulated roams by itself.
    pub const fn walks(self) -> &'static [Walk] {
        if self.is_emulated { &Walk::ALL } else { &[Walk::Sent] }
    }

    fn named(name: &str) -> Option<Self> {
        KINDS.into_iter().find(|kind| kind.name == name)
    }
}

/// The model of the radio, in virtual time.
pub const MODEL: Kind =
    Kind { name: "model", software: "the model of the radio", is_real: false, is_emulated: true };
/// Real Wi-Fi software on simulated radios of Linux.
pub const HWSIM: Kind = Kind {
    name: "hwsim",
    software: "hostapd and wpa_supplicant on simulated radios",
    is_real: true,
    is_emulated: true,
};
/// Real radios at agents.
pub const HARDWARE: Kind = Kind {
    name: "hardware",
    software: "hostapd and wpa_supplicant at agents",
    is_real: true,
    is_emulated: false,
};
/// All kinds. The first is compared with each of the others.
pub const KINDS: [Kind; 3] = [MODEL, HWSIM, HARDWARE];

/// A walk, by who decides on handovers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Walk {
    /// A plug-in sends the robot to the strongest other radio unit again and again.
    Sent,
    /// The robot's station, as wpa_supplicant does.
    Alone,
}

impl Walk {
    /// Both walks.
    pub const ALL: [Self; 2] = [Self::Sent, Self::Alone];

    /// Returns its name in tables and folders.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sent => "sent",
            Self::Alone => "alone",
        }
    }
}

/// Interval of position packets, by which gaps are measured.
const PACKETS: &str = "5 ms";
/// Times between the scans, after which the robot is sent on.
const BETWEEN: &str = "[2 s, 3 s]";
/// Time of the model's scan on each channel, as Linux with 250 ticks a second has it: twice 8 ticks, and the changes of
/// the channel.
const DWELL: &str = "66 ms";
/// Loss of power on the walk alone, dB. In a corridor with a radio unit each ten metres, wpa_supplicant stays where it is:
/// its own signal is good everywhere.
const WEAKER_DB: f64 = 15.0;

/// The testbed shows no handovers.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unfit {
    #[error("no robot walks")]
    NoWalk,
    #[error("the robot that walks, `{0}`, could change between no two radio units of its network")]
    NoChoice(NodeId),
    #[error("no service measures the robot's packets: one with the program `navigation` does")]
    NoService,
}

/// Checks that a testbed shows handovers.
///
/// # Errors
/// [`Unfit`].
pub fn check(testbed: &Testbed) -> Result<(), Unfit> {
    let walks = testbed.walks.first().ok_or(Unfit::NoWalk)?;
    let robot = testbed.graph.robots().find(|(node, _)| node.id == walks.robot);
    let network = robot.map(|(_, robot)| &robot.network);
    if testbed.graph.radio_units().filter(|(_, unit)| Some(&unit.network) == network).count() < 2 {
        return Err(Unfit::NoChoice(walks.robot.clone()));
    }
    if !testbed.services.iter().any(|service| service.navigates()) {
        return Err(Unfit::NoService);
    }
    Ok(())
}

/// Returns the settings of a walk on a kind of radio, as paths in the testbed file with values. The model's handovers are
/// frames on the air, and its scans those of Linux.
pub fn settings(testbed: &Testbed, kind: Kind, walk: Walk) -> Vec<(String, String)> {
    let mut settings = vec![
        ("plugin".to_owned(), "probing".to_owned()),
        ("wireless.*.wifi".to_owned(), kind.name.to_owned()),
        ("walks.*.position_interval".to_owned(), PACKETS.to_owned()),
        ("plugins.probing.settings.interval".to_owned(), BETWEEN.to_owned()),
        ("plugins.probing.settings.always".to_owned(), "true".to_owned()),
    ];
    if kind == MODEL {
        settings.push(("wireless.*.handover.exchange".to_owned(), "frames".to_owned()));
        settings.push(("wireless.*.handover.variation".to_owned(), "0 %".to_owned()));
        let channels: BTreeSet<u8> = testbed.graph.radio_units().map(|(_, unit)| unit.channel).collect();
        let scan = format!("{{ channels: {}, dwell: {DWELL} }}", channels.len());
        settings.push(("wireless.*.handover.scan".to_owned(), scan));
    }
    let roaming = if walk == Walk::Sent { "instructed" } else { "supplicant" };
    for node in &testbed.graph.nodes {
        let power = match &node.kind {
            NodeKind::Robot(robot) => {
                settings.push((format!("nodes.{}.roaming", node.id), roaming.to_owned()));
                robot.tx_power
            }
            NodeKind::RadioUnit(unit) => unit.tx_power,
            _ => continue,
        };
        if walk == Walk::Alone {
            settings.push((format!("nodes.{}.tx_power", node.id), format!("{} dBm", power.0 - WEAKER_DB)));
        }
    }
    settings
}

/// Files that [`Comparison::write`] makes.
pub const FILES: [&str; 6] =
    ["handover.svg", "handover.md", "handover.json", "roams.csv", "scans.csv", "handover.tex"];

/// Handovers on all kinds of radio.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The walks, each with its kind.
    pub walks: Vec<Walked>,
    /// Figures of each kind and walk.
    pub rows: Vec<Row>,
    /// Whether the model's gaps lie in the intervals of the others'.
    pub verdicts: Vec<Verdict>,
    /// Places at which robots roamed by themselves.
    pub places: Vec<Place>,
}

/// The part of a [`Comparison`] that is read again.
#[derive(Deserialize)]
struct Stored {
    walks: Vec<Walked>,
}

/// Largest stored comparison, bytes.
const MAX_STORED: u64 = 64 << 20;

/// Reads the walks of an earlier comparison from its folder.
///
/// # Errors
/// [`FolderError`].
pub fn read(folder: &Path) -> Result<Vec<Walked>, FolderError> {
    let path = folder.join(FILES[2]);
    let fail = |error| FolderError::new(&path, error);
    let mut text = String::new();
    fs::File::open(&path).map_err(fail)?.take(MAX_STORED).read_to_string(&mut text).map_err(fail)?;
    let stored: Stored = serde_json::from_str(&text).map_err(|error| fail(io::Error::other(error)))?;
    Ok(stored.walks)
}

impl Comparison {
    /// Compares the walks. `seed` is that of the bootstrap.
    pub fn of(walks: Vec<Walked>, seed: u64) -> Self {
        let (rows, verdicts) = (figures::rows(&walks), figures::verdicts(&walks, seed));
        let places = places::places(&walks);
        Self { walks, rows, verdicts, places }
    }

    /// Returns the tables, in Markdown.
    pub fn to_markdown(&self) -> String {
        let mut text = String::from("Handovers, in ms unless said otherwise\n\n");
        text += &figures::table(&self.rows).to_markdown();
        text += "\n`sent`: a plug-in sends the robot. `alone`: it roams by itself, with 15 dB less power. Gaps by events go from \
                 the first step to the association, those by packets are the longest time without an answer to a position \
                 packet, of which there is one each 5 ms.\n\n";
        if self.verdicts.is_empty() {
            text += "The model is compared with no other kind of radio: no other was measured.\n";
        } else {
            text += &figures::verdict_table(&self.verdicts).to_markdown();
        }
        if !self.places.is_empty() {
            text += "\n";
            text += &places::table(&self.places).to_markdown();
        }
        if self.rows.iter().any(|row| Kind::named(&row.kind).is_some_and(|kind| !kind.is_emulated)) {
            text += "\nPackets and places are not measured on real radios: the packets go between programs of other machines, \
                     and nothing here moves the robot. Single frames that are sent again are counted there alone.\n";
        }
        text
    }

    /// Writes the figure, `handover`, in a format.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write_figure(&self, folder: &Path, format: Format) -> Result<(), FolderError> {
        write_file(folder, &format!("handover.{format}"), drawn::figure(&self.walks).draw().render(format))
    }

    /// Writes [`FILES`]: the figure, the tables, and all handovers and scans.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, folder: &Path) -> Result<(), FolderError> {
        let [_, tables, data, roams, scans, for_papers] = FILES;
        self.write_figure(folder, Format::Svg)?;
        write_file(folder, tables, self.to_markdown())?;
        let json = serde_json::to_string_pretty(self).expect("a comparison is valid JSON");
        write_file(folder, data, json + "\n")?;
        write_file(folder, roams, measured::roams(&self.walks).to_csv())?;
        write_file(folder, scans, measured::scans(&self.walks).to_csv())?;
        let papers = [figures::table(&self.rows), figures::verdict_table(&self.verdicts)];
        write_file(folder, for_papers, papers.iter().map(DataTable::to_latex).collect::<Vec<_>>().join("\n"))
    }
}

/// Cell of a table for a figure that a kind of radio does not have.
const NOT_MEASURED: &str = "not measured";

/// Returns a figure for readers.
fn shown(figure: Option<f64>) -> String {
    figure.map_or_else(|| "–".to_owned(), |figure| format!("{figure:.2}"))
}
