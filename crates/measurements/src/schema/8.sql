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

-- Retries and airtime since a station joined, as its radio unit's kernel counts them; NULL: its driver does not report them, or no
-- agent drives the radio unit.
ALTER TABLE station ADD COLUMN retransmissions INTEGER;
ALTER TABLE station ADD COLUMN transmissions_failed INTEGER;
ALTER TABLE station ADD COLUMN transmit_airtime_ms REAL;
ALTER TABLE station ADD COLUMN receive_airtime_ms REAL;
