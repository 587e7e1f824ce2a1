//! Parameters that a node watches.

use std::time::Duration;

use cotorra_ros_messages::queue::RecvError;
use parking_lot::{Condvar, Mutex};

use crate::xmlrpc::Value;

/// A watched parameter.
#[derive(Debug)]
pub(super) struct Watch {
    pub name: String,
    state: Mutex<WatchState>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct WatchState {
    value: Option<Value>,
    fresh: bool,
    closed: bool,
}

impl Watch {
    pub fn new(name: String) -> Self {
        Self { name, state: Mutex::default(), changed: Condvar::new() }
    }

    /// Sets the value that the master returned, unless a newer one came in the meantime.
    pub fn begin(&self, value: &Value) {
        let mut state = self.state.lock();
        if !state.fresh {
            state.value = set(value).cloned();
        }
    }

    /// The value; `None` if it is not set.
    pub fn value(&self) -> Option<Value> {
        self.state.lock().value.clone()
    }

    /// Waits for the next change. A change since the last call counts.
    pub fn changed(&self, timeout: Duration) -> Result<Option<Value>, RecvError> {
        let mut state = self.state.lock();
        let same = |state: &mut WatchState| !state.fresh && !state.closed;
        self.changed.wait_while_for(&mut state, same, timeout);
        match (std::mem::take(&mut state.fresh), state.closed) {
            (true, _) => Ok(state.value.clone()),
            (false, true) => Err(RecvError::ShutDown),
            (false, false) => Err(RecvError::Timeout),
        }
    }

    /// Applies the change of a parameter: this one, one above it or one in it.
    pub fn update(&self, name: &str, value: &Value) {
        let name = name.trim_end_matches('/');
        let mut state = self.state.lock();
        if let Some(inner) = self.name.strip_prefix(name) {
            if !(inner.is_empty() || inner.starts_with('/')) {
                return;
            }
            state.value = path(inner).try_fold(value, member).and_then(set).cloned();
        } else if let Some(inner) = name.strip_prefix(&self.name).filter(|inner| inner.starts_with('/')) {
            put(state.value.get_or_insert_with(|| Value::Struct([].into())), path(inner), value);
        } else {
            return;
        }
        state.fresh = true;
        drop(state);
        self.changed.notify_all();
    }

    pub fn close(&self) {
        self.state.lock().closed = true;
        self.changed.notify_all();
    }
}

fn path(name: &str) -> impl Iterator<Item = &str> {
    name.split('/').filter(|part| !part.is_empty())
}

fn member<'a>(value: &'a Value, name: &str) -> Option<&'a Value> {
    if let Value::Struct(members) = value { members.get(name) } else { None }
}

/// The value of a parameter. The master returns an empty struct if it is not set.
fn set(value: &Value) -> Option<&Value> {
    (*value != Value::Struct([].into())).then_some(value)
}

/// Puts a value at a path.
fn put<'a>(mut at: &mut Value, path: impl Iterator<Item = &'a str>, value: &Value) {
    for part in path {
        if !matches!(at, Value::Struct(_)) {
            *at = Value::Struct([].into());
        }
        let Value::Struct(members) = at else { return };
        at = members.entry(part.to_owned()).or_insert_with(|| Value::Struct([].into()));
    }
    *at = value.clone();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch(name: &str) -> Watch {
        Watch::new(name.to_owned())
    }

    #[test]
    fn watch_follows_its_parameter_and_those_above_it() {
        let speed = watch("/robot/speed");
        speed.update("/robot/speed/", &1.into());
        assert_eq!(speed.value(), Some(1.into()));
        speed.update("/robot/speed_limit", &2.into());
        assert_eq!(speed.value(), Some(1.into()));
        speed.update("/robot", &Value::Struct([("speed".to_owned(), 3.into())].into()));
        assert_eq!(speed.value(), Some(3.into()));
        speed.update("/robot/speed", &Value::Struct([].into()));
        assert_eq!(speed.value(), None);
    }

    #[test]
    fn watch_follows_parameters_in_it() {
        let robot = watch("/robot");
        robot.update("/robot/arm/speed/", &1.into());
        let arm = Value::Struct([("speed".to_owned(), 1.into())].into());
        assert_eq!(robot.value(), Some(Value::Struct([("arm".to_owned(), arm)].into())));
        robot.update("/robots", &1.into());
        robot.update("/robot/arm", &2.into());
        assert_eq!(robot.value(), Some(Value::Struct([("arm".to_owned(), 2.into())].into())));
    }
}
