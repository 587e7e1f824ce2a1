//! Names and units in docs/reference/fields.md, against everything that programs read: each quantity has one name
//! and one unit.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
};

use cotorra_fabric::{ForgedFrames, ForgedSources};
use cotorra_graph::{Better, FIGURES, FigureKind, SensorKind};
use cotorra_testbed::ForgedSummary;
use serde_json::Value;

use crate::{
    harness::{corridor, cotorra, project_file, stderr, stdout},
    migrations,
};

/// Statistics in names, before the unit.
const STATISTICS: [&str; 9] = ["p50", "p95", "p99", "min", "max", "mean", "low", "high", "difference"];
/// Prefixes of names in flat tables.
const OF: [&str; 12] = [
    "odometry",
    "probed",
    "tested",
    "jitter",
    "queue",
    "loss",
    "handover",
    "asked",
    "effective",
    "cpu",
    "received",
    "sent",
];
/// Names of numbers that are not quantities: positions, limits, names of rows, and inputs of statistics.
const NO_QUANTITIES: [&str; 14] = [
    "a",
    "b",
    "after",
    "fast",
    "last",
    "limit",
    "mac",
    "number",
    "passed",
    "points",
    "quantiles",
    "quantiles_within",
    "values",
    "walked",
];

/// A distance, which a twin of the run does not have.
const FAR: &str = "plugins.okpi.control_delay=100 ms";

/// A testbed with a source of traffic of each protocol.
const CARRIED: &str = "name: carried
nodes:
  fog: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links:
  - { ends: [fog, edge], delay: 1 ms, rate: 10 Mbit/s }
traffic:
  bulk: { from: fog, to: edge, protocol: tcp, bytes: 10 kB }
  video: { from: edge, to: fog, protocol: udp, rate: 1 Mbit/s }
  pages: { on: fog-edge, protocol: tcp, transfers: { size: 20 kB, think: 1 s } }
";

/// Prices, and powers by which a battery is empty within a second.
const PRICED: [&str; 4] = [
    "currency=EUR",
    "nodes.edge.used_cost=1",
    "nodes.edge.power.cost=0.25",
    "nodes.r1.power={ idle: 15 W, driving: 40 W, radio: { idle: 0.8 W, sending: 2 W, receiving: 1 W }, battery: 0.001 Wh }",
];

/// Units by the suffix of a name.
const UNITS: [(&str, &str); 14] = [
    ("_mhz", "MHz"),
    ("_ns", "ns"),
    ("_ms", "ms"),
    ("_us", "µs"),
    ("_bps", "bit/s"),
    ("_dbm", "dBm"),
    ("_db", "dB"),
    ("_mps", "m/s"),
    ("_ppm", "ppm"),
    ("_m", "m"),
    ("_v", "V"),
    ("_w", "W"),
    ("_wh", "Wh"),
    ("bytes", "bytes"),
];
/// Units of names without a suffix: those of poses, and bare numbers.
const BARE: [&str; 10] =
    ["m", "m/s", "m/s²", "rad", "rad/s", "share", "factor", "count", "number", "m², m rad, rad²"];

/// Reads the page: units by name.
fn fields() -> BTreeMap<String, String> {
    let page = fs::read_to_string(project_file("docs/reference/fields.md")).expect("the page is there");
    let mut fields = BTreeMap::new();
    for row in page.lines().filter(|line| line.starts_with("| `")) {
        let cells: Vec<_> = row.split('|').map(str::trim).collect();
        let name = cells[1].trim_matches('`').to_owned();
        assert!(fields.insert(name, cells[2].to_owned()).is_none(), "{} stands there twice", cells[1]);
    }
    fields
}

/// Returns the documented name that a name is derived from, without prefixes and statistics.
fn quantity(name: &str, fields: &BTreeMap<String, String>) -> Option<String> {
    let known = |name: &str| fields.contains_key(name).then(|| name.to_owned());
    let words = |name: &str| -> String {
        name.split('_').filter(|word| !STATISTICS.contains(word)).collect::<Vec<_>>().join("_")
    };
    known(name)
        // The event `lateness` and its table have only statistics of the lateness.
        .or_else(|| (words(name) == "us").then(|| "lateness_us".to_owned()))
        .or_else(|| known(&words(name)))
        .or_else(|| {
            let (of, rest) = name.split_once('_')?;
            OF.contains(&of).then(|| quantity(rest, fields)).flatten()
        })
}

#[test]
fn documented_names_end_with_their_units_and_are_unique() {
    let mut stems = BTreeMap::new();
    for (name, unit) in fields() {
        let end = UNITS.iter().find(|(end, _)| name.ends_with(end));
        match end {
            Some((_, of_end)) => assert_eq!(*of_end, unit, "{name}"),
            None => assert!(BARE.contains(&unit.as_str()), "{name} has the unit {unit}"),
        }
        let stem = end.map_or(name.as_str(), |(end, _)| name.strip_suffix(end).unwrap()).to_owned();
        // The same stem with two units would be one quantity in two units.
        if let Some(other) = stems.insert(stem, name.clone()) {
            let both = [other.as_str(), name.as_str()];
            // The correlation of jitter and the distance of that of shadowing; a deviation of a signal and of a delay; the
            // speed of time and of a network interface.
            let others =
                [["correlation", "correlation_m"], ["deviation_db", "deviation_ms"], ["speed", "speed_bps"]];
            assert!(others.contains(&both), "{both:?} are one quantity in two units");
        }
    }
}

/// Collects the names of numbers in a JSON Schema.
fn in_schema(schema: &Value, all: &Value, names: &mut BTreeSet<String>) {
    fn is_number(schema: &Value, all: &Value, depth: usize) -> bool {
        let is = |schema: &Value| is_number(schema, all, depth + 1);
        let of = |key: &str| schema[key].as_array().is_some_and(|several| several.iter().any(is));
        let kinds = schema["type"].as_array().cloned().unwrap_or_else(|| vec![schema["type"].clone()]);
        let referred = schema["$ref"].as_str().and_then(|to| to.rsplit('/').next());
        depth < 5
            && (kinds.iter().any(|kind| kind == "number" || kind == "integer")
                || of("oneOf")
                || of("anyOf")
                || schema.get("items").is_some_and(is)
                || referred.is_some_and(|name| is(&all[name])))
    }
    match schema {
        Value::Object(map) => {
            for (name, property) in map.get("properties").and_then(Value::as_object).into_iter().flatten() {
                if is_number(property, all, 0) {
                    names.insert(name.clone());
                }
            }
            map.values().for_each(|value| in_schema(value, all, names));
        }
        Value::Array(values) => values.iter().for_each(|value| in_schema(value, all, names)),
        _ => {}
    }
}

/// Collects the names of numbers in a document. An object of statistics counts as one quantity.
fn in_document(document: &Value, names: &mut BTreeSet<String>) {
    match document {
        Value::Object(map) => {
            for (name, value) in map {
                let is_statistic = STATISTICS.contains(&name.as_str());
                let has_statistics = value.get("p50").is_some();
                if (value.is_number() && !is_statistic) || has_statistics {
                    names.insert(name.clone());
                }
                in_document(value, names);
            }
        }
        Value::Array(values) => values.iter().for_each(|value| in_document(value, names)),
        _ => {}
    }
}

/// Collects the columns of the history's tables that have a unit or are not integers.
fn in_tables(sql: &str, names: &mut BTreeSet<String>) {
    for line in sql.lines().filter(|line| line.starts_with("    ")) {
        let mut words = line.split_whitespace().map(|word| word.trim_matches(['"', ',']));
        let (Some(name), Some(kind)) = (words.next(), words.next()) else { continue };
        let has_unit = UNITS.iter().any(|(end, _)| name.ends_with(end));
        if (kind == "REAL" || kind == "INTEGER" && has_unit) && !name.contains("cov_") {
            names.insert(name.to_owned());
        }
    }
}

/// Collects the numbers of the messages in recordings.
fn in_messages(source: &str, names: &mut BTreeSet<String>) {
    for line in source.lines().map(str::trim) {
        if let Some(name) = line.strip_suffix(": f64,") {
            names.insert(name.to_owned());
        }
    }
}

#[test]
fn every_figure_is_documented_with_its_unit() {
    let fields = fields();
    let mut used: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    let read = |path: &str| fs::read_to_string(project_file(path)).unwrap();

    let openapi: Value = serde_json::from_str(&read("docs/openapi.json")).unwrap();
    let api = used.entry("the API").or_default();
    in_schema(&openapi["components"]["schemas"], &openapi["components"]["schemas"], api);
    for operation in openapi["paths"].as_object().unwrap().values().flat_map(|path| path.as_object().unwrap())
    {
        for parameter in operation.1["parameters"].as_array().into_iter().flatten() {
            let named = serde_json::json!({ "properties": { parameter["name"].as_str().unwrap(): parameter["schema"] } });
            in_schema(&named, &openapi["components"]["schemas"], api);
        }
    }
    for version in ["1.sql", "2.sql", "3.sql"] {
        let schema = read(&format!("crates/measurements/src/schema/{version}"));
        in_tables(&schema, used.entry("the history").or_default());
    }
    in_messages(&read("crates/robots/recording/src/messages.rs"), used.entry("recordings").or_default());

    for kind in [SensorKind::Odometry, SensorKind::Battery { charge: Some(1.0) }, SensorKind::Imu] {
        for (component, unit) in kind.components() {
            let told = fields
                .get(component.as_str())
                .unwrap_or_else(|| panic!("docs/reference/fields.md lacks `{component}`"));
            assert_eq!(told, if unit.is_empty() { "share" } else { unit }, "{component}");
            used.entry("sensors").or_default().insert(component.to_string());
        }
    }

    let out = tempfile::tempdir().unwrap();
    let run = cotorra(["run", "--headless", "--simulate", "--until", "20s", "--out"])
        .arg(out.path())
        .arg(corridor())
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let folder = fs::read_dir(out.path()).unwrap().next().unwrap().unwrap().path();
    let summary = serde_json::from_str(&fs::read_to_string(folder.join("summary.json")).unwrap()).unwrap();
    in_document(&summary, used.entry("summary.json").or_default());

    let swept = out.path().join("sweep");
    let sweep = cotorra(["sweep", "--headless", "--until", "5s", "--seeds", "1", "--out"])
        .arg(&swept)
        .arg(corridor())
        .output()
        .unwrap();
    assert!(sweep.status.success(), "{}", stdout(&sweep));
    let of_run = ["service_time.csv", "services.csv"].map(|table| folder.join(table));
    let of_sweep =
        ["runs.csv", "regions.csv", "services.csv", "time_parts.csv"].map(|table| swept.join(table));
    for table in of_run.iter().chain(&of_sweep) {
        let text = fs::read_to_string(table).unwrap();
        let heads = text.lines().next().unwrap().split(',').map(str::to_owned);
        let words = ["robot", "service", "attachment", "server", "part", "verdict", "sure", "void"];
        used.entry("tables").or_default().extend(heads.filter(|head| !words.contains(&head.as_str())));
    }

    let searched = out.path().join("margin");
    for (file, more) in [
        ("margins.json", &["--until", "5s", "--change", "delay,loss", "--on", "R1-cloud"][..]),
        ("decisions.json", &["--until", "15s", "--decision", "all", "--set", "plugin=okpi", "--seeds", "3"]),
        ("decisions.json", &["--until", "15s", "--decision", "1", "--set", "plugin=okpi", "--set", FAR]),
    ] {
        let mut margin = cotorra(["margin", "--headless", "--out"]);
        let margin =
            margin.arg(searched.join(file)).arg("--fresh").args(more).arg(corridor()).output().unwrap();
        assert!(margin.status.success(), "{}", stderr(&margin));
        let result = fs::read_to_string(searched.join(file).join(file)).unwrap();
        in_document(&serde_json::from_str(&result).unwrap(), used.entry("margins").or_default());
    }

    let forged = ForgedSummary::from(ForgedSources {
        node: "edge".parse().unwrap(),
        allowed: false,
        frames: ForgedFrames::default(),
    });
    let forged = serde_json::to_value(forged).unwrap();
    in_document(&forged, used.entry("summary.json").or_default());

    let (file, carried) = (out.path().join("carried.yaml"), out.path().join("carried"));
    fs::write(&file, CARRIED).unwrap();
    let run = cotorra(["run", "--headless", "--simulate", "--until", "2s", "--out"])
        .arg(&carried)
        .arg(&file)
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let folder = fs::read_dir(&carried).unwrap().next().unwrap().unwrap().path();
    let summary: Value =
        serde_json::from_str(&fs::read_to_string(folder.join("summary.json")).unwrap()).unwrap();
    in_document(&summary["traffic"], used.entry("summary.json").or_default());

    let runs = [
        ("busy", "1s", &PRICED[..], &["computing", "bill", "energy"][..]),
        ("warehouse-vla", "30s", &["currency=EUR", "nodes.edge.accelerators.cost=2"], &["inference", "bill"]),
    ];
    for (testbed, until, settings, parts) in runs {
        let to = out.path().join(testbed);
        let run = cotorra(["run", "--headless", "--simulate", "--until", until, "--out"])
            .arg(&to)
            .args(settings.iter().flat_map(|setting| ["--set", setting]))
            .arg(project_file(&format!("testbeds/{testbed}.yaml")))
            .output()
            .unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        let folder = fs::read_dir(&to).unwrap().next().unwrap().unwrap().path();
        let summary: Value =
            serde_json::from_str(&fs::read_to_string(folder.join("summary.json")).unwrap()).unwrap();
        for part in parts {
            in_document(&summary[part], used.entry("summary.json").or_default());
        }
    }

    let state = "{ size: 10 MB, migration: pre_copy, dirty_rate: 20 Mbit/s }";
    let (summary, _) = migrations::moved(&out.path().join("moved"), state);
    in_document(&summary["migrations"], used.entry("summary.json").or_default());

    let (mut found, mut lacking) = (BTreeSet::new(), Vec::new());
    for (place, names) in &used {
        for name in names.iter().filter(|name| !NO_QUANTITIES.contains(&name.as_str())) {
            if STATISTICS.contains(&name.as_str()) {
                continue;
            }
            match quantity(name, &fields) {
                Some(quantity) => drop(found.insert(quantity)),
                None => lacking.push(format!("`{name}` of {place}")),
            }
        }
    }
    assert!(lacking.is_empty(), "docs/reference/fields.md lacks {}", lacking.join(", "));
    let idle: Vec<_> = fields.keys().filter(|name| !found.contains(*name)).collect();
    assert!(idle.is_empty(), "nothing has the names {idle:?} of docs/reference/fields.md");
}

/// The dashboard has the units of figures as they are declared. `BLESS=1` writes them anew.
#[test]
fn the_dashboard_has_units_as_they_are_declared() {
    let path = project_file("crates/dashboard/page/units.js");
    let units = FIGURES.iter().map(|figure| format!("    {}: \"{}\",\n", figure.name, figure.unit.symbol()));
    let expected = format!(
        "// Units of figures, as cotorra-graph declares them. A test writes this file by BLESS=1.\n\nexport const UNITS = {{\n{}}};\n",
        units.collect::<String>()
    );
    if std::env::var_os("BLESS").is_some() {
        fs::write(path, expected).unwrap();
    } else {
        let page = fs::read_to_string(path).unwrap();
        assert!(page == expected, "the units are not what the code says: write them by BLESS=1");
    }
}

/// Figures that can be bounded are in the page as they are declared. `BLESS=1` writes the table anew.
#[test]
fn figures_and_kpis_are_documented_as_they_are_declared() {
    let mut table = "| figure | of | unit | better | meaning |\n|---|---|---|---|---|\n".to_owned();
    for figure in FIGURES {
        let of = figure.of.split(':').filter(|name| !name.is_empty()).map(|name| format!("`{name}`"));
        let of = of.collect::<Vec<_>>().join(", ");
        let unit = if figure.unit == cotorra_graph::Unit::Share { "%" } else { figure.unit.symbol() };
        let better = match figure.better {
            Better::Lower => "lower",
            Better::Higher => "higher",
            Better::Neither => "",
        };
        let one = if figure.kind == FigureKind::Total { " One number." } else { "" };
        table += &format!("| `{}` | {of} | {unit} | {better} | {}{one} |\n", figure.name, figure.about);
    }
    let path = project_file("docs/reference/testbed-file.md");
    let page = fs::read_to_string(&path).unwrap();
    let [begin, end] = ["<!-- figures: written by a test -->\n", "<!-- end of figures -->"];
    let (before, rest) = page.split_once(begin).unwrap();
    let (_, after) = rest.split_once(end).unwrap();
    let expected = format!("{before}{begin}\n{table}\n{end}{after}");
    if std::env::var_os("BLESS").is_some() {
        fs::write(path, expected).unwrap();
    } else {
        assert!(
            page == expected,
            "the table in docs/reference/testbed-file.md is not what the code says: write it by BLESS=1"
        );
    }
}
