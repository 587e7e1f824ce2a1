//! Settings from outside a testbed file: one key's path and another value, so that a file can be run in variants.
//! They change the tree before it is decoded, and are therefore checked as what stands in the file is.

use std::{fmt, ops::Range, str::FromStr};

use cotorra_graph::{BUNDLED_PLUGINS, HardwareGraph};

use crate::yaml::{
    self, Sink,
    decode::{Entry, Node, Value, nearest, there_are},
};

/// Override of one key of a testbed file, written `path=value`.
///
/// A path leads from key to key, as in `wireless.corridor.rate`. In a list it names an item by its index from 0, a link
/// by its name, a plug-in by its id. `*` stands for any part of a name, as in `links.*-cloud.delay_scale`. The value is
/// YAML.
///
/// The path `plugin` sets all plug-ins at once. Its value is the one that runs: declared in the file, enabled or not,
/// or bundled.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    path: String,
    value: String,
}

/// Error of a text that is not a setting.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a setting: write a key's path and its value, as in links.*.delay_scale=2")]
pub struct InvalidSetting(String);

impl Setting {
    /// The setting of a key.
    ///
    /// # Errors
    /// [`InvalidSetting`] if a part of the path is empty, or there is more than one line.
    pub fn new(path: &str, value: &str) -> Result<Self, InvalidSetting> {
        let (path, value) = (path.trim(), value.trim());
        if path.split('.').any(str::is_empty) || path.contains(['\n', '=']) || value.contains('\n') {
            return Err(InvalidSetting(format!("{path}={value}")));
        }
        Ok(Self { path: path.to_owned(), value: value.to_owned() })
    }

    /// The key's path.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Returns the value, as YAML.
    pub fn value(&self) -> &str {
        &self.value
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.path, self.value)
    }
}

impl FromStr for Setting {
    type Err = InvalidSetting;

    fn from_str(text: &str) -> Result<Self, InvalidSetting> {
        let (path, value) = text.split_once('=').ok_or_else(|| InvalidSetting(text.to_owned()))?;
        Self::new(path, value)
    }
}

/// Beginning of a line that notes a setting.
const NOTE: &str = "# set: ";

/// A file's text with its settings as comments behind it, where mistakes in them are shown.
pub(super) fn annotate(text: &str, settings: &[Setting]) -> String {
    let mut text = text.to_owned();
    for setting in settings {
        if !text.is_empty() && !text.ends_with('\n') {
            text.push('\n');
        }
        text += &format!("{NOTE}{setting}\n");
    }
    text
}

/// Finds the settings that a file's last lines note, and their places.
pub(super) fn noted(text: &str) -> (Vec<Setting>, Vec<Range<usize>>) {
    let mut end = text.len();
    let lines = text.split_inclusive('\n').rev().map_while(|line| {
        let start = end - line.len();
        end = start;
        let setting = line.trim_end().strip_prefix(NOTE)?;
        let place = start + NOTE.len()..start + NOTE.len() + setting.len();
        Some(setting.parse().ok().map(|setting| (setting, place)))
    });
    let mut found: Vec<(Setting, Range<usize>)> = lines.flatten().collect();
    found.reverse();
    found.into_iter().unzip()
}

/// Changes a file's tree. The plug-in that runs is chosen last, by the last setting that chooses one, so that the order of
/// other settings does not matter.
pub(super) fn apply(root: &mut Node, settings: &[Setting], places: &[Range<usize>], sink: &mut Sink) {
    let (plugin, others): (Vec<_>, Vec<_>) =
        settings.iter().zip(places).partition(|(setting, _)| setting.path == "plugin");
    for (setting, place) in others {
        let Some(value) = value(setting, place, sink) else { continue };
        let mut change = Change { setting, place, value, sink };
        if let Some(pattern) = setting.path.strip_prefix("links.") {
            let pattern = pattern.split('.').next().unwrap_or(pattern);
            if pattern != "*"
                && let Some(links) = find(root, "links")
            {
                expand_links(links);
            }
        }
        change.set(root, &setting.path, "");
    }
    if let Some((setting, place)) = plugin.last() {
        choose_plugin(root, setting, place);
    }
}

fn value(setting: &Setting, place: &Range<usize>, sink: &mut Sink) -> Option<Node> {
    let mut of_value = Sink::default();
    match yaml::parse(&setting.value, &mut of_value) {
        Some(mut node) => {
            put(&mut node, place);
            Some(node)
        }
        None => {
            sink.error(place, "this value is no YAML")
                .help("write it as it would stand in the file, as in `5 ms` or `[1, 2]`");
            None
        }
    }
}

/// Gives a tree a place.
fn put(node: &mut Node, place: &Range<usize>) {
    node.span = place.clone();
    match &mut node.value {
        Value::Scalar { .. } => {}
        Value::Sequence(items) => items.iter_mut().for_each(|item| put(item, place)),
        Value::Mapping(entries) => entries.iter_mut().for_each(|entry| {
            entry.key_span = place.clone();
            put(&mut entry.value, place);
        }),
    }
}

fn find<'a>(node: &'a mut Node, key: &str) -> Option<&'a mut Node> {
    match &mut node.value {
        Value::Mapping(entries) => entries.iter_mut().find(|e| e.key == key).map(|e| &mut e.value),
        _ => None,
    }
}

struct Change<'a> {
    setting: &'a Setting,
    place: &'a Range<usize>,
    value: Node,
    sink: &'a mut Sink,
}

impl Change<'_> {
    /// Sets what the path leads to from this node on; `above` is the path to it.
    fn set(&mut self, node: &mut Node, path: &str, above: &str) {
        if path.is_empty() {
            *node = self.value.clone();
            return;
        }
        if node.is_null() {
            let list = matches!(above, "plugins" | "links");
            node.value = if list { Value::Sequence(Vec::new()) } else { Value::Mapping(Vec::new()) };
        }
        match &mut node.value {
            Value::Mapping(entries) => self.set_in_mapping(entries, path, above),
            Value::Sequence(items) => self.set_in_list(items, path, above),
            Value::Scalar { .. } => {
                let found = node.describe();
                self.sink
                    .error(self.place, format!("`{above}` is {found}, which has no keys"))
                    .help(format!("set it as a whole: {above}={}", self.setting.value));
            }
        }
    }

    fn set_in_mapping(&mut self, entries: &mut Vec<Entry>, path: &str, above: &str) {
        let names: Vec<_> = entries.iter().map(|e| e.key.clone()).collect();
        let (chosen, key, rest) = choose(&names, path);
        for &i in &chosen {
            self.set(&mut entries[i].value, rest, &join(above, &names[i]));
        }
        if !chosen.is_empty() {
            return;
        }
        if key.contains('*') {
            return self.nothing(key, above, &names);
        }
        // A key that the file leaves out; whether there is such a one shows when it is decoded.
        let value = Value::Scalar { text: String::new(), plain: true };
        let mut value = Node { span: self.place.clone(), value };
        self.set(&mut value, rest, &join(above, key));
        entries.push(Entry { key: key.to_owned(), key_span: self.place.clone(), value });
    }

    fn set_in_list(&mut self, items: &mut Vec<Node>, path: &str, above: &str) {
        let name = |(i, item): (usize, &Node)| name(item).unwrap_or_else(|| i.to_string());
        let names: Vec<_> = items.iter().enumerate().map(name).collect();
        let (mut chosen, key, rest) = choose(&names, path);
        if chosen.is_empty() {
            chosen.extend(key.parse().ok().filter(|&place: &usize| place < items.len()));
        }
        if chosen.is_empty() && above == "plugins" && BUNDLED_PLUGINS.contains(&key) {
            chosen.push(items.len());
            items.push(scalar(key, self.place));
        }
        for &i in &chosen {
            // A plug-in may be written as its bare name.
            if above == "plugins" && !rest.is_empty() && items[i].text().is_some() {
                let bundled = items[i].clone();
                let entry =
                    Entry { key: "bundled".to_owned(), key_span: bundled.span.clone(), value: bundled };
                items[i].value = Value::Mapping(vec![entry]);
            }
            self.set(&mut items[i], rest, &join(above, key));
        }
        if chosen.is_empty() {
            self.nothing(key, above, &names);
        }
    }

    fn nothing(&mut self, key: &str, above: &str, names: &[String]) {
        let message = format!("`{key}` in `{above}` matches nothing");
        let help = match nearest(key, names.iter().map(String::as_str)) {
            Some(close) => format!("did you mean `{close}`?"),
            None if names.is_empty() => format!("there is nothing in `{above}`"),
            None => there_are(names),
        };
        self.sink.error(self.place, message).help(help);
    }
}

/// Splits a path at its first part, and returns the names that this part matches. Names may have dots, so the longest
/// name that fits wins. Otherwise the part up to the first dot is a pattern.
fn choose<'a>(names: &[String], path: &'a str) -> (Vec<usize>, &'a str, &'a str) {
    let fits =
        |name: &str| path.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
    let exact = (0..names.len()).filter(|&i| fits(&names[i])).max_by_key(|&i| names[i].len());
    if let Some(i) = exact {
        let (key, rest) = path.split_at(names[i].len());
        return (vec![i], key, rest.trim_start_matches('.'));
    }
    let (key, rest) = path.split_once('.').unwrap_or((path, ""));
    let chosen = (0..names.len()).filter(|&i| key.contains('*') && matches(key, &names[i])).collect();
    (chosen, key, rest)
}

/// Whether a name fits a pattern, in which `*` stands for any text.
fn matches(pattern: &str, name: &str) -> bool {
    let Some((first, rest)) = pattern.split_once('*') else { return pattern == name };
    let Some(mut name) = name.strip_prefix(first) else { return false };
    let mut parts: Vec<_> = rest.split('*').collect();
    let last = parts.pop().unwrap_or_default();
    for part in parts {
        let Some(at) = name.find(part) else { return false };
        name = &name[at + part.len()..];
    }
    name.ends_with(last)
}

fn join(above: &str, key: &str) -> String {
    if above.is_empty() { key.to_owned() } else { format!("{above}.{key}") }
}

fn scalar(text: &str, place: &Range<usize>) -> Node {
    Node { span: place.clone(), value: Value::Scalar { text: text.to_owned(), plain: true } }
}

/// Returns the name of a list's item: a link's name, or a plug-in's id.
fn name(item: &Node) -> Option<String> {
    let Value::Mapping(entries) = &item.value else { return item.text().map(str::to_owned) };
    let get = |key: &str| entries.iter().find(|e| e.key == key).map(|e| &e.value);
    if let Some(id) = get("id").or_else(|| get("bundled")) {
        return id.text().map(str::to_owned);
    }
    let Value::Sequence(ends) = &get("ends")?.value else { return None };
    let [a, b] = &ends[..] else { return None };
    Some(format!("{}-{}", a.text()?, b.text()?))
}

/// Writes out the entries of `links` that stand for several alike, so that each can be set by itself.
fn expand_links(links: &mut Node) {
    let Value::Sequence(items) = &mut links.value else { return };
    if items.iter().map(stands_for).fold(0, usize::saturating_add) > HardwareGraph::MAX_LINKS {
        // It is rejected for that, in its place.
        return;
    }
    *items = std::mem::take(items).into_iter().flat_map(expand_link).collect();
}

/// Returns the number of links that an entry describes.
fn stands_for(link: &Node) -> usize {
    let Value::Mapping(entries) = &link.value else { return 1 };
    let ends = entries.iter().find(|e| e.key == "ends").map(|e| &e.value.value);
    let Some(Value::Sequence(ends)) = ends else { return 1 };
    let several = |end: &Node| if let Value::Sequence(several) = &end.value { several.len() } else { 1 };
    ends.iter().map(several).fold(1, usize::saturating_mul)
}

fn expand_link(link: Node) -> Vec<Node> {
    let ends = match &link.value {
        Value::Mapping(entries) => entries.iter().position(|e| e.key == "ends"),
        _ => None,
    };
    let with_ends = |at: usize, ends: Node| {
        let mut link = link.clone();
        if let Value::Mapping(entries) = &mut link.value {
            entries[at].value = ends;
        }
        link
    };
    let Some((at, Value::Mapping(entries))) = ends.map(|at| (at, &link.value)) else { return vec![link] };
    let ends = &entries[at].value;
    let Value::Sequence(both) = &ends.value else { return vec![link] };
    let [first, second] = &both[..] else { return vec![link] };
    let several = |end: &Node| match &end.value {
        Value::Sequence(several) => several.clone(),
        _ => vec![end.clone()],
    };
    let pairs =
        several(first).into_iter().flat_map(|a| several(second).into_iter().map(move |b| vec![a.clone(), b]));
    pairs.map(|pair| with_ends(at, Node { span: ends.span.clone(), value: Value::Sequence(pair) })).collect()
}

/// Leaves one plug-in alone: as it is declared, or else bundled.
fn choose_plugin(root: &mut Node, setting: &Setting, place: &Range<usize>) {
    let Value::Mapping(entries) = &mut root.value else { return };
    let at = entries.iter().position(|e| e.key == "plugins").unwrap_or_else(|| {
        entries.push(Entry { key: "plugins".to_owned(), key_span: place.clone(), value: scalar("", place) });
        entries.len() - 1
    });
    let plugins = &mut entries[at].value;
    let declared = match &mut plugins.value {
        Value::Sequence(items) => {
            std::mem::take(items).into_iter().find(|i| name(i).as_deref() == Some(&setting.value))
        }
        Value::Scalar { .. } | Value::Mapping(_) => None,
    };
    let mut chosen = declared.unwrap_or_else(|| scalar(&setting.value, place));
    if let Value::Mapping(entries) = &mut chosen.value {
        entries.retain(|e| e.key != "enabled");
    }
    plugins.value = Value::Sequence(vec![chosen]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_stand_for_any_text() {
        for (pattern, name, expected) in [
            ("*", "anything", true),
            ("R*-cloud", "R1-cloud", true),
            ("R*-cloud", "R1-edge", false),
            ("*-*", "a-b", true),
            ("*a*a", "a", false),
            ("a*", "ba", false),
        ] {
            assert_eq!(matches(pattern, name), expected, "{pattern} {name}");
        }
    }

    #[test]
    fn a_setting_is_a_path_and_a_value() {
        let setting: Setting = "links.*.delay = 5 ms".parse().unwrap();
        assert_eq!((setting.path(), setting.value()), ("links.*.delay", "5 ms"));
        for wrong in ["", "seed", "=3", "a..b=3", ".a=1", "a=1\nb"] {
            assert!(wrong.parse::<Setting>().is_err(), "{wrong:?}");
        }
    }
}
