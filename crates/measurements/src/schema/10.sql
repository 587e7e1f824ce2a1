-- Ages of the contexts of one kind that a decision was taken on, when its instruction was carried out. The decision is the
-- plug-in's last before it.
CREATE TABLE staleness (
    run         INTEGER NOT NULL,
    at_ns       INTEGER NOT NULL,
    seq         INTEGER NOT NULL,
    plugin      INTEGER NOT NULL,
    kind        TEXT NOT NULL,
    contexts    INTEGER NOT NULL,
    youngest_ms REAL NOT NULL,
    oldest_ms   REAL NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- Requests of robots' brains for a federation.
CREATE TABLE federation_requested (
    run    INTEGER NOT NULL,
    at_ns  INTEGER NOT NULL,
    seq    INTEGER NOT NULL,
    robot  INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;
