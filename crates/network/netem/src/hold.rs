//! Conditions that last as long as a run. A run holds interfaces of this machine and restores them when it ends.
//! Interfaces left by a killed run are found by their records and restored by the next run.

use std::{io, mem};

use crate::{
    device::{Device, Interface, Plan},
    kernel::{Error, Kernel},
    record::{Owner, Record},
    rule::{Counters, DisciplineError, Rule},
};

/// Explicit permissions for changes that may do harm.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Confirmed {
    /// Whether NetEm may replace a queueing discipline that somebody configured.
    pub replace: bool,
    /// Interfaces to change even if they are the loopback or carry the default route.
    pub interfaces: Vec<String>,
}

/// An interface that cannot be held. Nothing has changed.
#[derive(Debug, thiserror::Error)]
pub enum HoldError {
    /// It is the loopback interface.
    #[error(
        "`{0}` is the loopback interface, which this machine's own programs use: pass `--allow-interface {0}` to \
         change it anyway"
    )]
    Loopback(String),
    /// It carries the default route, so remote sessions to this machine would suffer.
    #[error(
        "`{0}` carries the default route and may carry remote sessions to this machine: pass `--allow-interface {0}` to \
         change it anyway"
    )]
    DefaultRoute(String),
    /// It has conditions already.
    #[error(
        "`{0}` has conditions already: `cotorra netem show {0}` shows them, `cotorra netem clear {0}` removes them"
    )]
    Conditioned(String),
    /// Another run holds it.
    #[error("`{interface}` is held by another run, process {pid}")]
    Held {
        /// Name of the interface.
        interface: String,
        /// Process ID of that run.
        pid: u32,
    },
    /// A rule cannot be installed.
    #[error(transparent)]
    Discipline(#[from] DisciplineError),
    /// The record cannot be written, so a killed run could not be undone.
    #[error("cannot record how to restore the interface: {0}")]
    Record(io::Error),
    /// A kernel request failed.
    #[error(transparent)]
    Netem(#[from] Error),
}

/// Interfaces held by this process. Dropping it restores them.
#[derive(Debug)]
pub struct Hold {
    kernel: Kernel,
    interfaces: Vec<(Interface, Record)>,
}

impl Hold {
    /// Opens the calling thread's network namespace, without holding any interface.
    ///
    /// # Errors
    /// [`Error::Socket`].
    pub fn new() -> Result<Self, Error> {
        Ok(Self { kernel: Kernel::open()?, interfaces: Vec::new() })
    }

    /// Returns the plan of [`Self::take`] without applying it.
    ///
    /// # Errors
    /// [`HoldError`].
    pub fn plan(&self, name: &str, rules: &[Rule], confirmed: &Confirmed) -> Result<Plan, HoldError> {
        self.prepare(name, rules, confirmed).map(|(_, plan)| plan)
    }

    /// Holds an interface with these rules.
    ///
    /// # Errors
    /// [`HoldError`].
    pub fn take(&mut self, name: &str, rules: &[Rule], confirmed: &Confirmed) -> Result<(), HoldError> {
        let (device, plan) = self.prepare(name, rules, confirmed)?;
        let mut record = Record::of_this_process().map_err(HoldError::Record)?;
        rules.iter().for_each(|rule| record.note(&device, rule));
        let interface = device.interface();
        record.save(interface).map_err(HoldError::Record)?;
        if let Err(error) = self.kernel.apply(&plan) {
            Record::forget(interface);
            return Err(error.into());
        }
        self.interfaces.push((interface.clone(), record));
        Ok(())
    }

    fn prepare(
        &self,
        name: &str,
        rules: &[Rule],
        confirmed: &Confirmed,
    ) -> Result<(Device, Plan), HoldError> {
        let device = self.kernel.device(name)?;
        let interface = device.interface();
        if !confirmed.interfaces.iter().any(|meant| meant == name) {
            if interface.loopback {
                return Err(HoldError::Loopback(name.to_owned()));
            }
            if self.kernel.default_routes()?.contains(&interface.index) {
                return Err(HoldError::DefaultRoute(name.to_owned()));
            }
        }
        if let Some(owner) = Record::read(interface).owner.filter(Owner::is_alive) {
            return Err(HoldError::Held { interface: name.to_owned(), pid: owner.pid });
        }
        if device.rules().next().is_some() {
            return Err(HoldError::Conditioned(name.to_owned()));
        }
        let plan = device.set_all(rules, confirmed.replace)?;
        Ok((device, plan))
    }

    /// Changes the conditions of a rule on a held interface in place. They apply when this returns.
    ///
    /// # Errors
    /// [`Error`]; then nothing has changed.
    pub fn set(&mut self, name: &str, rule: &Rule) -> Result<(), HoldError> {
        let mut device = self.kernel.device(name)?;
        let held = self.interfaces.iter_mut().find(|(interface, _)| interface == device.interface());
        let Some((interface, record)) = held else { return Err(Error::gone(name).into()) };
        record.recall(&mut device);
        record.note(&device, rule);
        self.kernel.apply(&device.set(rule, false)?)?;
        // The state to restore is unchanged and already on disk, so a failure here is harmless.
        let _ = record.save(interface);
        Ok(())
    }

    /// Returns all rules of a held interface with their counters.
    ///
    /// # Errors
    /// [`Error`].
    pub fn rules(&self, name: &str) -> Result<Vec<(Rule, Counters)>, Error> {
        Ok(self.kernel.device(name)?.rules().collect())
    }

    /// Restores all held interfaces. Returns those that failed; [`put_back`] can retry them.
    pub fn release(&mut self) -> Vec<(Interface, Error)> {
        let give = |(interface, record): (Interface, Record)| {
            restore(&self.kernel, &interface, &record).err().map(|error| (interface, error))
        };
        mem::take(&mut self.interfaces).into_iter().filter_map(give).collect()
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        self.release();
    }
}

/// Returns the interfaces of this network namespace that a killed process held.
pub fn leftovers() -> Vec<Interface> {
    let is_left =
        |interface: &Interface| Record::read(interface).owner.is_some_and(|owner| !owner.is_alive());
    Record::interfaces().into_iter().filter(is_left).collect()
}

/// Restores the interfaces of killed processes. Returns each with its result.
pub fn put_back() -> Vec<(Interface, Result<(), Error>)> {
    let stale = leftovers();
    if stale.is_empty() {
        return Vec::new();
    }
    match Kernel::open() {
        Ok(kernel) => {
            let restore = |interface: Interface| {
                let done = restore(&kernel, &interface, &Record::read(&interface));
                (interface, done)
            };
            stale.into_iter().map(restore).collect()
        }
        Err(error) => {
            let message = error.to_string();
            let failed = |interface| (interface, Err(Error::Socket(io::Error::other(message.clone()))));
            stale.into_iter().map(failed).collect()
        }
    }
}

fn restore(kernel: &Kernel, interface: &Interface, record: &Record) -> Result<(), Error> {
    let found = kernel.devices()?.into_iter().find(|device| {
        // Its index or name may belong to another interface by now.
        (device.interface().index, &device.interface().name) == (interface.index, &interface.name)
    });
    if let Some(device) = found {
        kernel.apply(&device.restore(record.replaced.as_ref()))?;
    }
    Record::forget(interface);
    Ok(())
}
