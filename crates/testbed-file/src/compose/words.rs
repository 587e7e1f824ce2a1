//! Words of compose files, where they differ from those of testbed files.

use std::path::PathBuf;

use cotorra_graph::{LinuxCapability, Pull, Volume};
use serde_json::{Value as Json, json};

use crate::{
    image::{self, Device, Dialect},
    yaml::{
        Sink,
        decode::{Decode, Entry, Node, Spanned, Value, choice, choose, expected},
        shorten,
    },
};

/// Largest limit of memory, bytes: as of a VNF.
const MOST_MEMORY: f64 = 1e15;

/// The one kind of mount.
#[derive(Debug)]
pub(crate) enum MountKind {
    Bind,
}

choice!(MountKind, "type of mount", { "bind" => Self::Bind, "a file or folder of the machine"; });

/// When an image is pulled.
#[derive(Debug)]
pub(crate) struct PullPolicy(pub Pull);

choice!(PullPolicy, "pull policy", {
    "missing" => Self(Pull::Missing), "if the engine does not have the image";
    "if_not_present" => Self(Pull::Missing), "the same";
    "always" => Self(Pull::Always), "before each start";
    "never" => Self(Pull::Never), "the engine must have it";
});

/// Words of a command: a list, or one text that is split as a shell does.
#[derive(Debug)]
pub(crate) struct Command(pub Vec<String>);

impl Decode for Command {
    fn schema() -> Json {
        json!({ "anyOf": [{ "type": "string" }, { "type": "array", "items": { "type": "string" } }] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let words = match &node.value {
            Value::Sequence(_) => Vec::<String>::decode(node, sink)?,
            _ => {
                let text = String::decode(node, sink)?;
                let Some(words) = split(&text) else {
                    sink.error(
                        &node.span,
                        "a quote of this command is not closed, or nothing follows its last `\\`",
                    )
                    .help("write a list of words, such as `[python3, serve.py]`");
                    return None;
                };
                words
            }
        };
        if words.first().is_none_or(|word| word.trim().is_empty()) {
            sink.error(&node.span, "this command names no program")
                .help("leave out `command` for the image's own, or write `[program, argument, …]`");
            return None;
        }
        Some(Self(words))
    }
}

/// Splits a text into words as a shell does, by blanks, quotes and `\`; nothing else is special. `None` if a quote is not
/// closed, or nothing follows a `\`.
fn split(text: &str) -> Option<Vec<String>> {
    let (mut words, mut word, mut letters) = (Vec::new(), None::<String>, text.chars());
    while let Some(letter) = letters.next() {
        match letter {
            '\'' => {
                let word = word.get_or_insert_default();
                loop {
                    match letters.next()? {
                        '\'' => break,
                        other => word.push(other),
                    }
                }
            }
            '"' => {
                let word = word.get_or_insert_default();
                loop {
                    match letters.next()? {
                        '"' => break,
                        '\\' => match letters.next()? {
                            special @ ('"' | '\\' | '$' | '`') => word.push(special),
                            '\n' => {}
                            other => word.extend(['\\', other]),
                        },
                        other => word.push(other),
                    }
                }
            }
            '\\' => match letters.next()? {
                '\n' => {}
                other => word.get_or_insert_default().push(other),
            },
            ' ' | '\t' | '\n' => words.extend(word.take()),
            other => word.get_or_insert_default().push(other),
        }
    }
    words.extend(word);
    Some(words)
}

/// Variables as `NAME` and `NAME=VALUE`.
#[derive(Debug)]
pub(crate) struct Environment(pub Vec<Spanned<String>>);

impl Decode for Environment {
    fn schema() -> Json {
        json!({ "anyOf": [{ "type": "array", "items": { "type": "string" } }, { "type": "object" }] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let Value::Mapping(entries) = &node.value else { return Vec::decode(node, sink).map(Self) };
        let variable = |entry: &Entry, sink: &mut Sink| {
            let value = match &entry.value.value {
                _ if entry.value.is_null() => entry.key.clone(),
                Value::Scalar { text, .. } => format!("{}={text}", entry.key),
                _ => {
                    expected(&entry.value, "a text", "write `NAME: value`, or `NAME:` to pass it on", sink);
                    return None;
                }
            };
            if entry.key.contains('=') {
                sink.error(
                    &entry.key_span,
                    format!("`{}` is not the name of a variable", shorten(&entry.key)),
                )
                .help("write `NAME: value`");
                return None;
            }
            Some(Spanned { value, span: entry.key_span.clone() })
        };
        let all: Vec<_> = entries.iter().map(|entry| variable(entry, sink)).collect();
        all.into_iter().collect::<Option<_>>().map(Self)
    }
}

/// A volume in the short form.
#[derive(Debug)]
pub(crate) struct Bind(pub Spanned<Volume>);

impl Decode for Bind {
    fn schema() -> Json {
        json!({ "type": "string", "examples": ["./data:/data"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let value = image::volume(node, Dialect::Compose, sink)?;
        Some(Self(Spanned { value, span: node.span.clone() }))
    }
}

/// A path on the machine.
#[derive(Debug)]
pub(crate) struct Source(pub PathBuf);

impl Decode for Source {
    fn schema() -> Json {
        json!({ "type": "string", "examples": ["./data"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        image::source_path(node.text().unwrap_or_default(), node, Dialect::Testbed, sink).map(Self)
    }
}

/// A path in a container.
#[derive(Debug)]
pub(crate) struct Target(pub Spanned<PathBuf>);

impl Decode for Target {
    fn schema() -> Json {
        json!({ "type": "string", "examples": ["/data"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let value = image::target_path(node.text().unwrap_or_default(), node, sink)?;
        Some(Self(Spanned { value, span: node.span.clone() }))
    }
}

/// A device that has the same path on the machine and in the container.
#[derive(Debug)]
pub(crate) struct SameDevice(pub PathBuf);

impl Decode for SameDevice {
    fn schema() -> Json {
        Device::schema()
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let text = node.text().unwrap_or_default();
        let path = match text.split(':').collect::<Vec<_>>()[..] {
            [path] => path,
            [path, inside] | [path, inside, "rwm"] if path == inside => path,
            [path, inside] | [path, inside, _] if Device::is_path(path) && Device::is_path(inside) => {
                sink.error(
                    &node.span,
                    format!("{} gives a device another path or fewer rights", node.describe()),
                )
                .help(format!("write `{path}`"));
                return None;
            }
            _ => text,
        };
        Device::read(path, node, sink).map(|device| Self(device.0))
    }
}

/// CPUs, as a number or a text.
#[derive(Debug)]
pub(crate) struct Cpus(pub f64);

impl Decode for Cpus {
    fn schema() -> Json {
        json!({ "type": "number", "examples": [0.5] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let text = node.text().unwrap_or_default();
        let begins_well = text.starts_with(|c: char| c.is_ascii_digit() || c == '.');
        let cpus = text.parse().ok().filter(|cpus: &f64| begins_well && cpus.is_finite() && *cpus > 0.0);
        if cpus.is_none() {
            expected(node, "a number of CPUs above 0", "write it like `0.5`, or leave it out for 1", sink);
        }
        cpus.map(Self)
    }
}

/// Bytes of memory, in powers of 1024 as in compose.
#[derive(Debug)]
pub(crate) struct Memory(pub u64);

impl Decode for Memory {
    fn schema() -> Json {
        json!({ "type": "string", "examples": ["512m"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let memory = memory(node.text().unwrap_or_default());
        if memory.is_none() {
            expected(
                node,
                "an amount of memory above 0",
                "write it like `512m` or `2gb`, in powers of 1024",
                sink,
            );
        }
        memory.map(Self)
    }
}

fn memory(text: &str) -> Option<u64> {
    let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let factor = match text[end..].trim_start().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kb" | "kib" => 1024.0,
        "m" | "mb" | "mib" => 1_048_576.0,
        "g" | "gb" | "gib" => 1_073_741_824.0,
        "t" | "tb" | "tib" => 1_099_511_627_776.0,
        _ => return None,
    };
    let bytes = (text[..end].parse::<f64>().ok()? * factor).round();
    (1.0..=MOST_MEMORY).contains(&bytes).then_some(bytes as u64)
}

/// A capability of Linux, as compose names it.
#[derive(Debug)]
pub(crate) struct Capability(pub LinuxCapability);

impl Decode for Capability {
    fn schema() -> Json {
        json!({ "type": "string", "examples": ["NET_RAW"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        const NAMES: [(&str, LinuxCapability); 6] = [
            ("NET_BIND_SERVICE", LinuxCapability::NetBindService),
            ("NET_BROADCAST", LinuxCapability::NetBroadcast),
            ("NET_ADMIN", LinuxCapability::NetAdmin),
            ("NET_RAW", LinuxCapability::NetRaw),
            ("IPC_LOCK", LinuxCapability::IpcLock),
            ("SYS_NICE", LinuxCapability::SysNice),
        ];
        let text = node.text().unwrap_or_default();
        let given = text.strip_prefix("CAP_").unwrap_or(text);
        if let Some((_, capability)) = NAMES.iter().find(|(name, _)| *name == given) {
            return Some(Self(*capability));
        }
        choose(node, "capability that a container can have", &NAMES.map(|(name, _)| name), sink);
        None
    }
}

/// Done by cotorra anyway: it starts again what ends.
#[derive(Debug)]
pub(crate) struct Restart;

impl Decode for Restart {
    fn schema() -> Json {
        json!({ "enum": ["always", "unless-stopped", "on-failure"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        if node.text() == Some("no") {
            sink.error(&node.span, "cotorra starts a container again when it ends")
                .help("leave out `restart`: a VNF that ends is started again");
            return None;
        }
        choose(node, "restart policy", &["always", "unless-stopped", "on-failure"], sink).map(|_| Self)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn commands_are_split_as_by_a_shell() {
        let words = |text: &str| split(text).map(|words| words.join("|"));
        assert_eq!(words("a  b\tc\n"), Some("a|b|c".to_owned()));
        assert_eq!(words(r#"a'b c'd "e \"f\" \g" '' \'"#), Some(r#"ab cd|e "f" \g||'"#.to_owned()));
        assert_eq!(words("a\\\nb"), Some("ab".to_owned()));
        for text in ["'a", "\"a", "a\\", "\"a\\"] {
            assert_eq!(words(text), None, "{text}");
        }
    }

    #[test]
    fn memory_counts_in_powers_of_1024() {
        assert_eq!(memory("300000000"), Some(300_000_000));
        assert_eq!(memory("64k"), Some(64 << 10));
        assert_eq!(memory("1.5 GB"), Some(3 << 29));
        for text in ["", "g", "0", "-1", "1 pound", "1e3", "inf", "2000t", "1.2.3"] {
            assert_eq!(memory(text), None, "{text}");
        }
    }

    proptest! {
        #[test]
        fn quoted_words_survive(words in prop::collection::vec("\\PC{0,8}", 0..5)) {
            let quoted: Vec<_> = words.iter().map(|word| format!("'{}'", word.replace('\'', "'\\''"))).collect();
            prop_assert_eq!(split(&quoted.join(" ")), Some(words));
        }

        #[test]
        fn no_text_panics(text in "[ab'\"\\\\ ]{0,12}") {
            _ = split(&text);
        }
    }
}
