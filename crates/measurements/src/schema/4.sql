-- What is left of samples that were rolled up: the figures of steps of time, by the stretch in which the last sample of
-- the step is, which stays a row of its table. Rows of the stretch whose seq is below next_seq are in these figures. How
-- `steps` is written is in `rolled.rs`.
CREATE TABLE rolled_up (
    run      INTEGER NOT NULL,
    kind     INTEGER NOT NULL,
    a        INTEGER NOT NULL,
    b        INTEGER NOT NULL,
    stretch  INTEGER NOT NULL,
    next_seq INTEGER NOT NULL,
    steps    BLOB    NOT NULL,
    PRIMARY KEY (run, kind, a, b, stretch)
) WITHOUT ROWID;

-- How far samples of a kind (as in `presence`) were rolled up, and how far there is nothing left of them.
CREATE TABLE retained (
    run              INTEGER NOT NULL,
    kind             INTEGER NOT NULL,
    rolled_up_to_ns  INTEGER NOT NULL,
    step_ns          INTEGER NOT NULL,
    dropped_to_ns    INTEGER NOT NULL,
    PRIMARY KEY (run, kind)
) WITHOUT ROWID;
