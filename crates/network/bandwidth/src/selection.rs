//! Selections of allocations by the parameters of a query.

use cotorra_mec::InvalidRequest;

use crate::types::BwInfo;

/// Which allocations a list has.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Selection {
    apps: Vec<String>,
    names: Vec<String>,
    sessions: Vec<String>,
}

impl Selection {
    /// Reads the parameters of a query. Only one kind may be given.
    ///
    /// # Errors
    /// [`InvalidRequest::Malformed`].
    pub fn read(parameters: &[(String, String)]) -> Result<Self, InvalidRequest> {
        let mut selection = Self::default();
        for (name, value) in parameters {
            let list = match name.as_str() {
                "app_instance_id" => &mut selection.apps,
                "app_name" => &mut selection.names,
                "session_id" => &mut selection.sessions,
                _ => {
                    return InvalidRequest::malformed(format!(
                        "there is no parameter `{name}`; there are app_instance_id, app_name, session_id"
                    ));
                }
            };
            list.extend(value.split(',').map(str::to_owned));
        }
        let kinds = [&selection.apps, &selection.names, &selection.sessions];
        if kinds.iter().filter(|list| !list.is_empty()).count() > 1 {
            return InvalidRequest::malformed(
                "only one of app_instance_id, app_name and session_id can be given",
            );
        }
        Ok(selection)
    }

    pub(crate) fn has(&self, info: &BwInfo) -> bool {
        let among = |list: &[String], value: &Option<String>| {
            list.is_empty() || value.as_ref().is_some_and(|value| list.contains(value))
        };
        let is_session = info.request_type == 1;
        (self.apps.is_empty() || self.apps.contains(&info.app_ins_id))
            && among(&self.names, &info.app_name)
            && (self.sessions.is_empty() || is_session && among(&self.sessions, &info.allocation_id))
    }
}
