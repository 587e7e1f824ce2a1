//! VNFs that come and go during a run. They belong to no service, and have the rights of a confined command.

use cotorra_graph::{AccessPoint, Event, NodeId, Program, Rights, Timestamp, Vnf, VnfId, VnfState};

use super::{Engine, Group, LAST_PACKETS, Vim, VimError, life};

/// The most VNFs that are added at a time, including those whose last instances still stop.
pub const MOST_ADDED: usize = 256;
/// The most words of a command.
const MOST_WORDS: usize = 256;
/// The most variables.
const MOST_VARIABLES: usize = 256;
/// The most bytes of a command and its variables together.
const MOST_BYTES: usize = 32 * 1024;
/// The most ports of an image.
const MOST_PORTS: usize = 64;
/// The most bytes of an image's reference.
const LONGEST_REFERENCE: usize = 512;
/// Names before a colon by which engines read an image from other places than a registry, as from a file of the machine.
const TRANSPORTS: &[&str] = &[
    "containers-storage",
    "dir",
    "docker",
    "docker-archive",
    "docker-daemon",
    "oci",
    "oci-archive",
    "ostree",
    "sif",
    "tarball",
];

/// Reason for which a VNF cannot be added to a run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AddedVnfError {
    /// A bundled program, or a node's image.
    #[error(
        "its program is not a command: only commands and images can be added, because all others belong to a service"
    )]
    Program,
    /// Neither an image nor a command.
    #[error("it has neither an image nor a command: name one of them")]
    Empty,
    /// Rights beyond those of a confined command.
    #[error(
        "it asks for `{0}`: a VNF that is added has the rights of a confined command; give it more in the testbed file"
    )]
    Rights(&'static str),
    /// A demand of a program of others.
    #[error("it has a demand: only bundled programs compute as a demand says")]
    Demand,
    /// A start after the core's end.
    #[error("it asks for `keep`: a VNF that is added ends with the run")]
    Keep,
    /// A variable of cotorra's environment.
    #[error(
        "its variable `{0}` has no value: write `NAME=VALUE`, because it gets no variables of this machine"
    )]
    Variable(String),
    /// Too many bytes, words or variables.
    #[error(
        "its command and variables are too long: at most {MOST_WORDS} words, {MOST_VARIABLES} variables and {MOST_BYTES} bytes"
    )]
    TooLong,
    /// A zero byte in a word.
    #[error("its command or a variable holds a zero byte")]
    ZeroByte,
    /// A reference that names no image of a registry.
    #[error(
        "`{0}` is not the reference of an image, such as `ros:jazzy` or `docker.io/library/ros@sha256:…`"
    )]
    Reference(String),
    /// A port that cannot be listened at.
    #[error("its ports are not 1 to 65535, each once, and at most {MOST_PORTS}")]
    Ports,
    /// CPUs or memory of nothing.
    #[error("its CPUs and its memory are not numbers above 0")]
    Capacity,
    /// A pinned VNF on another node.
    #[error("it is pinned to another node than it starts on")]
    Pinned,
}

/// Checks that a VNF is within all bounds, and asks for no rights beyond those of a confined command.
///
/// # Errors
/// [`AddedVnfError`].
pub fn check_added(vnf: &Vnf) -> Result<(), AddedVnfError> {
    let Program::Command(words) = &vnf.program else { return Err(AddedVnfError::Program) };
    if words.is_empty() && vnf.image.is_none() {
        return Err(AddedVnfError::Empty);
    }
    match &vnf.rights {
        Rights::Trusted => return Err(AddedVnfError::Rights("trusted")),
        Rights::Confined(granted) if !granted.readable.is_empty() => {
            return Err(AddedVnfError::Rights("readable"));
        }
        Rights::Confined(granted) if !granted.capabilities.is_empty() => {
            return Err(AddedVnfError::Rights("capabilities"));
        }
        Rights::Confined(_) => {}
    }
    if vnf.computing.is_some() {
        return Err(AddedVnfError::Demand);
    }
    if vnf.keep {
        return Err(AddedVnfError::Keep);
    }
    let texts = || words.iter().chain(&vnf.env);
    let bytes: usize = texts().map(String::len).sum();
    if words.len() > MOST_WORDS || vnf.env.len() > MOST_VARIABLES || bytes > MOST_BYTES {
        return Err(AddedVnfError::TooLong);
    }
    if texts().any(|text| text.contains('\0')) {
        return Err(AddedVnfError::ZeroByte);
    }
    if let Some(bare) = vnf.env.iter().find(|variable| !has_value(variable)) {
        return Err(AddedVnfError::Variable(bare.clone()));
    }
    let is_above_0 = vnf.cpus.is_finite() && vnf.cpus > 0.0 && vnf.memory_bytes > 0;
    if !is_above_0 || vnf.cpu_limit.is_some_and(|most| !most.is_finite() || most < vnf.cpus) {
        return Err(AddedVnfError::Capacity);
    }
    if vnf.pinned_to.as_ref().is_some_and(|pinned| vnf.node.only() != Some(pinned)) {
        return Err(AddedVnfError::Pinned);
    }
    let Some(image) = &vnf.image else { return Ok(()) };
    if !image.volumes.is_empty() {
        return Err(AddedVnfError::Rights("volumes"));
    }
    if !image.devices.is_empty() {
        return Err(AddedVnfError::Rights("devices"));
    }
    if !is_reference(&image.reference) {
        let shown: String = image.reference.chars().take(LONGEST_REFERENCE).collect();
        return Err(AddedVnfError::Reference(shown));
    }
    let ports = &image.ports;
    let is_twice = |(place, port): (usize, _)| ports.iter().take(place).any(|other| other == port);
    if ports.len() > MOST_PORTS
        || ports.iter().any(|port| port.port == 0)
        || ports.iter().enumerate().any(is_twice)
    {
        return Err(AddedVnfError::Ports);
    }
    Ok(())
}

/// Whether a variable is `NAME=VALUE`.
fn has_value(variable: &str) -> bool {
    let is_name = |name: &str| {
        let letters = |c: char| c.is_ascii_alphanumeric() || c == '_';
        name.chars().all(letters) && name.starts_with(|c: char| !c.is_ascii_digit())
    };
    variable.split_once('=').is_some_and(|(name, _)| is_name(name))
}

/// Whether a text is the reference of an image in a registry or in the engine's own store: a name with an optional host
/// and port, tag and digest. An engine cannot take it for an option or for a file.
fn is_reference(text: &str) -> bool {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-:/@".contains(c);
    let starts_well = text.starts_with(|c: char| c.is_ascii_alphanumeric());
    if !starts_well || text.len() > LONGEST_REFERENCE || !text.chars().all(is_plain) {
        return false;
    }
    if text.split_once(':').is_some_and(|(first, _)| TRANSPORTS.contains(&first)) {
        return false;
    }
    let (name, digest) = text.split_once('@').map_or((text, None), |(name, digest)| (name, Some(digest)));
    let is_digest = |digest: &str| {
        let parts = digest.split_once(':');
        parts.is_some_and(|(kind, digits)| !kind.is_empty() && digits.chars().all(|c| c.is_ascii_hexdigit()))
    };
    if digest.is_some_and(|digest| !is_digest(digest)) {
        return false;
    }
    let (folders, last) = name.rsplit_once('/').map_or((None, name), |(folders, last)| (Some(folders), last));
    let (last, tag) = last.split_once(':').map_or((last, None), |(last, tag)| (last, Some(tag)));
    if last.is_empty() || tag.is_some_and(|tag| tag.is_empty() || tag.contains(':')) {
        return false;
    }
    let mut folders = folders.into_iter().flat_map(|folders| folders.split('/'));
    let is_host = |host: &str| {
        let (host, port) = host.split_once(':').map_or((host, None), |(host, port)| (host, Some(port)));
        !host.is_empty() && port.is_none_or(|port| port.parse::<u16>().is_ok())
    };
    folders.next().is_none_or(is_host) && folders.all(|folder| !folder.is_empty() && !folder.contains(':'))
}

impl<E: Engine> Vim<E> {
    /// Adds a VNF, and begins to start its instances. [`Event::Placement`] reports when they serve.
    ///
    /// # Errors
    /// [`VimError`]. Nothing has changed then.
    pub fn add(&mut self, now: Timestamp, vnf: &Vnf) -> Result<Vec<Event>, VimError> {
        let id = &vnf.id;
        check_added(vnf).map_err(|reason| VimError::NotAddable { vnf: id.clone(), reason })?;
        if self.added().count() + self.removed.len() >= MOST_ADDED {
            return Err(VimError::TooMany);
        }
        if self.removed.iter().any(|group| group.vnf.id.as_str().eq_ignore_ascii_case(id.as_str())) {
            return Err(VimError::StillStopping(id.clone()));
        }
        let is_access_point = self.graph.radio_units().any(|(node, _)| AccessPoint::vnf(&node.id) == *id);
        // Their logs have their names, which not every file system distinguishes by case.
        let is_alike = |group: &Group| group.vnf.id.as_str().eq_ignore_ascii_case(id.as_str());
        if self.groups.iter().any(is_alike) || is_access_point {
            return Err(VimError::Taken(id.clone()));
        }
        for node in vnf.node.all() {
            self.check_room(id, vnf.cpus, vnf.memory_bytes, node)?;
        }
        let index = self.groups.partition_point(|group| group.vnf.id < *id);
        self.groups.insert(index, Group { is_added: true, ..Group::new(vnf) });
        let mut events = Vec::new();
        for place in 0..self.groups[index].slots.len() {
            let node = self.groups[index].slots[place].node.clone();
            self.launch(now, (index, place), node, &mut events);
        }
        self.groups[index].settle(now, &mut events);
        Ok(events)
    }

    /// Removes a VNF that was added. Starting instances stop at once, and serving ones when packets in flight to them have
    /// arrived. Their room is free at once, and the VNF's name when the last instance has stopped.
    ///
    /// # Errors
    /// [`VimError`]. Nothing has changed then.
    pub fn remove(&mut self, now: Timestamp, vnf: &VnfId) -> Result<Vec<Event>, VimError> {
        let index = self.index(vnf).ok_or_else(|| VimError::UnknownVnf(vnf.clone()))?;
        if !self.groups[index].is_added {
            return Err(VimError::NotAdded(vnf.clone()));
        }
        let mut group = self.groups.remove(index);
        let mut events = Vec::new();
        for slot in group.slots.drain(..) {
            if slot.current.is_none() && slot.next.is_none() {
                events.push(life(vnf, &slot.node, VnfState::Stopped, None));
            }
            group.draining.extend(slot.current.map(|instance| (now + LAST_PACKETS, instance)));
            if let Some(starting) = slot.next {
                self.engine.stop(starting.id);
                events.push(life(vnf, &starting.node, VnfState::Stopped, None));
            }
        }
        if !group.draining.is_empty() {
            self.removed.push(group);
        }
        Ok(events)
    }

    /// Returns the VNFs that were added, by name.
    pub fn added(&self) -> impl Iterator<Item = &Vnf> {
        self.groups.iter().filter(|group| group.is_added).map(|group| &group.vnf)
    }

    /// Returns the nodes of a VNF that was added, with those that it is moving to; `None` for all others.
    pub fn nodes_of_added(&self, vnf: &VnfId) -> Option<impl Iterator<Item = &NodeId>> {
        let group = self.group(vnf).filter(|group| group.is_added)?;
        let next = group.slots.iter().filter_map(|slot| Some(&slot.next.as_ref()?.node));
        Some(group.slots.iter().map(|slot| &slot.node).chain(next))
    }
}

#[cfg(test)]
mod tests;
