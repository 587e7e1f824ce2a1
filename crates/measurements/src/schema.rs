//! The schema of a history. A version is a file of SQL for SQLite; types, keys and storage that MySQL and MariaDB spell
//! differently are replaced here.

/// Migrations from each schema version to the next, the first from an empty database. Never edit one that was released:
/// append another.
pub(crate) const MIGRATIONS: &[&str] = &[
    include_str!("schema/1.sql"),
    include_str!("schema/2.sql"),
    include_str!("schema/3.sql"),
    include_str!("schema/4.sql"),
    include_str!("schema/5.sql"),
    include_str!("schema/6.sql"),
    include_str!("schema/7.sql"),
    include_str!("schema/8.sql"),
    include_str!("schema/9.sql"),
    include_str!("schema/10.sql"),
];

/// Length of a stretch of `presence`, ns.
pub(crate) const STRETCH: i64 = 5_000_000_000;

/// Replacements for a server, in the order in which they are made.
#[cfg(feature = "databases")]
const REPLACEMENTS: &[(&str, &str)] = &[
    // A migration that was killed half-way goes on where it was: a server commits each statement by itself.
    ("CREATE TABLE", "CREATE TABLE IF NOT EXISTS"),
    ("INTEGER PRIMARY KEY", "BIGINT AUTO_INCREMENT PRIMARY KEY"),
    ("INTEGER", "BIGINT"),
    ("REAL", "DOUBLE"),
    // The longest name has 128 characters of at most 4 bytes. Bytes are compared one by one, as SQLite compares text. A
    // server takes texts for equal that differ only in spaces at their end.
    ("TEXT NOT NULL UNIQUE", "VARBINARY(760) NOT NULL UNIQUE"),
    ("TEXT", "LONGTEXT"),
    ("BLOB", "LONGBLOB"),
    ("WITHOUT ROWID", ""),
];

/// Returns a migration as single statements for MySQL and MariaDB, in a session with `ANSI_QUOTES`.
#[cfg(feature = "databases")]
pub(crate) fn for_server(migration: &str) -> Vec<String> {
    let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
    let without_comments = migration.lines().map(|line| words(line.split("--").next().unwrap_or_default()));
    let text = without_comments.collect::<Vec<_>>().join("\n");
    let statements = text.split(';').map(str::trim).filter(|statement| !statement.is_empty());
    let translate = |statement: &str| {
        let translated =
            REPLACEMENTS.iter().fold(statement.to_owned(), |sql, (here, there)| sql.replace(here, there));
        match translated.starts_with("CREATE TABLE") {
            true => {
                format!("{} ENGINE = InnoDB CHARACTER SET utf8mb4 COLLATE utf8mb4_bin", translated.trim_end())
            }
            false => translated.trim_end().to_owned(),
        }
    };
    statements.map(translate).collect()
}

#[cfg(all(test, feature = "databases"))]
mod tests {
    use super::*;

    #[test]
    fn a_migration_is_translated_for_servers() {
        let statements = for_server(MIGRATIONS[0]);
        assert!(statements.iter().all(|statement| statement.starts_with("CREATE TABLE IF NOT EXISTS ")));
        assert_eq!(
            for_server(
                "-- Later.\nALTER TABLE robot ADD COLUMN mood TEXT;\nALTER TABLE link ADD COLUMN cost REAL; -- euro\n"
            ),
            ["ALTER TABLE robot ADD COLUMN mood LONGTEXT", "ALTER TABLE link ADD COLUMN cost DOUBLE"]
        );
        assert_eq!(
            statements[1],
            "CREATE TABLE IF NOT EXISTS name (\nid BIGINT AUTO_INCREMENT PRIMARY KEY,\ntext VARBINARY(760) NOT NULL UNIQUE\n) \
             ENGINE = InnoDB CHARACTER SET utf8mb4 COLLATE utf8mb4_bin"
        );
    }
}
