//! Variables of instances, as the core sent them.

use std::collections::BTreeMap;

use cotorra_graph::VnfId;
use parking_lot::Mutex;

/// Variables by their names.
pub(crate) type Environment = BTreeMap<String, String>;

/// The variables of each instance of a run.
#[derive(Debug, Default)]
pub(crate) struct Environments(Mutex<BTreeMap<(VnfId, u32), Environment>>);

impl Environments {
    /// Sets the variables of an instance that is started next.
    pub(crate) fn set(&self, vnf: &VnfId, replica: u32, environment: Environment) {
        self.0.lock().insert((vnf.clone(), replica), environment);
    }

    /// Returns the variables of an instance.
    pub(crate) fn of(&self, vnf: &VnfId, replica: u32) -> Environment {
        self.0.lock().get(&(vnf.clone(), replica)).cloned().unwrap_or_default()
    }

    /// Returns a variable of a VNF's instances, which is the same for all.
    pub(crate) fn shared(&self, vnf: &VnfId, name: &str) -> Option<String> {
        let all = self.0.lock();
        let (_, environment) = all.range((vnf.clone(), 0)..).next().filter(|((id, _), _)| id == vnf)?;
        environment.get(name).cloned()
    }
}
