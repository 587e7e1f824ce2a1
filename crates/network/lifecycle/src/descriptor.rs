//! FDU descriptors of Eclipse fog05 v0.2, read as VNFs.

use std::fmt::Write as _;

use cotorra_graph::{Image, NodeId, Program, Rights, Service, Vnf, VnfId};
use serde::Deserialize;
use serde_json::{Map, Value, json};

/// Longest descriptor, bytes.
pub const LONGEST_DESCRIPTOR: usize = 64 * 1024;

/// Reason for which a descriptor is rejected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DescriptorError {
    /// It has too many bytes.
    #[error("it has {0} bytes, more than {LONGEST_DESCRIPTOR}")]
    TooLong(usize),
    /// It does not describe what it should.
    #[error("it does not describe {0} of fog05 v0.2: {1}")]
    Unreadable(&'static str, String),
    /// A hypervisor other than BARE and DOCKER.
    #[error("`hypervisor` is {0}: only BARE and DOCKER can run here")]
    Hypervisor(String),
    /// A key that cannot be honoured.
    #[error("`{key}` cannot be honoured here: {reason}")]
    NotHonoured { key: &'static str, reason: &'static str },
    /// A value that is out of its range.
    #[error("`{key}` is {value}, which is not {wanted}")]
    Value { key: &'static str, value: String, wanted: &'static str },
    /// A missing key.
    #[error("`{key}` is missing, which {hypervisor} needs")]
    Missing { key: &'static str, hypervisor: &'static str },
}

/// The keys of a descriptor. Those that must say nothing are values of any type.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    id: String,
    #[serde(default)]
    name: Option<String>,
    #[serde(default)]
    uuid: Option<String>,
    #[serde(default, rename = "description")]
    _description: Option<String>,
    computation_requirements: Requirements,
    #[serde(default)]
    image: Option<ImageKeys>,
    #[serde(default)]
    command: Option<CommandKeys>,
    hypervisor: String,
    migration_kind: String,
    #[serde(default)]
    storage: Value,
    #[serde(default)]
    interfaces: Option<Vec<Interface>>,
    #[serde(default)]
    io_ports: Value,
    #[serde(default)]
    connection_points: Option<Vec<ConnectionPoint>>,
    #[serde(default)]
    depends_on: Value,
    #[serde(default)]
    configuration: Value,
    #[serde(default)]
    geographical_requirements: Value,
    #[serde(default)]
    energy_requirements: Value,
    #[serde(default)]
    hypervisor_specific: Value,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Requirements {
    #[serde(default, rename = "uuid")]
    _uuid: Value,
    #[serde(default, rename = "name")]
    _name: Value,
    #[serde(default, rename = "cpu_arch")]
    _cpu_arch: Value,
    #[serde(default, rename = "cpu_min_freq")]
    _cpu_min_freq: Value,
    cpu_min_count: f64,
    ram_size_mb: f64,
    #[serde(default, rename = "storage_size_gb")]
    _storage_size_gb: Value,
    #[serde(default)]
    gpu_min_count: Value,
    #[serde(default)]
    fpga_min_count: Value,
    #[serde(default)]
    duty_cycle: Value,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ImageKeys {
    #[serde(default, rename = "uuid")]
    _uuid: Option<String>,
    #[serde(default, rename = "name")]
    _name: Option<String>,
    uri: String,
    #[serde(default)]
    checksum: Value,
    #[serde(default)]
    format: Value,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CommandKeys {
    binary: String,
    #[serde(default)]
    args: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Interface {
    name: String,
    #[serde(default)]
    is_mgmt: Value,
    if_type: String,
    #[serde(default)]
    mac_address: Value,
    virtual_interface: VirtualInterface,
    #[serde(default)]
    cp_id: Option<String>,
    #[serde(default)]
    ext_cp_id: Value,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct VirtualInterface {
    intf_type: String,
    #[serde(default, rename = "vpci")]
    _vpci: Value,
    #[serde(default, rename = "bandwidth")]
    _bandwidth: Value,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ConnectionPoint {
    id: String,
    #[serde(default, rename = "uuid")]
    _uuid: Value,
    #[serde(default, rename = "name")]
    _name: Value,
    #[serde(default, rename = "short_name")]
    _short_name: Value,
    /// Only `VPORT` exists.
    #[serde(default, rename = "cp_type")]
    _cp_type: Value,
    #[serde(default)]
    port_security_enabled: Value,
    #[serde(default)]
    vld_ref: Option<String>,
}

/// Checks the interface of a VNF, which is that of its node. Returns the network that it names.
fn network(interfaces: &[Interface], points: &[ConnectionPoint]) -> Result<Option<String>, DescriptorError> {
    let one = "a VNF has one interface, which is that of its node";
    let interface = match interfaces {
        [] => None,
        [interface] => Some(interface),
        _ => return Err(DescriptorError::NotHonoured { key: "interfaces", reason: one }),
    };
    if let Some(interface) = interface {
        let kind = &interface.virtual_interface.intf_type;
        for (key, value, allowed, wanted) in [
            ("interfaces.name", &interface.name, &["eth0"][..], "`eth0`, as a node's interface is called"),
            (
                "interfaces.if_type",
                &interface.if_type,
                &["INTERNAL", "EXTERNAL"],
                "INTERNAL or EXTERNAL: a VNF has no radio of its own",
            ),
            (
                "virtual_interface.intf_type",
                kind,
                &["VIRTIO", "PARAVIRT"],
                "VIRTIO or PARAVIRT: it is no interface of the machine",
            ),
        ] {
            if !allowed.contains(&value.as_str()) {
                return Err(DescriptorError::Value { key, value: shown(value), wanted });
            }
        }
        for (key, value, reason) in [
            ("interfaces.is_mgmt", &interface.is_mgmt, "there is no network for management"),
            ("interfaces.mac_address", &interface.mac_address, "a node has its address already"),
            ("interfaces.ext_cp_id", &interface.ext_cp_id, "an FDU is no part of an entity"),
        ] {
            if !says_nothing(value) {
                return Err(DescriptorError::NotHonoured { key, reason });
            }
        }
    }
    let named = interface.and_then(|interface| interface.cp_id.as_deref()).filter(|id| !id.is_empty());
    let point = match (named, points) {
        (None, []) => return Ok(None),
        (Some(named), [point]) if point.id == named => point,
        (Some(named), []) => {
            let wanted = "the `id` of a connection point";
            return Err(DescriptorError::Value { key: "interfaces.cp_id", value: shown(named), wanted });
        }
        _ => {
            let reason = "the only one is that which `cp_id` of the interface names";
            return Err(DescriptorError::NotHonoured { key: "connection_points", reason });
        }
    };
    if !says_nothing(&point.port_security_enabled) {
        let reason = "nothing checks the addresses that a VNF sends from";
        return Err(DescriptorError::NotHonoured { key: "port_security_enabled", reason });
    }
    let network = point.vld_ref.clone().filter(|network| !network.is_empty());
    network.as_deref().map_or(Ok(()), |network| check_uuid("vld_ref", network))?;
    Ok(network)
}

/// An application as its descriptor gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct Descriptor {
    /// Its own name.
    pub id: String,
    /// Its name for people; its own name if it has none.
    pub name: String,
    /// Its identifier in a catalog, if it brings one.
    pub uuid: Option<String>,
    /// The virtual network that its interface names.
    pub network: Option<String>,
    /// The keys as they were given.
    pub keys: Map<String, Value>,
    words: Vec<String>,
    image: Option<String>,
    cpus: f64,
    memory_bytes: u64,
}

impl Descriptor {
    /// Reads a descriptor's text.
    ///
    /// # Errors
    /// [`DescriptorError`].
    pub fn read(text: &[u8]) -> Result<Self, DescriptorError> {
        if text.len() > LONGEST_DESCRIPTOR {
            return Err(DescriptorError::TooLong(text.len()));
        }
        let unreadable = |error: serde_json::Error| DescriptorError::Unreadable("an FDU", error.to_string());
        let keys: Map<String, Value> = serde_json::from_slice(text).map_err(unreadable)?;
        let read: Keys = serde_json::from_slice(text).map_err(unreadable)?;
        Self::of(read, keys)
    }

    fn of(read: Keys, keys: Map<String, Value>) -> Result<Self, DescriptorError> {
        let Requirements { cpu_min_count, ram_size_mb, gpu_min_count, fpga_min_count, duty_cycle, .. } =
            read.computation_requirements;
        let network =
            network(&read.interfaces.unwrap_or_default(), &read.connection_points.unwrap_or_default())?;
        let devices = "a VNF that is added has no devices";
        for (key, value, reason) in [
            ("storage", &read.storage, "a VNF has no disks of its own"),
            ("io_ports", &read.io_ports, devices),
            ("depends_on", &read.depends_on, "VNFs start independently of each other"),
            ("configuration", &read.configuration, "put it into the image or the command"),
            ("geographical_requirements", &read.geographical_requirements, "name the node instead"),
            ("energy_requirements", &read.energy_requirements, "nodes have no energy"),
            ("hypervisor_specific", &read.hypervisor_specific, "a VNF has no settings of hypervisors"),
            ("gpu_min_count", &gpu_min_count, devices),
            ("fpga_min_count", &fpga_min_count, devices),
            ("duty_cycle", &duty_cycle, "a VNF runs all the time"),
        ] {
            if !says_nothing(value) {
                return Err(DescriptorError::NotHonoured { key, reason });
            }
        }
        if read.migration_kind != "COLD" {
            let (key, value) = ("migration_kind", shown(&read.migration_kind));
            return Err(DescriptorError::Value { key, value, wanted: "COLD: a move starts a new instance" });
        }
        check_name("id", &read.id)?;
        check_name("name", read.name.as_ref().unwrap_or(&read.id))?;
        read.uuid.as_deref().map_or(Ok(()), |uuid| check_uuid("uuid", uuid))?;
        for (key, value, most) in
            [("cpu_min_count", cpu_min_count, 1024.0), ("ram_size_mb", ram_size_mb, 1e8)]
        {
            if !(value > 0.0 && value <= most) {
                let wanted = "a number above 0, up to 1024 CPUs or 100 TB";
                return Err(DescriptorError::Value { key, value: value.to_string(), wanted });
            }
        }
        let words =
            read.command.map_or_else(Vec::new, |command| [vec![command.binary], command.args].concat());
        let image = match (read.hypervisor.as_str(), read.image) {
            ("DOCKER", Some(image)) => {
                let more = [("image.checksum", &image.checksum), ("image.format", &image.format)];
                if let Some((key, _)) = more.into_iter().find(|(_, value)| !says_nothing(value)) {
                    let reason = "name the image by its digest, as in `name@sha256:…`";
                    return Err(DescriptorError::NotHonoured { key, reason });
                }
                Some(image.uri.strip_prefix("docker://").map(str::to_owned).unwrap_or(image.uri))
            }
            ("DOCKER", None) => return Err(DescriptorError::Missing { key: "image", hypervisor: "DOCKER" }),
            ("BARE", Some(_)) => {
                let reason = "a BARE command is a program of the machine";
                return Err(DescriptorError::NotHonoured { key: "image", reason });
            }
            ("BARE", None) if words.is_empty() => {
                return Err(DescriptorError::Missing { key: "command", hypervisor: "BARE" });
            }
            ("BARE", None) => None,
            (other, _) => return Err(DescriptorError::Hypervisor(shown(other))),
        };
        Ok(Self {
            name: read.name.unwrap_or_else(|| read.id.clone()),
            id: read.id,
            uuid: read.uuid,
            network,
            keys,
            words,
            image,
            cpus: cpu_min_count,
            memory_bytes: (ram_size_mb * 1e6).round() as u64,
        })
    }

    /// Describes a service's VNF. The catalog has it under the VNF's name. A bundled program has no command.
    pub(crate) fn of_service(service: &Service, vnf: &Vnf) -> Self {
        let name = vnf.id.to_string();
        let (words, what) = match &vnf.program {
            Program::RobotDriver => (&[][..], "the robot's driver"),
            Program::Navigation => (&[][..], "the bundled navigation"),
            Program::Localization => (&[][..], "the bundled localization"),
            Program::RosNavigation => (&[][..], "the bundled navigation in ROS"),
            Program::PolicyServer(_) => (&[][..], "the bundled policy server"),
            Program::Command(words) | Program::Host(words) => (&words[..], "a VNF"),
        };
        let mut keys = json!({
            "id": name, "name": name, "uuid": name,
            "description": format!("{what} of the service {}", service.id),
            "computation_requirements": { "cpu_min_count": vnf.cpus, "ram_size_mb": vnf.memory_bytes as f64 / 1e6 },
            "hypervisor": if vnf.image.is_some() { "DOCKER" } else { "BARE" }, "migration_kind": "COLD",
            "storage": [], "interfaces": [], "io_ports": [], "connection_points": [], "depends_on": [],
        });
        if let [binary, args @ ..] = words {
            keys["command"] = json!({ "binary": binary, "args": args });
        }
        if let Some(image) = &vnf.image {
            keys["image"] = json!({ "uri": image.reference });
        }
        let Value::Object(keys) = keys else { unreachable!("it is an object") };
        Self {
            id: name.clone(),
            uuid: Some(name.clone()),
            name,
            network: None,
            keys,
            words: words.to_vec(),
            image: vnf.image.as_ref().map(|image| image.reference.clone()),
            cpus: vnf.cpus,
            memory_bytes: vnf.memory_bytes,
        }
    }

    /// Returns the VNF of an instance.
    pub fn vnf(&self, id: VnfId, node: NodeId, env: Vec<String>) -> Vnf {
        let image = |reference: &String| Box::new(Image { reference: reference.clone(), ..Image::default() });
        Vnf {
            id,
            program: Program::Command(self.words.clone()),
            cpus: self.cpus,
            memory_bytes: self.memory_bytes,
            pinned_to: None,
            node: node.into(),
            env,
            rights: Rights::default(),
            keep: false,
            image: self.image.as_ref().map(image),
            cpu_limit: None,
            start: Default::default(),
            computing: None,
            state: None,
        }
    }

    /// Returns the CPUs and the bytes that an instance takes.
    pub fn needs(&self) -> (f64, u64) {
        (self.cpus, self.memory_bytes)
    }

    /// Returns the name of a VNF: the application's, as far as a VNF can have it, and a number.
    pub(crate) fn vnf_name(&self, number: u64) -> VnfId {
        let is_fit = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        let name: String = self.id.chars().filter(|c| is_fit(*c)).take(40).collect();
        let name = name.trim_start_matches(|c: char| !c.is_ascii_alphanumeric());
        let name = if name.is_empty() { "fdu" } else { name };
        VnfId::new(&format!("{name}-{number}")).expect("it begins with a letter or digit, and is short")
    }

    /// Returns the VNF as YAML for the `vnfs:` of a testbed file.
    ///
    /// # Errors
    /// [`DescriptorError`] if its own name cannot be a VNF's.
    pub fn yaml(&self, node: Option<&NodeId>) -> Result<String, DescriptorError> {
        let wanted = "the name of a VNF: letters, digits, `_`, `-`, `.` and `~`";
        let invalid = |_| DescriptorError::Value { key: "id", value: shown(&self.id), wanted };
        let id = VnfId::new(&self.id).map_err(invalid)?;
        let mut yaml = format!("{id}:\n");
        let mut line = |key: &str, value: String| {
            writeln!(yaml, "  {key}: {value}").expect("a string takes all");
        };
        if let Some(image) = &self.image {
            line("image", Value::from(image.as_str()).to_string());
        }
        if !self.words.is_empty() {
            line("command", Value::from(self.words.as_slice()).to_string());
        }
        if let Some(node) = node {
            line("node", node.to_string());
        }
        line("cpus", self.cpus.to_string());
        line("memory", format!("{} MB", self.memory_bytes as f64 / 1e6));
        Ok(yaml)
    }
}

/// Reads the variables of a start: `NAME=VALUE,NAME2=VALUE2`. The empty text has none.
///
/// # Errors
/// The part that is not a variable.
pub fn variables(text: &str) -> Result<Vec<String>, String> {
    let parts = text.split(',').map(str::trim).filter(|part| !part.is_empty());
    let variable = |part: &str| {
        let has_name = part.split_once('=').is_some_and(|(name, _)| !name.is_empty());
        if has_name { Ok(part.to_owned()) } else { Err(shown(part)) }
    };
    parts.map(variable).collect()
}

/// Whether a value is absent, or says nothing.
pub(crate) fn says_nothing(value: &Value) -> bool {
    match value {
        Value::Null | Value::Bool(false) => true,
        Value::Bool(true) => false,
        Value::Number(number) => number.as_f64() == Some(0.0),
        Value::String(text) => text.is_empty(),
        Value::Array(all) => all.is_empty(),
        Value::Object(all) => all.values().all(says_nothing),
    }
}

/// Rejects a text that cannot identify an entry of a catalog in a path.
pub(crate) fn check_uuid(key: &'static str, text: &str) -> Result<(), DescriptorError> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if (1..=64).contains(&text.len()) && text.chars().all(is_plain) {
        return Ok(());
    }
    let wanted = "1 to 64 letters, digits, `-` or `_`";
    Err(DescriptorError::Value { key, value: shown(text), wanted })
}

/// Rejects a name of an unfit length.
pub(crate) fn check_name(key: &'static str, text: &str) -> Result<(), DescriptorError> {
    if (1..=128).contains(&text.len()) {
        return Ok(());
    }
    Err(DescriptorError::Value { key, value: shown(text), wanted: "1 to 128 bytes long" })
}

/// Returns the beginning of a text, for messages.
pub(crate) fn shown(text: &str) -> String {
    format!("`{}`", text.chars().take(64).collect::<String>())
}

#[cfg(test)]
mod tests;
