//! Conditions that go with who set them: a run holds interfaces of this machine, and gives them back at its end as it found
//! them. What a killed one left is found by its records, and put back by the next.

use std::{io, mem};

use crate::{
    device::{Device, Interface, Plan},
    kernel::{Error, Kernel},
    record::{Owner, Record},
    rule::{Counters, DisciplineError, Rule},
};

/// What somebody said is meant, though it may do harm.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Confirmed {
    /// NetEm may take the place of a queueing discipline that somebody put there.
    pub replace: bool,
    /// Interfaces that are meant, be they the loopback or the way to everywhere else.
    pub interfaces: Vec<String>,
}

/// Why an interface is not held. Nothing has changed then.
#[derive(Debug, thiserror::Error)]
pub enum HoldError {
    /// This machine talks to itself over it.
    #[error(
        "`{0}` is the loopback interface, over which this machine talks to itself: `--allow-interface {0}` if that is meant"
    )]
    Loopback(String),
    /// Whoever is logged in from elsewhere suffers.
    #[error(
        "`{0}` carries the default route, and whoever reaches this machine over it: `--allow-interface {0}` if that is \
         meant"
    )]
    DefaultRoute(String),
    /// Somebody set conditions.
    #[error(
        "`{0}` has conditions already: `cotorra netem show {0}` shows them, `cotorra netem clear {0}` takes them away"
    )]
    Conditioned(String),
    /// Another run holds it.
    #[error("`{interface}` is held by another run, process {pid}")]
    Held {
        /// The interface.
        interface: String,
        /// The run's process.
        pid: u32,
    },
    /// A rule cannot be.
    #[error(transparent)]
    Discipline(#[from] DisciplineError),
    /// What could not be undone after a kill is not done.
    #[error("cannot write down what is to be put back: {0}")]
    Record(io::Error),
    /// The kernel.
    #[error(transparent)]
    Netem(#[from] Error),
}

/// Interfaces that this process holds. Dropping it gives them back.
#[derive(Debug)]
pub struct Hold {
    kernel: Kernel,
    interfaces: Vec<(Interface, Record)>,
}

impl Hold {
    /// Holds nothing yet, in the calling thread's network namespace.
    ///
    /// # Errors
    /// [`Error::Socket`].
    pub fn new() -> Result<Self, Error> {
        Ok(Self { kernel: Kernel::open()?, interfaces: Vec::new() })
    }

    /// What [`Self::take`] would do.
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
        if let Some(owner) = Record::left(interface).owner.filter(Owner::lives) {
            return Err(HoldError::Held { interface: name.to_owned(), pid: owner.pid });
        }
        if device.rules().next().is_some() {
            return Err(HoldError::Conditioned(name.to_owned()));
        }
        let plan = device.set_all(rules, confirmed.replace)?;
        Ok((device, plan))
    }

    /// Gives a rule of an interface that is held other conditions, in place; it does so when this returns.
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
        // What is to be put back has not changed, and is written down.
        let _ = record.save(interface);
        Ok(())
    }

    /// All rules of an interface that is held, and what the kernel counted for each.
    ///
    /// # Errors
    /// [`Error`].
    pub fn rules(&self, name: &str) -> Result<Vec<(Rule, Counters)>, Error> {
        Ok(self.kernel.device(name)?.rules().collect())
    }

    /// Gives all back as they were found; what it tells could not be, and is left to [`put_back`].
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

/// Interfaces of this network namespace that a process held which was killed.
pub fn leftovers() -> Vec<Interface> {
    let is_left = |interface: &Interface| Record::left(interface).owner.is_some_and(|owner| !owner.lives());
    Record::interfaces().into_iter().filter(is_left).collect()
}

/// Puts such interfaces back as they were found; gives each with what kept it from that.
pub fn put_back() -> Vec<(Interface, Result<(), Error>)> {
    let left = leftovers();
    if left.is_empty() {
        return Vec::new();
    }
    match Kernel::open() {
        Ok(kernel) => {
            let restore = |interface: Interface| {
                let done = restore(&kernel, &interface, &Record::left(&interface));
                (interface, done)
            };
            left.into_iter().map(restore).collect()
        }
        Err(error) => {
            let said = error.to_string();
            let failed = |interface| (interface, Err(Error::Socket(io::Error::other(said.clone()))));
            left.into_iter().map(failed).collect()
        }
    }
}

fn restore(kernel: &Kernel, interface: &Interface, record: &Record) -> Result<(), Error> {
    let found = kernel.devices()?.into_iter().find(|device| {
        // Another one may have its number, or its name, by now.
        (device.interface().index, &device.interface().name) == (interface.index, &interface.name)
    });
    if let Some(device) = found {
        kernel.apply(&device.restore(record.replaced.as_ref()))?;
    }
    Record::forget(interface);
    Ok(())
}
