-- Parts of a service time, in the order of the way: sender, links, vnf, links back, receiver, unknown. A part that is a
-- link has a direction. Parts other than `vnf` that took no time are left out. A sample without any has unknown parts.
CREATE TABLE time_part (
    run         INTEGER NOT NULL,
    at_ns       INTEGER NOT NULL,
    seq         INTEGER NOT NULL,
    place       INTEGER NOT NULL,
    part        INTEGER NOT NULL,
    direction   INTEGER,               -- 0 forward, 1 backward
    total_ms    REAL    NOT NULL,
    queueing_ms REAL,                  -- of a link; NULL: none
    retries_ms  REAL,                  -- of a link; NULL: none
    PRIMARY KEY (run, at_ns, seq, place)
) WITHOUT ROWID;
