-- The context of a node's machine; its interfaces are in `machine_interface`. It is the series of kind 18 in `presence`,
-- with a the id of the node's name. What the machine does not offer is NULL.
CREATE TABLE machine (
    run                 INTEGER NOT NULL,
    at_ns               INTEGER NOT NULL,
    seq                 INTEGER NOT NULL,
    node                INTEGER NOT NULL,
    cpus                INTEGER,         -- online
    cpu_busy            REAL,            -- share since the last reading, 0 to 1; NULL at the first
    one_minute          REAL,            -- load averages
    five_minutes        REAL,
    fifteen_minutes     REAL,
    memory_bytes        INTEGER,
    available_bytes     INTEGER,         -- to new programs
    interfaces_left_out INTEGER NOT NULL,
    wifi_left_out       INTEGER NOT NULL,
    wifi                TEXT,            -- Wi-Fi interfaces, as in JSON; NULL: none
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- Interfaces of the machine context with the same key, in its order. Traffic counts since the interface exists;
-- throughput is that since the last reading, NULL at the first.
CREATE TABLE machine_interface (
    run                     INTEGER NOT NULL,
    at_ns                   INTEGER NOT NULL,
    seq                     INTEGER NOT NULL,
    place                   INTEGER NOT NULL,
    interface               INTEGER NOT NULL,
    up                      INTEGER NOT NULL,
    carrier                 INTEGER NOT NULL,
    speed_bps               INTEGER,     -- NULL: unknown to its driver
    mtu_bytes               INTEGER NOT NULL,
    received_packets        INTEGER NOT NULL,
    received_bytes          INTEGER NOT NULL,
    received_errors         INTEGER NOT NULL,
    received_dropped        INTEGER NOT NULL,
    received_throughput_bps REAL,
    sent_packets            INTEGER NOT NULL,
    sent_bytes              INTEGER NOT NULL,
    sent_errors             INTEGER NOT NULL,
    sent_dropped            INTEGER NOT NULL,
    sent_throughput_bps     REAL,
    PRIMARY KEY (run, at_ns, seq, place)
) WITHOUT ROWID;
