-- How many batches of a process have been taken in, if it had to spool them because its server was away: what was
-- taken in is not taken in again. Of use to servers only.
CREATE TABLE spool (
    writer  TEXT    NOT NULL UNIQUE,
    batches INTEGER NOT NULL
);
