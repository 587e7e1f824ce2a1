//! Words about containers that testbed files and compose files share: references of images, volumes, devices and ports.
//! Decodes them, and rejects what an engine would take for something else.

use std::path::{Component, Path, PathBuf};

use cotorra_graph::{ListenPort, Transport, Volume};
use serde_json::{Value as Json, json};

use crate::yaml::{
    Sink,
    decode::{Decode, Node, expected},
};

/// A reference of an image, such as `ghcr.io/owner/name:tag` or `ros@sha256:…`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Reference(pub String);

/// Characters of an image's name, without tag and digest.
const LONGEST_NAME: usize = 255;
/// Characters of a tag.
const LONGEST_TAG: usize = 128;
/// Characters of a digest: twice those of SHA-512, with the name of the algorithm.
const LONGEST_DIGEST: usize = 256;

impl Decode for Reference {
    fn schema() -> Json {
        json!({ "type": "string", "minLength": 1, "examples": ["ros:jazzy"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let help = "write it like `ros:jazzy`, `ghcr.io/owner/name:tag` or `name@sha256:…`, in small letters before the tag";
        let Some(text) = node.text() else {
            expected(node, "the reference of an image", help, sink);
            return None;
        };
        if !is_reference(text) {
            sink.error(&node.span, format!("{} is not the reference of an image", node.describe()))
                .help(help);
            return None;
        }
        Some(Self(text.to_owned()))
    }
}

/// Whether a text follows the grammar of references that registries and engines share
/// (<https://pkg.go.dev/github.com/distribution/reference>).
fn is_reference(text: &str) -> bool {
    let (rest, digest) = match text.split_once('@') {
        Some((rest, digest)) => (rest, Some(digest)),
        None => (text, None),
    };
    // A colon before the last `/` is that of a port.
    let (name, tag) = match rest.rsplit_once(':') {
        Some((name, tag)) if !tag.contains('/') => (name, Some(tag)),
        _ => (rest, None),
    };
    name.len() <= LONGEST_NAME && is_name(name) && tag.is_none_or(is_tag) && digest.is_none_or(is_digest)
}

fn is_name(name: &str) -> bool {
    let path = match name.split_once('/') {
        Some((first, path)) if is_domain(first) => path,
        _ => name,
    };
    path.split('/').all(is_path_component)
}

/// Whether the first part of a name is a registry: by the grammar, and apart from the other parts.
fn is_domain(text: &str) -> bool {
    let (host, port) = match text.rsplit_once(':') {
        Some((host, port)) if !port.contains(']') => (host, Some(port)),
        _ => (text, None),
    };
    let is_port = |port: &str| port.parse::<u16>().is_ok() && port.bytes().all(|b| b.is_ascii_digit());
    let is_host = |label: &str| {
        !label.is_empty()
            && !label.starts_with('-')
            && !label.ends_with('-')
            && label.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-')
    };
    let is_v6 = host
        .strip_prefix('[')
        .and_then(|host| host.strip_suffix(']'))
        .is_some_and(|host| host.parse::<std::net::Ipv6Addr>().is_ok());
    let is_apart = text.contains(['.', ':']) || text == "localhost";
    is_apart && (is_v6 || host.split('.').all(is_host)) && port.is_none_or(is_port)
}

/// Whether a part of a name has small letters and digits, with `.`, `_`, `__` or dashes between them.
fn is_path_component(text: &str) -> bool {
    let is_inner = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit();
    let bytes = text.as_bytes();
    let (Some(&first), Some(&last)) = (bytes.first(), bytes.last()) else { return false };
    let separators = text.split(|c: char| c.is_ascii_lowercase() || c.is_ascii_digit());
    is_inner(first)
        && is_inner(last)
        && separators
            .into_iter()
            .all(|separator| matches!(separator, "." | "_" | "__") || separator.bytes().all(|b| b == b'-'))
}

fn is_tag(tag: &str) -> bool {
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '.' | '-');
    (1..=LONGEST_TAG).contains(&tag.len()) && tag.chars().all(fits) && !tag.starts_with(['.', '-'])
}

fn is_digest(digest: &str) -> bool {
    let Some((algorithm, hex)) = digest.split_once(':') else { return false };
    let is_part = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic()) && part.bytes().all(|b| b.is_ascii_alphanumeric())
    };
    digest.len() <= LONGEST_DIGEST
        && algorithm.split(['+', '.', '-', '_']).all(is_part)
        && hex.len() >= 32
        && hex.bytes().all(|b| b.is_ascii_hexdigit())
}

/// Short form of a volume.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Dialect {
    /// That of a testbed file: each source is a path, read-only without a word.
    Testbed,
    /// That of a compose file: a source without `/` is a named volume, writable without a word.
    Compose,
}

/// Reads `SOURCE:TARGET`, or `SOURCE:TARGET:ro` and `SOURCE:TARGET:rw`.
pub(crate) fn volume(node: &Node, dialect: Dialect, sink: &mut Sink) -> Option<Volume> {
    let help = match dialect {
        Dialect::Testbed => "write `SOURCE:TARGET`, such as `data:/data`; `data:/data:rw` is writable",
        Dialect::Compose => "write `./data:/data`; `./data:/data:ro` is read-only",
    };
    let parts: Vec<_> = node.text().unwrap_or_default().split(':').collect();
    let (source, target, writable) = match parts[..] {
        [source, target] => (source, target, dialect == Dialect::Compose),
        [source, target, "ro"] => (source, target, false),
        [source, target, "rw"] => (source, target, true),
        _ => {
            expected(node, "a volume", help, sink);
            return None;
        }
    };
    let source = source_path(source, node, dialect, sink);
    let target = target_path(target, node, sink);
    Some(Volume { source: source?, target: target?, writable })
}

/// Reads a volume's path on the machine.
pub(crate) fn source_path(text: &str, node: &Node, dialect: Dialect, sink: &mut Sink) -> Option<PathBuf> {
    let is_path = text.contains('/') || matches!(text, "." | "..");
    let (message, help) = if text.is_empty() {
        ("a volume without a source".to_owned(), "name a file or folder of this machine")
    } else if text.starts_with('~') {
        (
            format!("`{text}` is not a path here"),
            "write the home folder in full: nothing takes the place of `~`",
        )
    } else if dialect == Dialect::Compose && !is_path {
        (format!("`{text}` is a named volume"), "name a folder of this machine, such as `./data:/data`")
    } else if !is_plain(text) {
        (
            format!("{} has letters that no volume can have", node.describe()),
            "leave out control characters, `:` and `,`",
        )
    } else {
        return Some(PathBuf::from(text));
    };
    sink.error(&node.span, message).help(help);
    None
}

/// Reads a volume's path in a container.
pub(crate) fn target_path(text: &str, node: &Node, sink: &mut Sink) -> Option<PathBuf> {
    let path = Path::new(text);
    let is_absolute = path.is_absolute() && !path.components().any(|part| part == Component::ParentDir);
    if !is_absolute || path == Path::new("/") || !is_plain(text) {
        sink.error(&node.span, format!("`{text}` is not a path in a container"))
            .help("write an absolute path below `/`, such as `/data`");
        return None;
    }
    Some(path.to_owned())
}

/// Whether an engine takes a path for one word: its options divide words by `:` and `,`.
fn is_plain(path: &str) -> bool {
    !path.contains(|c: char| c.is_control() || matches!(c, ':' | ','))
}

impl Decode for Volume {
    fn schema() -> Json {
        let pattern = "^[^:,~][^:,]*:/[^:,]+(:(ro|rw))?$";
        json!({ "type": "string", "pattern": pattern, "examples": ["data:/data"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        volume(node, Dialect::Testbed, sink)
    }
}

/// A device of the machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Device(pub PathBuf);

impl Device {
    /// Whether a text is the path of a device.
    pub fn is_path(text: &str) -> bool {
        let below = Path::new(text).strip_prefix("/dev").ok();
        let fits = |below: &Path| {
            let parts = || below.components();
            parts().next().is_some() && parts().all(|part| matches!(part, Component::Normal(_)))
        };
        below.is_some_and(fits) && is_plain(text)
    }

    /// Reads a path; reports another text.
    pub fn read(text: &str, node: &Node, sink: &mut Sink) -> Option<Self> {
        if !Self::is_path(text) {
            sink.error(&node.span, format!("{} is not a device", node.describe()))
                .help("write its path under `/dev`, without `:` and `,`, such as `/dev/ttyUSB0`");
            return None;
        }
        Some(Self(PathBuf::from(text)))
    }
}

impl Decode for Device {
    fn schema() -> Json {
        json!({ "type": "string", "pattern": "^/dev/[^:,]+$", "examples": ["/dev/ttyUSB0"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        Self::read(node.text().unwrap_or_default(), node, sink)
    }
}

impl Decode for ListenPort {
    fn schema() -> Json {
        json!({
            "anyOf": [
                { "type": "integer", "minimum": 1, "maximum": u16::MAX },
                { "type": "string", "pattern": "^[0-9]{1,5}(:[0-9]{1,5})?(/(tcp|udp))?$" },
            ],
            "examples": [8080],
        })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let text = node.text().unwrap_or_default();
        let (ports, transport) = text.split_once('/').unwrap_or((text, "tcp"));
        let transport = match transport {
            "tcp" => Some(Transport::Tcp),
            "udp" => Some(Transport::Udp),
            _ => None,
        };
        let number = |text: &str| text.parse().ok().filter(|port: &u16| *port > 0 && !text.starts_with('+'));
        let (host, container) = ports.split_once(':').unwrap_or((ports, ports));
        match (number(host), number(container), transport) {
            (Some(host), Some(port), Some(transport)) if host == port => Some(Self { port, transport }),
            (Some(_), Some(port), Some(_)) => {
                sink.error(&node.span, format!("{} leads from one port to another", node.describe())).help(
                    format!(
                        "write `{port}`: a container is in its node's network, so its ports are the node's"
                    ),
                );
                None
            }
            _ => {
                expected(node, "a port", "write it like `8080`, `8080/tcp` or `9000/udp`", sink);
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read<T: Decode>(text: &str) -> Option<T> {
        let node = Node::from_json(&Json::String(text.to_owned()));
        let mut sink = Sink::default();
        let value = T::decode(&node, &mut sink);
        assert_eq!(value.is_some(), sink.is_empty(), "{text}");
        value
    }

    #[test]
    fn references_follow_the_grammar_of_registries() {
        let hex = "0123456789abcdef".repeat(4);
        for text in [
            "ros",
            "ros:jazzy",
            "library/ros",
            "docker.io/library/ros:jazzy-ros-base",
            "localhost/mine",
            "localhost:5000/mine:1.0",
            "127.0.0.1:5000/mine",
            "[::1]:5000/mine",
            "ghcr.io/owner/name_of__it/x-y:v1.2.3_4",
            "a---b",
            &format!("ros@sha256:{hex}"),
            &format!("ros:jazzy@sha256:{hex}"),
            &format!("sha256:{hex}"),
        ] {
            assert_eq!(read(text), Some(Reference(text.to_owned())));
        }
        let long = |n| "a".repeat(n);
        for text in [
            "Ros",
            "--privileged",
            "ros:",
            ":jazzy",
            "ros:-x",
            "ros:a b",
            "ros jazzy",
            "a//b",
            "/a",
            "a/",
            "a..b",
            "a.",
            "a___b",
            "docker://ros",
            "oci-archive:/tmp/x",
            "ros@sha256:12",
            "ros@",
            "host:99999/x",
            "ros:jazzy:x",
            "",
            "röß",
            &long(256),
            &format!("ros:{}", long(129)),
        ] {
            assert_eq!(read::<Reference>(text), None, "{text}");
        }
    }

    #[test]
    fn volumes_are_read_only_unless_they_say_otherwise() {
        let volume = |source: &str, target: &str, writable| {
            Some(Volume { source: source.into(), target: target.into(), writable })
        };
        assert_eq!(read("data:/data"), volume("data", "/data", false));
        assert_eq!(read("../a/b.yaml:/etc/b.yaml:ro"), volume("../a/b.yaml", "/etc/b.yaml", false));
        assert_eq!(read("/srv:/srv:rw"), volume("/srv", "/srv", true));
        for text in [
            "data",
            "data:",
            ":/data",
            "data:data",
            "data:/",
            "data:/a/../b",
            "~/x:/x",
            "a:/b:z",
            "a:/b:ro:x",
            "a,b:/c",
        ] {
            assert_eq!(read::<Volume>(text), None, "{text}");
        }
    }

    #[test]
    fn volumes_of_compose_files_are_writable_and_have_paths() {
        let read = |text: &str| {
            let node = Node::from_json(&Json::String(text.to_owned()));
            volume(&node, Dialect::Compose, &mut Sink::default())
        };
        assert!(read("./data:/data").unwrap().writable);
        assert!(!read("./data:/data:ro").unwrap().writable);
        assert_eq!(read("data:/data"), None);
    }

    #[test]
    fn devices_are_under_dev() {
        assert_eq!(read("/dev/serial/by-id/usb-1"), Some(Device("/dev/serial/by-id/usb-1".into())));
        for text in
            ["/dev", "/dev/", "/dev/../etc/shadow", "ttyUSB0", "/etc/dev", "/dev/a:/dev/b", "/devices/x"]
        {
            assert_eq!(read::<Device>(text), None, "{text}");
        }
    }

    #[test]
    fn ports_are_those_of_the_node() {
        let port = |port, transport| Some(ListenPort { port, transport });
        assert_eq!(read("8080"), port(8080, Transport::Tcp));
        assert_eq!(read("8080/tcp"), port(8080, Transport::Tcp));
        assert_eq!(read("9000/udp"), port(9000, Transport::Udp));
        assert_eq!(read("53:53/udp"), port(53, Transport::Udp));
        for text in
            ["0", "65536", "80:8080", "80/sctp", "8000-8010", "127.0.0.1:80:80", "+80", "x", "80/", ""]
        {
            assert_eq!(read::<ListenPort>(text), None, "{text}");
        }
    }

    proptest! {
        /// An accepted name cannot be taken for an option, and has no more than one word.
        #[test]
        fn other_texts_are_no_references(text in "\\PC{0,20}|[a-zA-Z0-9./:@_-]{1,30}") {
            if let Some(Reference(text)) = read(&text) {
                prop_assert!(text.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '['), "{text}");
                prop_assert!(!text.contains(char::is_whitespace));
            }
        }

        #[test]
        fn accepted_paths_stay_one_word(text in "\\PC{0,20}|[a-z/.:]{1,20}") {
            if let Some(volume) = read::<Volume>(&text) {
                prop_assert!(volume.target.is_absolute());
                prop_assert!(!volume.target.to_str().unwrap().contains([':', ',']));
            }
            if let Some(Device(path)) = read(&text) {
                prop_assert!(path.starts_with("/dev"));
            }
        }

        #[test]
        fn ports_survive_formatting(port in 1_u16.., udp: bool) {
            let (word, transport) = if udp { ("udp", Transport::Udp) } else { ("tcp", Transport::Tcp) };
            prop_assert_eq!(read(&format!("{port}/{word}")), Some(ListenPort { port, transport }));
        }
    }
}
