-- Answers of robots to their radio units' suggestions to move. The status is that of IEEE 802.11-2020, table 9-428.
CREATE TABLE suggestion_answered (
    run        INTEGER NOT NULL,
    at_ns      INTEGER NOT NULL,
    seq        INTEGER NOT NULL,
    robot      INTEGER NOT NULL,
    radio_unit INTEGER NOT NULL,
    status     INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;
