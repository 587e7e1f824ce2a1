//! `cotorra doctor`: lists what this machine can do. A missing capability is shown with the reason and a remedy, and one
//! that only its use shows with a trial.

use console::{Term, style};
use cotorra_datapath::{CapabilityState, Privilege, enter_user_namespace_if_needed, probe};
use cotorra_testbed::wifi_programs;

use crate::{output, table::wrap};

/// Longest line in columns, for easy reading.
const WIDEST: usize = 100;

/// Tries every capability, and prints the results.
pub fn doctor() -> miette::Result<()> {
    let privilege = enter_user_namespace_if_needed();
    let mut capabilities = probe();
    let of_radios = capabilities.iter().position(|c| c.name == "mac80211_hwsim");
    let place = of_radios.map_or(capabilities.len(), |place| place + 1);
    capabilities.splice(place..place, wifi_programs());
    let width = usize::from(Term::stdout().size().1).min(WIDEST);
    let widest = capabilities.iter().map(|c| c.name.len()).max().unwrap_or(0);
    let indent = " ".repeat(4);
    let mut text = String::new();
    for capability in &capabilities {
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
            CapabilityState::Unknown { detail, trial } => {
                text += &format!("{} {}  {}\n", style("?").yellow(), style(name).bold(), capability.purpose);
                text += &wrap(&format!("not known: {detail}"), &indent, width);
                text += &wrap(&format!("to find out: {trial}"), &indent, width);
            }
            CapabilityState::Missing { reason, remedy } => {
                text += &format!("{} {}  {}\n", style("✗").red(), style(name).bold(), capability.purpose);
                text += &wrap(&format!("why: {reason}"), &indent, width);
                text += &wrap(&format!("what to do: {remedy}"), &indent, width);
            }
        }
    }
    text += "\n";
    text += &match privilege {
        Ok(Privilege::Root) => "cotorra can run testbeds here, as root.\n".to_owned(),
        Ok(Privilege::UserNamespace) => {
            "cotorra can run testbeds here, as an ordinary user in a user namespace.\n".to_owned()
        }
        Err(error) => format!("cotorra cannot run testbeds here: {error}.\n"),
    };
    output::print(&text)
}
