//! `cotorra netem`: conditions of real interfaces of this machine, by the kernel's NetEm.

mod args;
pub mod show;

use cotorra_netem::{Device, Error, Kernel, Plan, Record, Rule, Side};
use miette::{IntoDiagnostic, miette};

pub use self::args::Netem;
use self::args::{ClearArgs, SetArgs, ShowArgs};
use crate::output;

/// Sets, shows or clears conditions.
pub fn netem(command: &Netem) -> miette::Result<()> {
    match command {
        Netem::Set(args) => set(args),
        Netem::Show(args) => show(args),
        Netem::Clear(args) => clear(args),
    }
}

/// Returns the interface, and the record that cotorra keeps of it. The record completes what the kernel reports.
fn device(kernel: &Kernel, name: &str) -> miette::Result<(Device, Record)> {
    let mut device = kernel.device(name).map_err(explained)?;
    let record = Record::load(&device);
    record.recall(&mut device);
    Ok((device, record))
}

/// Adds to an error what to do instead, if there is an alternative.
fn explained(error: Error) -> miette::Report {
    let help = match &error {
        Error::Missing { module: "sch_netem" } => {
            "links between a testbed's nodes do not need it: cotorra emulates them itself (`cotorra run`)"
        }
        Error::Missing { module: "ifb" | "sch_ingress" } => {
            "set the conditions for leaving packets at the other end of the link instead"
        }
        Error::Missing { module: "sch_htb" | "cls_u32" } => {
            "leave out --to and --from: conditions for all packets need no filter"
        }
        _ => return miette!("{error}"),
    };
    miette!(help = help, "{error}")
}

/// Fails if a run holds the interface, because only that run changes and restores it.
fn is_free(record: &Record, name: &str) -> miette::Result<()> {
    match record.owner {
        None => Ok(()),
        Some(owner) if owner.is_alive() => Err(miette!(
            help = "`cotorra link set` changes the link over it; the end of the run restores the interface",
            "`{name}` is held by a run, process {}",
            owner.pid
        )),
        Some(_) => Err(miette!(
            help = "`cotorra clean` restores it",
            "`{name}` still has the conditions of a run that was killed"
        )),
    }
}

fn set(args: &SetArgs) -> miette::Result<()> {
    let rule = args.rule().map_err(|reason| miette!("{reason}"))?;
    let kernel = Kernel::open().into_diagnostic()?;
    let (device, mut record) = device(&kernel, &args.packets.interface)?;
    is_free(&record, &args.packets.interface)?;
    if let Some(mean) = args.raised_mean() {
        note!("note: with this jitter, the mean delay is {mean:?}: delays below zero count as zero");
    }
    let plan = device.set(&rule, args.replace).into_diagnostic()?;
    if args.dry_run {
        return output::print(&plan.to_string());
    }
    record.note(&device, &rule);
    // The record of a discipline that is replaced is saved first, so that it can be restored in any case.
    if let Err(error) = record.save(device.interface()) {
        if record.replaced.is_some() {
            return Err(miette!(
                "cannot save the record of the queueing discipline that NetEm would replace: {error}"
            ));
        }
        tracing::debug!("shapes of jitter are not remembered: {error}");
    }
    if let Err(error) = kernel.apply(&plan) {
        if device.rules().next().is_none() {
            Record::forget(device.interface());
        }
        return Err(explained(error));
    }
    note_losses(&plan, &device);
    let kept = self::device(&kernel, &args.packets.interface)?.0;
    let found = kept
        .rules()
        .map(|(kept, _)| kept)
        .find(|kept| (kept.side, kept.network) == (rule.side, rule.network));
    let Some(kept) = found else {
        return Err(miette!(
            "the kernel accepted the conditions, but does not have them: another program changed them"
        ));
    };
    if rule.netem.seed.is_some() && kept.netem.seed != rule.netem.seed {
        note!("note: this kernel's NetEm takes no seed (Linux 6.7 and later do): losses differ each time");
    }
    output::print(&line(&device, &kept))
}

fn line(device: &Device, rule: &Rule) -> String {
    format!("{} {}: {}\n", device.interface().name, show::packets(rule), show::conditions(&rule.netem))
}

/// Notes how many packets a plan may have lost.
fn note_losses(plan: &Plan, device: &Device) {
    let waiting: u64 = device.rules().map(|(_, counters)| counters.waiting).sum();
    if plan.loses_packets() && waiting > 0 {
        note!("note: up to {waiting} packets that waited in the old conditions were lost");
    }
}

fn show(args: &ShowArgs) -> miette::Result<()> {
    let kernel = Kernel::open().into_diagnostic()?;
    let devices = match &args.interface {
        Some(name) => vec![device(&kernel, name)?.0],
        None => {
            let mut devices = kernel.devices().map_err(explained)?;
            // The conditions of a detour are shown with the interface that it belongs to.
            devices.retain(|device| !device.is_detour());
            for device in &mut devices {
                Record::load(device).recall(device);
            }
            devices
        }
    };
    if args.json {
        return output::print_exact(&format!("{:#}\n", show::json(&devices)));
    }
    output::print(&show::table(&devices))
}

fn clear(args: &ClearArgs) -> miette::Result<()> {
    let kernel = Kernel::open().into_diagnostic()?;
    let (device, record) = device(&kernel, &args.packets.interface)?;
    is_free(&record, &args.packets.interface)?;
    let replaced = record.replaced.as_ref();
    let plans = match args.packets.which() {
        (Side::Egress, None) => {
            vec![device.clear(Side::Ingress, None), device.clear(Side::Egress, replaced)]
        }
        (Side::Ingress, None) => vec![device.clear(Side::Ingress, None)],
        (side, network) => vec![device.remove(side, network, replaced)],
    };
    if args.dry_run {
        return output::print(&plans.iter().map(Plan::to_string).collect::<String>());
    }
    if plans.iter().all(Plan::is_empty) {
        return output::print(&format!("{} has no such conditions\n", device.interface().name));
    }
    for plan in &plans {
        kernel.apply(plan).map_err(explained)?;
        note_losses(plan, &device);
    }
    let left = kernel.device(&args.packets.interface).map_err(explained)?;
    if left.rules().next().is_none() {
        Record::forget(left.interface());
    }
    let back = replaced.filter(|_| left.foreign().is_some()).map(|was| format!("; {} is back", was.kind));
    output::print(&format!("{}: cleared{}\n", device.interface().name, back.unwrap_or_default()))
}
