//! Compose files: the services of a stack of containers, as VNFs. Reads the keys that mean something here, and rejects all
//! others by name.

mod words;

use std::{
    path::{Component, Path, PathBuf},
    time::Duration,
};

use cotorra_graph::{Granted, Image, ListenPort, NodeId, Nodes, Program, Rights, Vnf, VnfId, Volume};

use self::words::{
    Bind, Capability, Command, Cpus, Environment, Memory, MountKind, PullPolicy, Restart, SameDevice, Source,
    Target,
};
use crate::{
    build::is_variable,
    image::Reference,
    yaml::{
        self, Diagnostics, Sink, Span,
        decode::{Decode, Either, Entry, Node, Spanned, Table, Value, record},
    },
};

/// Bytes of a compose file.
pub(crate) const MAX_FILE: usize = 1 << 20;
/// Services of a compose file.
const MOST_SERVICES: usize = 100;
/// Bytes of memory of a service without a limit: as of a VNF without `memory`.
const USUAL_MEMORY: u64 = 256_000_000;

record! {
    /// A compose file.
    FileRecord {
        /// Name of the stack; means nothing here.
        _name as "name": Option<String>,
        /// Version of the format; means nothing, as in compose.
        _version as "version": Option<String>,
        /// Its services by name.
        services: Spanned<Table<VnfId, ServiceRecord>>,
    }
}

record! {
    /// A service: a container.
    ServiceRecord {
        /// Reference of its image.
        image: Reference,
        /// Words inside the image. Without them: the image's own.
        command: Option<Command>,
        /// Variables: a list of `NAME` and `NAME=VALUE`, or a mapping.
        environment: Option<Environment>,
        /// Files and folders of the machine that it sees.
        volumes: Vec<Either<Bind, MountRecord>> = [],
        /// Devices of the machine that it may use.
        devices: Vec<SameDevice> = [],
        /// Ports at which it serves.
        ports: Vec<ListenPort> = [],
        /// CPUs that it takes.
        cpus: Option<Spanned<Cpus>>,
        /// Memory that it takes.
        mem_limit: Option<Spanned<Memory>>,
        /// Limits, in their other place.
        deploy: DeployRecord = {},
        /// When the engine pulls its image.
        pull_policy: PullPolicy = "missing",
        /// Capabilities of Linux over its node's network and its own threads.
        cap_add: Vec<Capability> = [],
        /// Whether it is started again when it ends, as cotorra does anyway.
        _restart as "restart": Option<Restart>,
        /// Whether the engine's init process is the container's first one.
        init: bool = false,
        /// Its node, and its times in virtual time.
        x_cotorra as "x-cotorra": OursRecord = {},
    }
}

record! {
    /// Keys of cotorra in a compose file.
    OursRecord {
        /// Node on which it starts. Without it: that of the compose file.
        node: Option<Spanned<NodeId>>,
        /// Time from its start until it serves, in virtual time.
        start_time: Duration = "0 s",
        /// Time from a request to its answer, in virtual time.
        processing_delay: Duration = "0 s",
    }
}

record! {
    /// Deployment of a service.
    DeployRecord {
        /// Its resources.
        resources: ResourcesRecord = {},
    }
}

record! {
    /// Resources of a service.
    ResourcesRecord {
        /// Their limits.
        limits: LimitsRecord = {},
    }
}

record! {
    /// Limits of a service.
    LimitsRecord {
        /// CPUs that it takes.
        cpus: Option<Spanned<Cpus>>,
        /// Memory that it takes.
        memory: Option<Spanned<Memory>>,
    }
}

record! {
    /// A volume in the long form.
    MountRecord {
        /// Its kind.
        kind as "type": MountKind,
        /// Path on the machine.
        source: Source,
        /// Path in the container.
        target: Target,
        /// Whether it is read-only.
        read_only: bool = false,
    }
}

/// Keys of compose that mean nothing here, and what to do instead.
const REJECTED: &[(&str, &str)] = &[
    ("<<", "write the keys out: an alias can only be a whole value"),
    (
        "build",
        "build the image first, such as `podman build -t mine .`, and name it: `image: localhost/mine`",
    ),
    ("cap_drop", "leave it out: `cap_add` names the capabilities"),
    ("cgroup_parent", "leave it out: `cpus` and `mem_limit` are its limits"),
    ("configs", "mount the file under `volumes`"),
    ("container_name", "leave it out: the name of the service is the VNF's"),
    ("cpu_count", "write `cpus`"),
    ("cpu_quota", "write `cpus`"),
    ("depends_on", "leave it out: all start at once, and each is ready once it listens at its `ports`"),
    ("dns", "leave it out: a container is in its node's network"),
    ("entrypoint", "build an image with this entry point"),
    ("env_file", "write the variables under `environment`"),
    ("expose", "write `ports`"),
    ("extends", "write the keys out"),
    ("extra_hosts", "leave it out: a container is in its node's network"),
    ("healthcheck", "leave it out: a container is ready once it listens at its `ports`"),
    ("hostname", "leave it out: the node has the name"),
    ("include", "name one file, and write the services out"),
    ("ipc", "leave it out"),
    ("labels", "leave it out"),
    ("links", "leave it out: containers reach each other over the network of the testbed"),
    ("logging", "leave it out: the run's folder has the output"),
    ("mem_reservation", "write `mem_limit`"),
    ("network_mode", "leave it out: a container is in its node's network"),
    ("networks", "leave it out: the nodes and links of the testbed are the network"),
    ("pid", "leave it out"),
    ("privileged", "leave it out: name what it needs under `devices` and `cap_add`"),
    ("profiles", "leave out the services that are not to run"),
    ("scale", "leave it out: only VNFs under `vnfs` have several instances"),
    ("secrets", "mount the file under `volumes`"),
    ("stdin_open", "leave it out: nobody types into a container"),
    ("tmpfs", "leave it out, or mount a folder under `volumes`"),
    ("tty", "leave it out: the output goes to the run's folder"),
    ("user", "build an image with this user"),
    ("working_dir", "build an image with this folder"),
];

/// Parses a compose file's text to VNFs. They start on `node`, unless `x-cotorra` names another. `folder` is that of the
/// compose file, from the testbed file's.
///
/// # Errors
/// Everything that is wrong, each in its place.
pub fn parse(source_name: &str, text: &str, folder: &Path, node: &NodeId) -> Result<Vec<Vnf>, Diagnostics> {
    parse_with(source_name, text, folder, node, |_, _, _| {})
}

/// As [`parse`]. `check` sees the name of each service, the node that it names, and reports what is wrong with them.
pub(crate) fn parse_with(
    source_name: &str,
    text: &str,
    folder: &Path,
    node: &NodeId,
    mut check: impl FnMut(&Spanned<VnfId>, Option<&Spanned<NodeId>>, &mut Sink),
) -> Result<Vec<Vnf>, Diagnostics> {
    let mut sink = Sink::default();
    let vnfs = read(text, &mut sink).and_then(|record| {
        let services = &record.services.value.0;
        if services.is_empty() || services.len() > MOST_SERVICES {
            sink.error(&record.services.span, format!("{} services", services.len()))
                .help(format!("write 1 to {MOST_SERVICES}"));
            return None;
        }
        let each = services.iter().map(|(id, service)| {
            check(id, service.x_cotorra.node.as_ref(), &mut sink);
            vnf(&id.value, service, folder, node, &mut sink)
        });
        let each: Vec<_> = each.collect();
        each.into_iter().collect()
    });
    match vnfs {
        Some(vnfs) if sink.is_empty() => Ok(vnfs),
        _ => Err(sink.finish(source_name, text)),
    }
}

fn read(text: &str, sink: &mut Sink) -> Option<FileRecord> {
    let mut root = yaml::parse(text, sink)?;
    if let Value::Mapping(entries) = &mut root.value {
        entries.retain(|entry| !entry.key.starts_with("x-"));
        let is_ours = |key: &str| matches!(key, "services" | "name" | "version");
        entries.retain(|entry| is_ours(&entry.key) || !is_rejected(entry, true, sink));
        let services = entries.iter_mut().find(|entry| entry.key == "services");
        for service in services.into_iter().flat_map(|services| values(&mut services.value)) {
            if let Value::Mapping(entries) = &mut service.value {
                entries.retain(|entry| !is_rejected(entry, false, sink));
            }
        }
    }
    interpolate(&mut root, sink);
    FileRecord::decode(&root, sink)
}

/// A volume's source in a compose file.
pub(crate) struct NamedSource {
    /// Its path, as written.
    pub source: String,
    /// The text that holds it.
    pub text: String,
    /// Place of the text.
    pub span: Span,
}

/// Returns the sources of all volumes in a compose file's text, as far as it can be read.
pub(crate) fn sources(text: &str) -> Vec<NamedSource> {
    let Some(root) = yaml::parse(text, &mut Sink::default()) else { return Vec::new() };
    let services = root.get("services").into_iter().flat_map(Node::items);
    let volumes = services.filter_map(|service| service.get("volumes")).flat_map(Node::items);
    let source = |volume: &Node| {
        let at = volume.get("source").unwrap_or(volume);
        let text = at.text()?;
        let end = if volume.get("source").is_some() { None } else { text.find(':') };
        let source = text[..end.unwrap_or(text.len())].to_owned();
        Some(NamedSource { source, text: text.to_owned(), span: at.span.clone() })
    };
    volumes.filter_map(source).collect()
}

/// Whether a key means nothing here, which the sink then knows.
fn is_rejected(entry: &Entry, at_the_top: bool, sink: &mut Sink) -> bool {
    let help = match entry.key.as_str() {
        "volumes" if at_the_top => {
            Some("leave it out: a volume is a folder of this machine, such as `./data:/data`")
        }
        key => REJECTED.iter().find(|(rejected, _)| *rejected == key).map(|(_, help)| *help),
    };
    if let Some(help) = help {
        sink.error(&entry.key_span, format!("`{}` means nothing here", entry.key)).help(help);
    }
    help.is_some()
}

/// The values of a mapping.
fn values(node: &mut Node) -> impl Iterator<Item = &mut Node> {
    let entries = match &mut node.value {
        Value::Mapping(entries) => entries.as_mut_slice(),
        _ => &mut [],
    };
    entries.iter_mut().map(|entry| &mut entry.value)
}

/// Reads `$$` as `$`, and rejects variables, whose values would come from wherever the file is read.
fn interpolate(node: &mut Node, sink: &mut Sink) {
    match &mut node.value {
        Value::Scalar { text, .. } if text.contains('$') => {
            let literal = text.replace("$$", "");
            if literal.contains('$') {
                sink.error(&node.span, format!("{} has a variable", node.describe())).help(
                    "write the value itself; `$$` is a `$`, and `environment: [NAME]` passes a variable on",
                );
            } else {
                *text = text.replace("$$", "$");
            }
        }
        Value::Scalar { .. } => {}
        Value::Sequence(items) => items.iter_mut().for_each(|item| interpolate(item, sink)),
        Value::Mapping(entries) => entries.iter_mut().for_each(|entry| interpolate(&mut entry.value, sink)),
    }
}

fn vnf(id: &VnfId, record: &ServiceRecord, folder: &Path, node: &NodeId, sink: &mut Sink) -> Option<Vnf> {
    let limits = &record.deploy.resources.limits;
    let cpus = one_of("CPUs", record.cpus.as_ref(), limits.cpus.as_ref(), sink);
    let memory = one_of("memory", record.mem_limit.as_ref(), limits.memory.as_ref(), sink);
    let volumes: Vec<_> = record.volumes.iter().map(Mount::of).collect();
    for (i, volume) in volumes.iter().enumerate() {
        if volumes[..i].iter().any(|before| before.target == volume.target) {
            sink.error(volume.span, format!("two volumes at `{}`", volume.target.display()))
                .help("give each a path of its own in the container");
        }
    }
    let environment = record.environment.as_ref().map_or(&[][..], |its| &its.0);
    let well: Vec<_> = environment.iter().map(|variable| is_variable(variable, sink)).collect();
    if !well.into_iter().all(|well| well) {
        return None;
    }
    let node = record.x_cotorra.node.as_ref().map_or(node, |node| &node.value).clone();
    let image = Image {
        reference: record.image.0.clone(),
        pull: record.pull_policy.0,
        volumes: volumes.iter().map(|volume| volume.from(folder)).collect(),
        devices: record.devices.iter().map(|device| device.0.clone()).collect(),
        ports: record.ports.clone(),
        init: record.init,
        start: record.x_cotorra.start_time,
        processing: record.x_cotorra.processing_delay,
    };
    let capabilities = record.cap_add.iter().map(|capability| capability.0).collect();
    Some(Vnf {
        id: id.clone(),
        program: Program::Command(
            record.command.as_ref().map(|command| command.0.clone()).unwrap_or_default(),
        ),
        cpus: cpus?.map_or(1.0, |cpus| cpus.0),
        memory_bytes: memory?.map_or(USUAL_MEMORY, |memory| memory.0),
        pinned_to: None,
        node: Nodes::from(node),
        env: environment.iter().map(|variable| variable.value.clone()).collect(),
        rights: Rights::Confined(Granted { capabilities, readable: Vec::new() }),
        keep: false,
        image: Some(Box::new(image)),
        cpu_limit: None,
        start: Duration::ZERO,
        computing: None,
        state: None,
    })
}

/// The limit that is given in one of two places; `None` for a mistake.
fn one_of<'a, T>(
    what: &str,
    short: Option<&'a Spanned<T>>,
    deployed: Option<&'a Spanned<T>>,
    sink: &mut Sink,
) -> Option<Option<&'a T>> {
    if let (Some(_), Some(deployed)) = (short, deployed) {
        sink.error(&deployed.span, format!("two limits of {what}")).help("keep one of them");
        return None;
    }
    Some(short.or(deployed).map(|limit| &limit.value))
}

/// A volume, and its place in the file.
struct Mount<'a> {
    source: &'a Path,
    target: &'a Path,
    writable: bool,
    span: &'a Span,
}

impl<'a> Mount<'a> {
    fn of(record: &'a Either<Bind, MountRecord>) -> Self {
        match record {
            Either::Short(Bind(Spanned { value: Volume { source, target, writable }, span })) => {
                Self { source, target, writable: *writable, span }
            }
            Either::Long(MountRecord { kind: MountKind::Bind, source, target, read_only }) => Self {
                source: &source.0,
                target: &target.0.value,
                writable: !read_only,
                span: &target.0.span,
            },
        }
    }

    /// The volume, whose source starts at the testbed file's folder.
    fn from(&self, folder: &Path) -> Volume {
        Volume { source: below(folder, self.source), target: self.target.to_owned(), writable: self.writable }
    }
}

/// Returns a path from a folder, without `.` in it.
fn below(folder: &Path, path: &Path) -> PathBuf {
    let all = folder.join(path);
    let path: PathBuf = all.components().filter(|part| *part != Component::CurDir).collect();
    if path.as_os_str().is_empty() { PathBuf::from(".") } else { path }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{LinuxCapability, Pull, Transport};
    use cotorra_graph_testing as base;
    use proptest::prelude::*;

    use super::*;

    fn edge() -> NodeId {
        NodeId::new("edge").unwrap()
    }

    fn vnfs(text: &str) -> Vec<Vnf> {
        parse("compose.yaml", text, Path::new("stack"), &edge()).unwrap_or_else(|wrong| panic!("{wrong}"))
    }

    #[test]
    fn every_supported_key_is_read() {
        let text = r#"
name: stack
version: "3.8"
x-common: &common [MODE=fast, "PRICE=5 $$", DISPLAY]
services:
  planner:
    image: ghcr.io/lab/planner:2
    command: python3 -m "plan ner" --x='a b' c\ d
    environment: *common
    volumes:
      - ./data:/data
      - ../maps:/maps:ro
      - { type: bind, source: /srv, target: /srv, read_only: true }
    devices: [/dev/ttyUSB0, "/dev/video0:/dev/video0", "/dev/dri:/dev/dri:rwm"]
    ports: [8080, "9000:9000/udp"]
    cpus: "1.5"
    mem_limit: 512m
    pull_policy: if_not_present
    cap_add: [NET_RAW, CAP_SYS_NICE]
    restart: unless-stopped
    init: true
    x-cotorra: { node: cloud, start_time: 2 s, processing_delay: 5 ms }
  detector:
    image: detector
    command: [detect, "$$HOME"]
    environment: { A: 1, B: "true", C: , D: "" }
    deploy: { resources: { limits: { cpus: 2, memory: 1gb } } }
    pull_policy: always
"#;
        let all = vnfs(text);
        let planner = &all[0];
        let volume = |source: &str, target: &str, writable| Volume {
            source: source.into(),
            target: target.into(),
            writable,
        };
        let image = Image {
            reference: "ghcr.io/lab/planner:2".to_owned(),
            pull: Pull::Missing,
            volumes: vec![
                volume("stack/data", "/data", true),
                volume("stack/../maps", "/maps", false),
                volume("/srv", "/srv", false),
            ],
            devices: ["/dev/ttyUSB0", "/dev/video0", "/dev/dri"].map(PathBuf::from).into(),
            ports: vec![
                ListenPort { port: 8080, transport: Transport::Tcp },
                ListenPort { port: 9000, transport: Transport::Udp },
            ],
            init: true,
            start: Duration::from_secs(2),
            processing: Duration::from_millis(5),
        };
        let words = ["python3", "-m", "plan ner", "--x=a b", "c d"].map(str::to_owned);
        let granted = Granted {
            capabilities: vec![LinuxCapability::NetRaw, LinuxCapability::SysNice],
            readable: Vec::new(),
        };
        let expected = Vnf {
            program: Program::Command(words.into()),
            cpus: 1.5,
            memory_bytes: 512 << 20,
            node: Nodes::from(NodeId::new("cloud").unwrap()),
            env: ["MODE=fast", "PRICE=5 $", "DISPLAY"].map(str::to_owned).into(),
            rights: Rights::Confined(granted),
            image: Some(Box::new(image)),
            ..base::vnf("planner", "server")
        };
        assert_eq!(*planner, expected);
        let detector = &all[1];
        assert_eq!(detector.program, Program::Command(vec!["detect".to_owned(), "$HOME".to_owned()]));
        assert_eq!(detector.env, ["A=1", "B=true", "C", "D="]);
        assert_eq!((detector.cpus, detector.memory_bytes), (2.0, 1 << 30));
        assert_eq!(*detector.node.first(), edge());
        assert_eq!(detector.image.as_ref().unwrap().pull, Pull::Always);
    }

    #[test]
    fn a_service_without_limits_takes_what_a_vnf_takes() {
        let vnf = &vnfs("services: { a: { image: x } }")[0];
        assert_eq!((vnf.cpus, vnf.memory_bytes), (1.0, 256_000_000));
        assert_eq!(vnf.program, Program::Command(Vec::new()));
    }

    #[test]
    fn more_services_than_the_bound_are_rejected() {
        let services: String = (0..=MOST_SERVICES).map(|i| format!("  s{i}: {{ image: x }}\n")).collect();
        let wrong = parse("x", &format!("services:\n{services}"), Path::new(""), &edge()).unwrap_err();
        assert_eq!(wrong.list[0].message, "101 services");
    }

    #[test]
    fn volumes_start_from_the_compose_files_folder() {
        let below = |folder: &str, path: &str| below(Path::new(folder), Path::new(path));
        assert_eq!(below("", "./data").as_os_str(), "data");
        assert_eq!(below("a/b", "./data").as_os_str(), "a/b/data");
        assert_eq!(below("a", ".").as_os_str(), "a");
        assert_eq!(below("", ".").as_os_str(), ".");
    }

    proptest! {
        /// A damaged file is accepted, or rejected with a place and a correction.
        #[test]
        fn damaged_files_never_panic(at in 0_usize..400, cut in 0_usize..30, put in "\\PC{0,8}") {
            let text = "x-a: &a { A: \"1\" }\nservices:\n  a:\n    image: x:1\n    command: a 'b c' \\\\d\n    \
                        environment: *a\n    volumes: [./a:/b:ro, { type: bind, source: a, target: /c }]\n    \
                        devices: [/dev/a:/dev/a]\n    ports: [80:80/udp]\n    cpus: 0.5\n    mem_limit: 1g\n    \
                        cap_add: [NET_RAW]\n    x-cotorra: { node: b }\n";
            let start = text.floor_char_boundary(at % text.len());
            let end = text.floor_char_boundary((start + cut).min(text.len()));
            let spoilt = [&text[..start], &put, &text[end..]].concat();
            _ = sources(&spoilt);
            if let Err(wrong) = parse("x", &spoilt, Path::new(""), &edge()) {
                prop_assert!(wrong.list.iter().all(|d| wrong.source_text.get(d.span.clone()).is_some()));
                prop_assert!(wrong.list.iter().all(|d| d.help.is_some()), "{}", wrong);
            }
        }
    }
}
