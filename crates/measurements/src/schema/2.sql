-- How many batches of a process have been taken in, if it had to spool them because its server was away: what was
-- taken in is not taken in again. Of use to servers only.
CREATE TABLE spool (
    writer  TEXT    NOT NULL UNIQUE,
    batches INTEGER NOT NULL
);

-- Figures of a series in one of its stretches, column by column: an hour of one link is read without the rows of all
-- others. A stretch without one is read from the rows. How `samples` is written is in `chunk.rs`.
CREATE TABLE chunk (
    run     INTEGER NOT NULL,
    kind    INTEGER NOT NULL,
    a       INTEGER NOT NULL,
    b       INTEGER NOT NULL,
    stretch INTEGER NOT NULL,
    samples BLOB    NOT NULL,
    PRIMARY KEY (run, kind, a, b, stretch)
) WITHOUT ROWID;
