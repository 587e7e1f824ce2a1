//! `cotorra fdu import`: turns a descriptor of Eclipse fog05 v0.2 into a VNF of a testbed file.

use std::{fmt::Write as _, fs::File, io::Read as _, path::PathBuf};

use clap::{Args, Subcommand};
use cotorra_graph::{NodeId, VnfId};
use miette::{Context as _, IntoDiagnostic, miette};
use serde::Deserialize;
use serde_json::Value;

use crate::output;

/// Longest descriptor, bytes.
const LONGEST: u64 = 1 << 20;

/// Descriptors of Eclipse fog05
#[derive(Debug, Subcommand)]
pub enum Fdu {
    Import(ImportArgs),
}

/// Print an FDU descriptor of Eclipse fog05 v0.2 as a VNF for a testbed file
///
/// The hypervisors DOCKER and BARE have counterparts: a VNF with an image, and one with a command. What has none is rejected by
/// name, and nothing is printed. The frequency and architecture of CPUs, and the size of the storage, are left out.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra fdu import fdu_helloworld.json
  cotorra fdu import fdu_helloworld.json --node edge >> vnfs.yaml    then paste it under `vnfs:` of a service")]
pub struct ImportArgs {
    /// The descriptor, in JSON
    file: PathBuf,
    /// The node on which the VNF starts
    #[arg(long)]
    node: Option<NodeId>,
}

pub fn fdu(fdu: &Fdu) -> miette::Result<()> {
    let Fdu::Import(args) = fdu;
    let place = || args.file.display().to_string();
    let mut text = String::new();
    let file = File::open(&args.file).into_diagnostic().with_context(place)?;
    file.take(LONGEST + 1).read_to_string(&mut text).into_diagnostic().with_context(place)?;
    if text.len() as u64 > LONGEST {
        return Err(miette!("{}: a descriptor has {LONGEST} bytes at most", place()));
    }
    let vnf = import(&text, args.node.as_ref()).map_err(|error| miette!("{}: {error}", place()))?;
    output::print(&vnf)
}

/// A descriptor. Unknown keys are rejected.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Descriptor {
    id: String,
    #[serde(default, rename = "name")]
    _name: Option<String>,
    #[serde(default, rename = "uuid")]
    _uuid: Option<String>,
    computation_requirements: Requirements,
    image: Option<Image>,
    command: Option<Command>,
    hypervisor: String,
    migration_kind: String,
    #[serde(default)]
    storage: Value,
    #[serde(default)]
    interfaces: Value,
    #[serde(default)]
    io_ports: Value,
    #[serde(default)]
    connection_points: Value,
    #[serde(default)]
    depends_on: Value,
    #[serde(default)]
    configuration: Value,
    #[serde(default)]
    hypervisor_specific: Value,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Requirements {
    #[serde(default, rename = "cpu_arch")]
    _cpu_arch: Value,
    #[serde(default, rename = "cpu_min_freq")]
    _cpu_min_freq: Value,
    cpu_min_count: f64,
    ram_size_mb: f64,
    #[serde(default, rename = "storage_size_gb")]
    _storage_size_gb: Value,
    #[serde(default)]
    gpu_min_count: Value,
    #[serde(default)]
    fpga_min_count: Value,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Image {
    #[serde(default, rename = "uuid")]
    _uuid: Option<String>,
    #[serde(default, rename = "name")]
    _name: Option<String>,
    uri: String,
    #[serde(default)]
    checksum: Value,
    #[serde(default)]
    format: Value,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Command {
    binary: String,
    #[serde(default)]
    args: Vec<String>,
}

/// Whether a value is absent or says nothing.
fn is_empty(value: &Value) -> bool {
    match value {
        Value::Null => true,
        Value::Number(number) => number.as_f64() == Some(0.0),
        Value::String(text) => text.is_empty(),
        Value::Array(all) => all.is_empty(),
        Value::Object(all) => all.is_empty(),
        Value::Bool(_) => false,
    }
}

/// Returns the VNF of a descriptor, as YAML.
fn import(text: &str, node: Option<&NodeId>) -> Result<String, String> {
    let fdu: Descriptor =
        serde_json::from_str(text).map_err(|error| format!("no FDU descriptor: {error}"))?;
    let Requirements { gpu_min_count, fpga_min_count, cpu_min_count, ram_size_mb, .. } =
        fdu.computation_requirements;
    let unsupported = [
        ("storage", &fdu.storage),
        ("interfaces", &fdu.interfaces),
        ("io_ports", &fdu.io_ports),
        ("connection_points", &fdu.connection_points),
        ("depends_on", &fdu.depends_on),
        ("configuration", &fdu.configuration),
        ("hypervisor_specific", &fdu.hypervisor_specific),
        ("gpu_min_count", &gpu_min_count),
        ("fpga_min_count", &fpga_min_count),
    ];
    if let Some((key, value)) = unsupported.into_iter().find(|(_, value)| !is_empty(value)) {
        return Err(format!("`{key}` has no counterpart in a testbed file: {value}"));
    }
    if fdu.migration_kind != "COLD" {
        return Err(format!(
            "`migration_kind` {}: cotorra starts a new instance elsewhere",
            fdu.migration_kind
        ));
    }
    let id = VnfId::new(&fdu.id).map_err(|error| format!("`id`: {error}"))?;
    for (key, value) in [("cpu_min_count", cpu_min_count), ("ram_size_mb", ram_size_mb)] {
        if !(value.is_finite() && (0.0..=1e9).contains(&value)) {
            return Err(format!("`{key}` is {value}"));
        }
    }
    let words = fdu.command.map(|command| [vec![command.binary], command.args].concat());
    let image = match (fdu.hypervisor.as_str(), fdu.image) {
        ("DOCKER", Some(image)) => {
            let more = [("checksum", &image.checksum), ("format", &image.format)];
            if let Some((key, value)) = more.into_iter().find(|(_, value)| !is_empty(value)) {
                return Err(format!("`image.{key}` {value}: name the image by its digest instead"));
            }
            Some(image.uri.strip_prefix("docker://").map(str::to_owned).unwrap_or(image.uri))
        }
        ("DOCKER", None) => return Err("a DOCKER descriptor without an `image`".to_owned()),
        ("BARE", None) if words.is_some() => None,
        ("BARE", None) => return Err("a BARE descriptor without a `command`".to_owned()),
        ("BARE", Some(image)) => {
            return Err(format!(
                "`image` {} of a BARE descriptor: unpack it beside the testbed file",
                image.uri
            ));
        }
        (other, _) => return Err(format!("`hypervisor` {other}: only DOCKER and BARE have counterparts")),
    };
    let mut yaml = format!("{id}:\n");
    let mut line = |key: &str, value: String| {
        writeln!(yaml, "  {key}: {value}").expect("a string takes all");
    };
    if let Some(image) = &image {
        line("image", Value::from(image.as_str()).to_string());
    }
    if let Some(words) = &words {
        line("command", Value::from(words.as_slice()).to_string());
    }
    if let Some(node) = node {
        line("node", node.to_string());
    }
    line("cpus", cpu_min_count.to_string());
    line("memory", format!("{ram_size_mb} MB"));
    Ok(yaml)
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::*;

    const HELLO: &str = r#"{
        "id": "hello", "name": "hello-world",
        "computation_requirements": { "cpu_arch": "x86_64", "cpu_min_freq": 0, "cpu_min_count": 1,
            "ram_size_mb": 64.0, "storage_size_gb": 0.1 },
        "image": { "uri": "docker.io/library/hello:1", "checksum": "", "format": "" },
        "storage": [], "hypervisor": "DOCKER", "migration_kind": "COLD", "interfaces": [], "io_ports": [],
        "connection_points": [], "depends_on": [] }"#;
    const NATIVE: &str = r#"{
        "id": "native", "name": "native",
        "computation_requirements": { "cpu_arch": "arm64", "cpu_min_freq": 0, "cpu_min_count": 2, "ram_size_mb": 128 },
        "command": { "binary": "/usr/bin/python3", "args": ["-m", "http.server"] },
        "hypervisor": "BARE", "migration_kind": "COLD" }"#;

    #[test]
    fn descriptors_become_vnfs_that_a_testbed_file_takes() {
        let node: NodeId = "edge".parse().unwrap();
        let vnfs = [HELLO, NATIVE].map(|text| import(text, Some(&node)).unwrap()).concat();
        let indented: String = vnfs.lines().map(|line| format!("      {line}\n")).collect();
        let folder = TempDir::new().unwrap();
        let file = folder.path().join("testbed.yaml");
        let head = "name: fog\nwireless: { w: {} }\nnodes:\n  edge: { kind: server, tier: edge, cpus: 4, memory: 1 GB }\n  \
                    robot: { kind: robot, position: [0, 0] }\n  R1: { kind: radio_unit, position: [1, 0], channel: 1 }\n\
                    links:\n  - { ends: [R1, edge] }\n";
        let service = "services:\n  s:\n    robot: robot\n    kpis: { service_time: 1 s }\n    vnfs:\n";
        std::fs::write(&file, format!("{head}{service}{indented}")).unwrap();
        let testbed = cotorra_testbed_file::load(&file).unwrap();
        let [hello, native] = &testbed.services[0].vnfs[..] else { panic!("two VNFs") };
        assert_eq!(hello.image.as_ref().unwrap().reference, "docker.io/library/hello:1");
        assert_eq!((hello.cpus, hello.memory_bytes), (1.0, 64_000_000));
        let words = ["/usr/bin/python3", "-m", "http.server"].map(str::to_owned).to_vec();
        assert_eq!(native.program, cotorra_graph::Program::Command(words));
    }

    #[test]
    fn what_has_no_counterpart_is_rejected_by_name() {
        let rejected = |from: &str, to: &str| {
            assert!(HELLO.contains(from), "{from}");
            import(&HELLO.replace(from, to), None).unwrap_err()
        };
        for (from, to, named) in [
            ("DOCKER", "KVM", "KVM"),
            ("DOCKER", "LXD", "LXD"),
            ("COLD", "LIVE", "migration_kind"),
            (r#""interfaces": []"#, r#""interfaces": [{ "name": "eth0" }]"#, "interfaces"),
            (r#""depends_on": []"#, r#""depends_on": ["other"]"#, "depends_on"),
            (r#""checksum": """#, r#""checksum": "abc""#, "checksum"),
            (r#""storage": []"#, r#""disk": []"#, "disk"),
            (r#""id": "hello""#, r#""id": "no name""#, "id"),
            (r#""cpu_min_count": 1"#, r#""cpu_min_count": -1"#, "cpu_min_count"),
        ] {
            let error = rejected(from, to);
            assert!(error.contains(named), "{error}");
        }
        assert!(import("[]", None).is_err());
    }
}
