//! Sets keys of a VNF in a testbed file's text. Comments, order and layout of all else stay.

use cotorra_graph::VnfId;
use serde_json::Value as Json;

use crate::{
    tree,
    yaml::{
        self, Sink,
        decode::{Entry, Node, Value},
    },
};

/// Error in setting keys of a VNF.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum VnfKeysError {
    /// A text that is no YAML.
    #[error("the testbed file is no YAML: check it with `cotorra check`")]
    NotYaml,
    /// A VNF that the text does not describe.
    #[error("the file describes no VNF `{vnf}`{}", there_are(.known))]
    Unknown { vnf: VnfId, known: Vec<String> },
    /// A VNF without an image.
    #[error("VNF `{0}` has no image")]
    NoImage(VnfId),
    /// A VNF whose keys cannot be changed alone, for example because it is an alias.
    #[error("`{key}: {value}` cannot be set for VNF `{vnf}` without changing more: write it there yourself")]
    Layout { vnf: VnfId, key: String, value: String },
}

fn there_are(names: &[String]) -> String {
    if names.is_empty() { String::new() } else { format!("; there are: {}", names.join(", ")) }
}

/// Sets these keys of a VNF that has an image, each to a value on one line of YAML. Values of present keys are replaced;
/// others follow the key before, the first one `image`. Returns the new text, which differs in these keys only.
///
/// # Errors
/// [`VnfKeysError`].
pub fn set_vnf_keys(text: &str, vnf: &VnfId, keys: &[(&str, &str)]) -> Result<String, VnfKeysError> {
    let mut text = text.to_owned();
    let mut after = "image";
    for (key, value) in keys {
        text = set(&text, vnf, after, (key, value))?;
        after = key;
    }
    Ok(text)
}

/// Sets one key. A key that is not there comes after the key `after`.
fn set(text: &str, vnf: &VnfId, after: &str, (key, value): (&str, &str)) -> Result<String, VnfKeysError> {
    let root = yaml::parse(text, &mut Sink::default()).ok_or(VnfKeysError::NotYaml)?;
    let (service, entries) = described(&root, vnf)?;
    let find = |key: &str| entries.iter().find(|entry| entry.key == key);
    find("image").ok_or_else(|| VnfKeysError::NoImage(vnf.clone()))?;
    let present = find(key).filter(|entry| !entry.value.is_null());
    let candidates = match present {
        Some(entry) => vec![replaced(text, entry, value)],
        None => find(after).map(|after| added(text, after, &format!("{key}: {value}"))).unwrap_or_default(),
    };
    let cannot = || VnfKeysError::Layout { vnf: vnf.clone(), key: key.to_owned(), value: value.to_owned() };
    let wanted = wanted(text, &[service, vnf.as_str(), key], value).ok_or_else(cannot)?;
    let mut fitting = candidates.into_iter().filter(|changed| json(changed).as_ref() == Some(&wanted));
    fitting.next().ok_or_else(cannot)
}

/// Returns the name of a VNF's service, and the VNF's keys.
fn described<'a>(root: &'a Node, vnf: &VnfId) -> Result<(&'a str, &'a [Entry]), VnfKeysError> {
    let entries = |node: Option<&'a Node>| match node.map(|node| &node.value) {
        Some(Value::Mapping(entries)) => &entries[..],
        _ => &[],
    };
    let services = entries(root.get("services")).iter();
    let all =
        || services.clone().flat_map(|its| entries(its.value.get("vnfs")).iter().map(move |of| (its, of)));
    match all().find(|(_, of)| of.key == vnf.as_str()) {
        Some((service, of)) => Ok((&service.key, entries(Some(&of.value)))),
        None => {
            let known = all().map(|(_, of)| of.key.clone()).collect();
            Err(VnfKeysError::Unknown { vnf: vnf.clone(), known })
        }
    }
}

fn replaced(text: &str, entry: &Entry, value: &str) -> String {
    let mut changed = text.to_owned();
    changed.replace_range(entry.value.span.start..end(text, &entry.value), value);
    changed
}

/// Returns the end of a value. The parser's own includes comments behind a quoted text.
fn end(text: &str, value: &Node) -> usize {
    let written = &text[value.span.clone()];
    let mut chars = written.char_indices();
    let quote = chars.next().map(|(_, first)| first).filter(|first| matches!(first, '"' | '\''));
    let Some(quote) = quote else { return value.span.end };
    while let Some((at, next)) = chars.next() {
        match next {
            '\\' if quote == '"' => drop(chars.next()),
            // Two of them are one within the text.
            '\'' if quote == next && written[at + 1..].starts_with(next) => drop(chars.next()),
            _ if next == quote => return value.span.start + at + 1,
            _ => {}
        }
    }
    value.span.end
}

/// Returns the texts with an entry added behind another: on the same line as in `{ image: x }`, and on a line below.
fn added(text: &str, after: &Entry, entry: &str) -> Vec<String> {
    let end = end(text, &after.value);
    let inside = format!("{}, {entry}{}", &text[..end], &text[end..]);
    let start_of_line = text[..after.key_span.start].rfind('\n').map_or(0, |at| at + 1);
    let indent = &text[start_of_line..after.key_span.start];
    let end_of_line = text[end..].find('\n').map_or(text.len(), |at| end + at + 1);
    let (before, behind) = text.split_at(end_of_line);
    let below = match (before.ends_with("\r\n"), before.ends_with('\n')) {
        (true, _) => format!("{before}{indent}{entry}\r\n{behind}"),
        (_, true) => format!("{before}{indent}{entry}\n{behind}"),
        _ => format!("{before}\n{indent}{entry}"),
    };
    vec![inside, below]
}

/// Returns a file's content, with its settings.
fn json(text: &str) -> Option<Json> {
    let mut sink = Sink::default();
    let root = tree(text, &mut sink)?;
    sink.is_empty().then(|| root.to_json())
}

/// Returns a file's content with one key of a VNF set.
fn wanted(text: &str, [service, vnf, key]: &[&str; 3], value: &str) -> Option<Json> {
    let mut content = json(text)?;
    let vnf = content.get_mut("services")?.get_mut(service)?.get_mut("vnfs")?.get_mut(vnf)?;
    vnf.as_object_mut()?.insert((*key).to_owned(), json(value)?);
    Some(content)
}

#[cfg(test)]
mod tests {
    use std::{path::Path, time::Duration};

    use super::*;

    const KEYS: [(&str, &str); 2] = [("start_time", "512 ms"), ("processing_delay", "3.1 ms")];

    fn changed(text: &str) -> Result<String, VnfKeysError> {
        set_vnf_keys(text, &VnfId::new("v").unwrap(), &KEYS)
    }

    #[test]
    fn keys_are_added_behind_the_image_in_any_layout() {
        for (text, expected) in [
            (
                "services:\n  s:\n    vnfs:\n      v: { image: 'x:1', node: a } # the brain\n",
                "services:\n  s:\n    vnfs:\n      v: { image: 'x:1', start_time: 512 ms, processing_delay: 3.1 ms, \
                 node: a } # the brain\n",
            ),
            (
                "services:\n  s:\n    vnfs:\n      v:\n        program: navigation\n        image: x:1   # ours\n\n        \
                 # Where it begins.\n        node: a\n      w: { command: [x] }\n",
                "services:\n  s:\n    vnfs:\n      v:\n        program: navigation\n        image: x:1   # ours\n        \
                 start_time: 512 ms\n        processing_delay: 3.1 ms\n\n        # Where it begins.\n        node: a\n      \
                 w: { command: [x] }\n",
            ),
            (
                "services:\r\n  s:\r\n    vnfs:\r\n      v:\r\n        image: x\r\n        node: a\r\n",
                "services:\r\n  s:\r\n    vnfs:\r\n      v:\r\n        image: x\r\n        start_time: 512 ms\r\n        \
                 processing_delay: 3.1 ms\r\n        node: a\r\n",
            ),
            (
                "services:\n  s:\n    vnfs:\n      v:\n        node: ä\n        image: x",
                "services:\n  s:\n    vnfs:\n      v:\n        node: ä\n        image: x\n        start_time: 512 ms\n        \
                 processing_delay: 3.1 ms",
            ),
            (
                "services:\n  s:\n    vnfs:\n      v:\n        image: 'it''s' # 'ours'\n        # Where.\n        node: a\n",
                "services:\n  s:\n    vnfs:\n      v:\n        image: 'it''s' # 'ours'\n        start_time: 512 ms\n        \
                 processing_delay: 3.1 ms\n        # Where.\n        node: a\n",
            ),
            (
                "services: { s: { vnfs: { v: {\n  image: \"a\\\"b\" # ours\n } } } }\n",
                "services: { s: { vnfs: { v: {\n  image: \"a\\\"b\", start_time: 512 ms, processing_delay: 3.1 ms # ours\n \
                 } } } }\n",
            ),
            (
                "services: { s: { vnfs: { v: {\n  image: x, # ours\n  node: a,\n} } } }\n",
                "services: { s: { vnfs: { v: {\n  image: x, start_time: 512 ms, processing_delay: 3.1 ms, # ours\n  \
                 node: a,\n} } } }\n",
            ),
        ] {
            assert_eq!(changed(text).as_deref(), Ok(expected), "{text}");
            assert_eq!(changed(expected).as_deref(), Ok(expected), "again");
        }
    }

    #[test]
    fn present_values_are_replaced_in_place() {
        let text = "services:\n  s:\n    vnfs:\n      w: { image: x, start_time: 1 s }\n      v:\n        \
                    start_time: \"2 s\"  # guessed\n        image: x\n        processing_delay: 1 ms\n";
        let expected = "services:\n  s:\n    vnfs:\n      w: { image: x, start_time: 1 s }\n      v:\n        \
                        start_time: 512 ms  # guessed\n        image: x\n        processing_delay: 3.1 ms\n";
        assert_eq!(changed(text).as_deref(), Ok(expected));
    }

    #[test]
    fn a_testbed_has_the_times_that_were_set() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds");
        let text = std::fs::read_to_string(folder.join("corridor.yaml")).unwrap();
        let text = text.replace("program: navigation,", "program: navigation, image: 'robot:1',");
        let vnf = VnfId::new("navigation").unwrap();
        let changed = set_vnf_keys(&text, &vnf, &KEYS).unwrap();
        assert_eq!(changed.lines().count(), text.lines().count());
        let testbed = crate::parse("x.yaml", &changed, &folder).unwrap_or_else(|wrong| panic!("{wrong}"));
        let image = testbed.vnfs().find(|its| its.id == vnf).and_then(|its| its.image.clone()).unwrap();
        let expected = (Duration::from_millis(512), Duration::from_micros(3100));
        assert_eq!((image.start, image.processing), expected);
    }

    #[test]
    fn what_cannot_be_changed_alone_is_rejected_with_the_reason() {
        let alias = "services:\n  s:\n    vnfs:\n      w: &same\n        image: x\n      v: *same\n";
        let noted =
            "services:\n  s:\n    vnfs:\n      v: { image: x }\n# set: services.s.vnfs.v.start_time=1 s\n";
        for (text, reason) in [
            (
                alias,
                "`start_time: 512 ms` cannot be set for VNF `v` without changing more: write it there yourself",
            ),
            (
                noted,
                "`start_time: 512 ms` cannot be set for VNF `v` without changing more: write it there yourself",
            ),
            ("services: { s: { vnfs: { v: { command: [x] } } } }", "VNF `v` has no image"),
            ("services: { s: { vnfs: { w: {}, x: {} } } }", "the file describes no VNF `v`; there are: w, x"),
            ("name: x\n", "the file describes no VNF `v`"),
            ("a: [", "the testbed file is no YAML: check it with `cotorra check`"),
        ] {
            assert_eq!(changed(text).map_err(|error| error.to_string()), Err(reason.to_owned()), "{text}");
        }
    }
}
