//! `cotorra doctor`: lists what this machine can do. A missing capability is shown with the reason and a remedy, and one
//! that cannot be tried out with the way to find out.

mod security;

use std::path::Path;

use clap::Args;
use console::{Term, style};
use cotorra_datapath::{
    Capability, CapabilityState, Privilege, enter_user_namespace_if_needed, probe, probe_confinement,
};
use cotorra_testbed::wifi_programs;

use crate::{output, table::wrap};

/// Longest line in columns, for easy reading.
const WIDEST: usize = 100;

/// Check what this machine can do, and how to add the rest
///
/// Tries everything, and leaves nothing behind. Each missing capability is shown with the reason and a remedy; most runs do not
/// need it.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra doctor
  cotorra doctor --security          which promises of SECURITY.md hold here, as this user")]
pub struct DoctorArgs {
    /// Check instead what protects you from other users of this machine, and from VNFs and files of others
    #[arg(long)]
    pub security: bool,
}

/// Tries every capability, and prints the results.
pub fn doctor(args: &DoctorArgs) -> miette::Result<()> {
    if args.security {
        let mut capabilities = security::probe(Path::new("."));
        // Without namespaces, what needs them is shown as missing.
        let _ = enter_user_namespace_if_needed();
        capabilities.extend(probe_confinement());
        let holds = capabilities.iter().filter(|found| found.state.is_available()).count();
        let text = list(&capabilities) + &format!("\n{holds} of {} hold here.\n", capabilities.len());
        return output::print(&text);
    }
    let privilege = enter_user_namespace_if_needed();
    let mut capabilities = probe();
    let of_radios = capabilities.iter().position(|c| c.name == "mac80211_hwsim");
    let place = of_radios.map_or(capabilities.len(), |place| place + 1);
    capabilities.splice(place..place, wifi_programs());
    capabilities.extend(container_engines());
    let text = list(&capabilities)
        + "\n"
        + &match privilege {
            Ok(Privilege::Root) => "cotorra can run testbeds here, as root.\n".to_owned(),
            Ok(Privilege::UserNamespace) => {
                "cotorra can run testbeds here, as an ordinary user in a user namespace.\n".to_owned()
            }
            Err(error) => format!("cotorra cannot run testbeds here: {error}.\n"),
        };
    output::print(&text)
}

/// Lists capabilities, each missing one with its reason and a remedy.
fn list(capabilities: &[Capability]) -> String {
    let width = usize::from(Term::stdout().size().1).min(WIDEST);
    let widest = capabilities.iter().map(|c| c.name.len()).max().unwrap_or(0);
    let indent = " ".repeat(4);
    let mut text = String::new();
    for capability in capabilities {
        let name = format!("{:widest$}", capability.name);
        match &capability.state {
            CapabilityState::Available(detail) => {
                let detail = if detail.is_empty() { String::new() } else { format!(" ({detail})") };
                text += &format!(
                    "{} {}  {}{detail}\n",
                    style("✓").green(),
                    style(name).bold(),
                    capability.purpose
                );
            }
            CapabilityState::Unknown { reason, trial } => {
                text += &format!("{} {}  {}\n", style("?").yellow(), style(name).bold(), capability.purpose);
                text += &wrap(&format!("not known: {reason}"), &indent, width);
                text += &wrap(&format!("to find out: {trial}"), &indent, width);
            }
            CapabilityState::Missing { reason, remedy } => {
                text += &format!("{} {}  {}\n", style("✗").red(), style(name).bold(), capability.purpose);
                text += &wrap(&format!("why: {reason}"), &indent, width);
                text += &wrap(&format!("what to do: {remedy}"), &indent, width);
            }
        }
    }
    text
}

/// Tries out the engines of this machine: each starts a container.
fn container_engines() -> Vec<Capability> {
    use cotorra_containers::{Address, TrialError, try_out};
    use cotorra_graph::EngineKind;

    let tried = |(kind, name): (EngineKind, &'static str)| {
        let address = Address::find(kind).ok()?;
        let state = match try_out(kind, &address) {
            Ok(()) => CapabilityState::Available("a container ran".to_owned()),
            Err(error @ TrialError::NoProgram) => CapabilityState::Unknown {
                reason: error.to_string(),
                trial: "run a container of any image that you have, as the user who runs testbeds",
            },
            Err(error) => CapabilityState::Missing {
                reason: format!("a container cannot start: {error}"),
                remedy: "not needed: VNFs run as processes; for images, make `podman run` or `docker run` work for the \
                         user who runs testbeds, such as with `runtime = \"runc\"` in containers.conf",
            },
        };
        Some(Capability { name, purpose: "a container engine: VNFs from images", state })
    };
    let engines = [(EngineKind::Podman, "podman"), (EngineKind::Docker, "Docker")];
    let engines: Vec<_> = engines.into_iter().filter_map(tried).collect();
    if !engines.is_empty() {
        return engines;
    }
    let state = CapabilityState::Missing {
        reason: "podman is not installed, and Docker does not run".to_owned(),
        remedy: "not needed: VNFs run as processes; for images, install podman, or start Docker",
    };
    vec![Capability { name: "container engine", purpose: "VNFs from images", state }]
}
