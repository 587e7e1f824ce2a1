use cotorra_graph::Stamped;
use proptest::{collection::vec, prelude::*};

use super::*;
use crate::{
    Gap, Kind,
    codec::{Fields, Value},
    run::Entry,
    testing::{notice, run_info, stamped},
};
use table::{Cell, Shape, Type};

fn formats() -> impl Iterator<Item = Format> {
    Format::ALL.into_iter().filter(|format| cfg!(feature = "databases") || *format == Format::Csv)
}

#[test]
fn a_stopped_import_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let history = History::in_memory().unwrap();
    let run = history.begin_run(&run_info("out")).unwrap();
    let entries: Vec<_> = (0..12_000).map(|n| Entry { run, stamped: notice(n, "again") }).collect();
    history.store.append(&entries, &[]).unwrap();
    let out = folder.path().join("exported");
    history.export(run, Format::Csv, &out, |_| true).unwrap();
    let other = History::open(folder.path().join("history.sqlite")).unwrap();
    let stopped = other.import(&out, |events| events < 10_000);
    assert!(matches!(stopped, Err(ExportError::Stopped(10_000))));
    assert_eq!(other.runs(None, 10).unwrap(), []);
    let (run, events) = other.import(&out, |_| true).unwrap();
    assert_eq!(
        (events, all(|page| other.events(run, &[], ..notice(9000, "").at, page)).len()),
        (12_000, 9000)
    );
}

fn all<T>(mut page: impl FnMut(PageRequest) -> crate::Result<crate::Page<T>>) -> Vec<T> {
    let page = page(PageRequest::first(PageRequest::MAX)).unwrap();
    assert_eq!(page.next, None);
    page.items
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn exported_and_imported_histories_give_the_same_answers(
        events in vec(stamped(), 0..60),
        gaps in vec((0..1000_u64, 0..1000_u64, 1..9_u64), 0..3),
        ended: bool,
    ) {
        let events: Vec<_> = events.into_iter().filter(Stamped::is_storable).collect();
        let history = History::in_memory().unwrap();
        let run = history.begin_run(&run_info("out")).unwrap();
        let entries: Vec<_> = events.into_iter().map(|stamped| Entry { run, stamped }).collect();
        let t = Timestamp::from_nanos;
        let gaps: Vec<_> = gaps
            .into_iter()
            .map(|(from, long, events)| (run, Gap { from: t(from), until: t(from + long), events }))
            .collect();
        history.store.append(&entries, &gaps).unwrap();
        if ended {
            history.end_run(run, t(5)).unwrap();
        }
        for format in formats() {
            let folder = tempfile::tempdir().unwrap();
            let out = folder.path().join("exported");
            prop_assert_eq!(history.export(run, format, &out, |_| true).unwrap(), entries.len() as u64);
            let other = History::in_memory().unwrap();
            let (read, count) = other.import(&out, |_| true).unwrap();
            prop_assert_eq!(count, entries.len() as u64);
            let (before, after) = (history.run(run).unwrap(), other.run(read).unwrap());
            prop_assert_eq!((before.info, before.ended), (after.info, after.ended));
            prop_assert_eq!(
                all(|page| history.events(run, &[], .., page)),
                all(|page| other.events(read, &[], .., page)),
                "{}", format
            );
            prop_assert_eq!(all(|page| history.gaps(run, .., page)), all(|page| other.gaps(read, .., page)));
        }
    }

    #[test]
    fn every_figure_is_of_its_columns_type(event in stamped()) {
        let kind = Kind::of(&event.event);
        let (mut row, mut children) = (Fields::default(), Fields::default());
        event.put(&mut row, &mut children);
        let check = |values: &[Value<'_>], columns: &[(&'static str, Type)]| {
            assert_eq!(values.len(), columns.len());
            for (value, (name, of)) in values.iter().zip(columns) {
                let fits = match value {
                    Value::Null => true,
                    Value::Integer(code) => match of {
                        Type::Name(names) => (0..names.len() as i64).contains(code),
                        of => *of == Type::Integer,
                    },
                    Value::Conditions(..) | Value::Heard(_) => *of == Type::Integer,
                    Value::Real(_) => *of == Type::Real,
                    Value::Text(_) | Value::Name(_) => *of == Type::Text,
                };
                assert!(fits, "{name} of {kind:?} is {of:?}, not {value:?}");
            }
        };
        check(&row.0, &Shape::of(kind).columns[2..]);
        if let Some(shape) = Shape::children(kind) {
            children.0.chunks(shape.columns.len() - 2).for_each(|child| check(child, &shape.columns[2..]));
        }
    }
}

fn exported(format: Format) -> (tempfile::TempDir, PathBuf) {
    let history = History::in_memory().unwrap();
    let run = history.begin_run(&run_info("out")).unwrap();
    let entry = |t| Entry { run, stamped: notice(t, "with, \"quotes\"\nand lines") };
    history.store.append(&[entry(1), entry(2)], &[]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("exported");
    history.export(run, format, &out, |_| true).unwrap();
    (folder, out)
}

#[test]
fn tables_suit_other_programs() {
    let (_folder, out) = exported(Format::Csv);
    let text = fs::read_to_string(out.join("notice.csv")).unwrap();
    assert_eq!(
        text,
        "n,at_ns,message\n0,1,\"with, \"\"quotes\"\"\nand lines\"\n1,2,\"with, \"\"quotes\"\"\nand lines\"\n"
    );
}

#[test]
fn codes_have_names_in_tables() {
    for (kind, column, code, name) in [
        (Kind::Link, "direction", 1, "backward"),
        (Kind::Decision, "direction", 0, "forward"),
        (Kind::Robot, "source", 0, "simulator"),
        (Kind::Robot, "odometry_source", 1, "odometry"),
    ] {
        let shape = Shape::of(kind);
        let place = shape.columns.iter().position(|(name, _)| *name == column).unwrap();
        let mut cells = vec![Cell::Null; shape.columns.len()];
        cells[place] = Cell::Integer(code);
        shape.name(&mut cells);
        assert_eq!(cells[place], Cell::Text(name.to_owned()));
        shape.code(&mut cells).unwrap();
        assert_eq!(cells[place], Cell::Integer(code));
        cells[place] = Cell::Text("up".to_owned());
        let unknown = shape.code(&mut cells).unwrap_err();
        assert!(unknown.starts_with(&format!("`up` in column {column} is none of ")), "{unknown}");
    }
}

#[test]
fn folders_that_are_no_export_are_rejected_with_the_file() {
    let history = History::in_memory().unwrap();
    let refusal = |out: &Path| history.import(out, |_| true).unwrap_err().to_string();
    let (_folder, out) = exported(Format::Csv);
    let run = history.import(&out, |_| true).unwrap().0;
    assert!(matches!(history.export(run, Format::Csv, &out, |_| true), Err(ExportError::Taken(_))));
    let table = out.join("notice.csv");
    for (text, problem) in [
        ("n,message\n", "line 1: its columns are not n,at_ns,message"),
        ("n,at_ns,message\n0,1\n", "line 2: 2 fields, not 3"),
        ("n,at_ns,message\n0,x,y\n", "line 2: expected a number"),
        ("n,at_ns,message\n0,1,\"y\n", "line 2: a quote is not closed"),
        ("n,at_ns,message\n0,1,\"y\"z\n", "line 2: quotes are out of place"),
        ("n,at_ns,message\n0,-1,y\n", "event 0 has no time"),
        ("n,at_ns,message\n0,1,\n", "a required column is NULL"),
        ("n,at_ns,message\n0,1,y\n", "says 2 events, but the tables have 1"),
    ] {
        fs::write(&table, text).unwrap();
        let message = refusal(&out);
        assert!(message.contains(problem), "{text:?}: {message}");
    }
    let note = fs::read_to_string(out.join(NOTE)).unwrap();
    for other in [5, 9] {
        fs::write(out.join(NOTE), note.replace("\"version\": 6", &format!("\"version\": {other}"))).unwrap();
        let message = refusal(&out);
        assert!(
            message.contains(&format!("has version {other} of the format, but this cotorra reads version 6")),
            "{message}"
        );
    }
    fs::remove_file(out.join(NOTE)).unwrap();
    assert!(refusal(&out).contains("has no run.json"));
}
