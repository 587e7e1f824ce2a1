//! Twins of runs: the same testbed with the same seed, but with a plug-in beside the core. The difference of both is the regret
//! of old context.

use std::time::Duration;

use cotorra_graph::{PluginId, PluginSpec, Testbed, Way};
use cotorra_measurements::RunInfo;
use cotorra_testbed_file::Setting;

use crate::folder::manifest::Manifest;

/// Most differences that an error names.
const NAMED: usize = 5;

/// Error of two runs that differ in more than the distances of plug-ins, or not even in these.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum TwinError {
    /// They differ elsewhere, too.
    #[error("the runs differ in more than the distances of plug-ins: {}", list(.0))]
    Different(Vec<String>),
    /// All plug-ins are as far from the core in both.
    #[error("the plug-ins of both runs are equally far from the core")]
    Same,
    /// A plug-in that has another distance in the second run is not beside the core there.
    #[error("`{0}` is not beside the core in the second run: name the run without distances second")]
    NotBeside(PluginId),
    /// A run has no end.
    #[error("the {0} run has no end: it was killed, or still goes on")]
    NoEnd(&'static str),
}

fn list(names: &[String]) -> String {
    let more = names.len().saturating_sub(NAMED);
    let named = names[..names.len() - more].join(", ");
    if more > 0 { format!("{named} and {more} more") } else { named }
}

/// A run that may be the twin of another one.
#[derive(Debug)]
pub struct MaybeTwin<'a> {
    pub info: &'a RunInfo,
    /// Its testbed file, with settings.
    pub testbed: &'a Testbed,
    /// How it came to be; `None` if nothing says so.
    pub manifest: Option<&'a Manifest>,
    pub ended: bool,
}

/// Returns the plug-ins of a testbed that have a distance from the core, or take time to decide.
pub fn distant(testbed: &Testbed) -> impl Iterator<Item = &PluginSpec> {
    testbed.plugins.iter().filter(|spec| !spec.distance.is_none())
}

/// Returns the settings that put a plug-in beside the core, where it decides at once.
pub fn beside_core(spec: &PluginSpec) -> Vec<Setting> {
    let key = |key: &str, value: &str| {
        Setting::new(&format!("plugins.{}.{key}", spec.id), value)
            .expect("names of plug-ins are parts of a path")
    };
    let way = match &spec.distance.way {
        Way::None => None,
        Way::Delay { .. } => Some(key("control_delay", "0 ms")),
        Way::Nodes { core, .. } => Some(key("node", core.as_str())),
    };
    let decides_in = spec.distance.decides_in.map(|_| key("decides_in", "0 ms"));
    way.into_iter().chain(decides_in).collect()
}

/// Checks that two runs differ in nothing but plug-ins with a distance in the first that are beside the core in the second.
/// Returns these plug-ins.
///
/// # Errors
/// [`TwinError`] names what else differs.
pub fn check_twin<'a>(far: &MaybeTwin<'a>, beside: &MaybeTwin<'_>) -> Result<Vec<&'a PluginSpec>, TwinError> {
    let different =
        different_runs(far, beside).into_iter().chain(different_testbeds(far.testbed, beside.testbed));
    let different: Vec<_> = different.collect();
    if !different.is_empty() {
        return Err(TwinError::Different(different));
    }
    for (run, name) in [(far, "first"), (beside, "second")] {
        if !run.ended {
            return Err(TwinError::NoEnd(name));
        }
    }
    let both = far.testbed.plugins.iter().zip(&beside.testbed.plugins);
    let moved: Vec<_> = both.filter(|(far, beside)| far.distance != beside.distance).collect();
    match moved.iter().find(|(_, beside)| !beside.distance.is_none()) {
        Some((spec, _)) => Err(TwinError::NotBeside(spec.id.clone())),
        None if moved.is_empty() => Err(TwinError::Same),
        None => Ok(moved.into_iter().map(|(far, _)| far).collect()),
    }
}

/// Names what differs between runs beside their testbeds.
fn different_runs(a: &MaybeTwin<'_>, b: &MaybeTwin<'_>) -> Vec<String> {
    let mut names = Vec::new();
    let mut compare = |name: &str, a: String, b: String| {
        if a != b {
            names.push(format!("{name} ({a} and {b})"));
        }
    };
    let time = |info: &RunInfo| if info.started_at_unix_ns == 0 { "virtual" } else { "real" }.to_owned();
    compare("the seed", a.info.seed.to_string(), b.info.seed.to_string());
    compare("the kind of time", time(a.info), time(b.info));
    if let (Some(a), Some(b)) = (a.manifest, b.manifest) {
        let until = |of: &Manifest| match of.until_s {
            Some(seconds) => format!("{} s", Duration::from_secs_f64(seconds).as_secs_f64()),
            None => "none".to_owned(),
        };
        let program = |of: &Manifest| format!("{} of commit {}", of.version, of.commit);
        compare("`--until`", until(a), until(b));
        compare("cotorra", program(a), program(b));
    }
    names
}

/// Names what differs between testbeds beside their folders and the distances of plug-ins.
fn different_testbeds(a: &Testbed, b: &Testbed) -> Vec<String> {
    let mut names = Vec::new();
    let mut compare = |name: &str, same: bool| {
        if !same {
            names.push(name.to_owned());
        }
    };
    compare("`name`", a.name == b.name);
    compare("`nodes`", a.graph.nodes == b.graph.nodes && a.graph.domains == b.graph.domains);
    compare("`links`", a.graph.links == b.graph.links);
    compare("`wireless`", a.graph.wireless == b.graph.wireless);
    compare("`services`", a.services == b.services);
    compare("`map`", a.map == b.map);
    compare("`walks`", a.walks == b.walks);
    compare("`schedule`", a.script == b.script);
    compare("`traffic`", a.traffic == b.traffic);
    compare("`probes`", a.probes == b.probes);
    compare("`reservations`", a.reservations == b.reservations);
    compare("`emulation`", a.emulation == b.emulation);
    compare("`containers`", a.containers == b.containers);
    compare("`border`", a.border == b.border);
    compare("`wais`", a.wais == b.wais);
    compare("`port_security`", a.without_port_security == b.without_port_security);
    // The way to a plug-in begins at the core's node.
    let is_of_way =
        |of: &Testbed| of.plugins.iter().any(|spec| matches!(spec.distance.way, Way::Nodes { .. }));
    compare("`core`", a.core == b.core || is_of_way(a) || is_of_way(b));
    names.extend(different_plugins(&a.plugins, &b.plugins));
    names
}

fn different_plugins(a: &[PluginSpec], b: &[PluginSpec]) -> Vec<String> {
    let list = |of: &[PluginSpec]| of.iter().map(|spec| spec.id.clone()).collect::<Vec<_>>();
    if list(a) != list(b) {
        return vec!["`plugins`".to_owned()];
    }
    let bare = |spec: &PluginSpec| PluginSpec { distance: Default::default(), ..spec.clone() };
    let differs = |(a, b): &(&PluginSpec, &PluginSpec)| bare(a) != bare(b);
    a.iter().zip(b).filter(differs).map(|(spec, _)| format!("`plugins.{}`", spec.id)).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    const TEXT: &str = "name: x
nodes:
  fog: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links:
  - { ends: [fog, edge], delay: 1 ms, rate: 10 Mbit/s }
plugins:
  - { bundled: pace, control_delay: 30 ms, decides_in: 5 ms }
  - { bundled: probing }
";

    fn with(settings: &[&str]) -> Testbed {
        let settings: Vec<Setting> = settings.iter().map(|setting| setting.parse().unwrap()).collect();
        let testbed = cotorra_testbed_file::parse_with("x.yaml", TEXT, Path::new(""), &settings);
        testbed.unwrap_or_else(|wrong| panic!("{wrong}"))
    }

    fn info(seed: u64) -> RunInfo {
        RunInfo { name: "x".to_owned(), seed, started_at_unix_ns: 0, testbed: TEXT.to_owned() }
    }

    fn check(far: &Testbed, beside: &Testbed) -> Result<Vec<PluginId>, TwinError> {
        let info = info(1);
        let run = |testbed| MaybeTwin { info: &info, testbed, manifest: None, ended: true };
        check_twin(&run(far), &run(beside))
            .map(|plugins| plugins.iter().map(|spec| spec.id.clone()).collect())
    }

    fn different(far: &Testbed, beside: &Testbed) -> String {
        check(far, beside).unwrap_err().to_string()
    }

    #[test]
    fn settings_put_a_plugin_beside_the_core_whatever_its_distance_is() {
        let pace_beside = ["plugins.pace.control_delay=0 ms", "plugins.pace.decides_in=0 ms"];
        let on_a_node = [&pace_beside[..], &["core.node=edge", "plugins.probing.node=fog"]].concat();
        for settings in [&[][..], &pace_beside[..1], &on_a_node[..]] {
            let far = with(settings);
            let [spec] = &distant(&far).collect::<Vec<_>>()[..] else { panic!("{settings:?}") };
            let beside = beside_core(spec);
            let beside: Vec<_> = settings
                .iter()
                .map(ToString::to_string)
                .chain(beside.iter().map(ToString::to_string))
                .collect();
            let beside = with(&beside.iter().map(String::as_str).collect::<Vec<_>>());
            assert_eq!(distant(&beside).count(), 0, "{settings:?}");
            assert_eq!(check(&far, &beside), Ok(vec![spec.id.clone()]));
        }
    }

    #[test]
    fn whatever_else_differs_is_named() {
        let (far, near) = (with(&[]), ["plugins.pace.control_delay=0 ms", "plugins.pace.decides_in=0 ms"]);
        let beside = |more: &str| with(&[&near[..], &[more]].concat());
        for (setting, named) in [
            ("links.fog-edge.delay=2 ms", "`links`"),
            ("nodes.fog.cpus=2", "`nodes`"),
            ("plugins.probing.settings={interval: 9 s}", "`plugins.probing`"),
            ("plugins.pace.optional=true", "`plugins.pace`"),
            ("plugin=pace", "`plugins`"),
            ("core.node=edge", "`core`"),
        ] {
            let found = different(&far, &beside(setting));
            assert_eq!(found, format!("the runs differ in more than the distances of plug-ins: {named}"));
        }
        assert_eq!(check(&far, &far), Err(TwinError::Same));
        assert_eq!(check(&with(&near), &far), Err(TwinError::NotBeside("pace".parse().unwrap())));
    }

    #[test]
    fn other_seeds_and_runs_without_an_end_are_rejected() {
        let (far, beside) =
            (with(&[]), with(&["plugins.pace.control_delay=0 ms", "plugins.pace.decides_in=0 ms"]));
        let (one, two) = (info(1), RunInfo { started_at_unix_ns: 5, ..info(2) });
        let far = MaybeTwin { info: &one, testbed: &far, manifest: None, ended: true };
        let beside = |info, ended| MaybeTwin { info, testbed: &beside, manifest: None, ended };
        assert_eq!(
            check_twin(&far, &beside(&two, true)).unwrap_err().to_string(),
            "the runs differ in more than the distances of plug-ins: the seed (1 and 2), the kind of time (virtual and real)"
        );
        assert_eq!(check_twin(&far, &beside(&one, false)).unwrap_err(), TwinError::NoEnd("second"));
    }
}
