//! `cotorra fdu import`: turns a descriptor of Eclipse fog05 v0.2 into a VNF of a testbed file.

use std::{fs::File, io::Read as _, path::PathBuf};

use clap::{Args, Subcommand};
use cotorra_graph::NodeId;
use cotorra_lifecycle::{Descriptor, DescriptorError, LONGEST_DESCRIPTOR};
use miette::{Context as _, IntoDiagnostic, miette};

use crate::output;

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
    file.take(LONGEST_DESCRIPTOR as u64 + 1)
        .read_to_string(&mut text)
        .into_diagnostic()
        .with_context(place)?;
    let vnf = import(&text, args.node.as_ref()).map_err(|error| miette!("{}: {error}", place()))?;
    output::print(&vnf)
}

/// Returns the VNF of a descriptor, as YAML.
fn import(text: &str, node: Option<&NodeId>) -> Result<String, DescriptorError> {
    Descriptor::read(text.as_bytes())?.yaml(node)
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
}
