//! Files that somebody made so that who reads them hangs, fills the memory, or runs statements of theirs.

use rusqlite::Connection;

use super::*;

/// Returns a history with one run, changed by these statements.
fn changed(sql: &str) -> (TempDir, PathBuf) {
    let (folder, path) = folder();
    let history = History::open(&path).unwrap();
    let run = history.begin_run(&run_info("hostile")).unwrap();
    let recorder = history.paced_recorder(run).unwrap();
    recorder.record(notice(1, "one"));
    recorder.flush().unwrap();
    drop((recorder, history));
    Connection::open(&path).unwrap().execute_batch(sql).unwrap();
    (folder, path)
}

/// A query without an end.
const ENDLESS: &str = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n)";

#[test]
fn a_file_with_more_than_a_history_is_rejected_at_once() {
    let view = format!(
        "ALTER TABLE notice RENAME TO hidden;
         CREATE VIEW notice AS {ENDLESS} SELECT x AS run, x AS at_ns, x AS seq, 'x' AS message FROM n;"
    );
    let trigger = format!(
        "CREATE TRIGGER more AFTER INSERT ON run BEGIN INSERT INTO name(text) SELECT x FROM ({ENDLESS} SELECT x FROM n); END;"
    );
    let check =
        "ALTER TABLE notice ADD COLUMN mine TEXT CHECK (mine IS NULL OR length(randomblob(1000000000)) > 0);";
    let virtual_table = "PRAGMA writable_schema = ON;
         INSERT INTO sqlite_schema(type, name, tbl_name, rootpage, sql)
         VALUES ('table', 'more', 'more', 0, 'CREATE VIRTUAL TABLE more USING csv(filename=''/etc/passwd'')');";
    for (sql, object) in [
        (view.as_str(), "table `hidden`"),
        (&trigger, "trigger `more`"),
        (check, "table `notice`"),
        (virtual_table, "table `more`"),
        ("CREATE TABLE mine (x)", "table `mine`"),
        ("CREATE INDEX mine ON notice(message)", "index `mine`"),
        ("DROP TABLE notice", "table `notice`"),
        ("PRAGMA user_version = 1", "table"),
    ] {
        let (_folder, path) = changed(sql);
        for refused in [Sqlite::open(&path), Sqlite::open_to_read(&path)] {
            let Err(error) = refused else { panic!("{sql} is taken") };
            assert!(matches!(error, Error::Foreign { .. }), "{error}");
            assert!(error.to_string().contains(object), "{error}");
        }
    }
}

#[test]
fn statistics_of_sqlite_are_no_strangers() {
    let (_folder, path) = changed("ANALYZE");
    History::open(&path).unwrap();
}

#[test]
fn a_huge_value_is_rejected_without_reading_it() {
    let (_folder, path) = changed("UPDATE run SET testbed = CAST(zeroblob(100000000) AS TEXT)");
    let history = History::open(&path).unwrap();
    let error = history.runs(None, 10).unwrap_err().to_string();
    assert!(error.contains("a value has more than 64 MiB"), "{error}");
}

#[test]
fn a_statement_without_an_end_is_ended() {
    let mut connection = Connection::open_in_memory().unwrap();
    let steps = guard::guard(&mut connection, Some(1000)).unwrap();
    let session = SqliteSession::new(connection, &"hostile".into(), steps);
    let error = sql::Session::rows(&session, &format!("{ENDLESS} SELECT count(*) FROM n"), &[]).unwrap_err();
    assert!(error.to_string().contains("more steps than any of a history"), "{error}");
    // The next statement has its own steps.
    sql::Session::rows(&session, "SELECT 1", &[]).unwrap();
}

#[test]
fn memory_of_sqlite_is_bounded() {
    let mut connection = Connection::open_in_memory().unwrap();
    let steps = guard::guard(&mut connection, None).unwrap();
    let session = SqliteSession::new(connection, &"hostile".into(), steps);
    let most: i64 = session.connection.pragma_query_value(None, "hard_heap_limit", |row| row.get(0)).unwrap();
    assert_eq!(most, 512 << 20);
    let sql = "SELECT randomblob(1000000000)";
    let error = sql::Session::rows(&session, sql, &[]).unwrap_err().to_string();
    assert!(error.contains("a value has more than 64 MiB"), "{error}");
}

#[test]
fn a_pipe_is_no_history() {
    let (_folder, path) = folder();
    let made = std::process::Command::new("mkfifo").arg(&path).status().unwrap();
    assert!(made.success());
    assert!(matches!(refusal(&path), Error::NotAHistory { .. }));
}

#[test]
fn no_damaged_file_makes_a_reader_panic() {
    let (_folder, path) = changed("SELECT 1");
    let whole = fs::read(&path).unwrap();
    let (_other, damaged) = folder();
    for bytes in cotorra_testing::mutations(&whole).take(150) {
        fs::write(&damaged, bytes).unwrap();
        let Ok(store) = Sqlite::open_to_read(&damaged) else { continue };
        for run in store.runs(None, 100).unwrap_or_default() {
            let span = Span { from: i64::MIN, until: i64::MAX };
            let _ = (store.latest(run.id, i64::MAX), store.gaps(run.id, span, PageRequest::default()));
        }
        drop(store);
        for ending in ["-wal", "-shm"] {
            let _ = fs::remove_file(with_ending(&damaged, ending));
        }
    }
}
