-- The history of every embedding of G. Several runs share a database.
--
-- Units and conventions
--   *_ns      a moment: nanoseconds since the run began
--   seq       order of recording within the run; (at_ns, seq) orders all events of a run and names one of them
--   *_ms      a duration: milliseconds, exact to the nanosecond up to 26 days; *_us microseconds
--   *_m metres, *_dbm dBm, *_bps bit/s; all others as docs/reference/fields.md has them
--   names (of nodes, links, VNFs, services, plug-ins) are ids of rows in `name`
--   unsigned 64-bit figures are stored as the signed integer with the same bits
--   a figure that is no number (NaN) is NULL
--
-- Tables are clustered by (run, at_ns, seq): samples come in time order, so that writing only ever appends. What finds
-- one series among the others is `presence`.

-- One start of a testbed. ended_ns is NULL while it runs, and stays so when it was killed.
CREATE TABLE run (
    id                 INTEGER PRIMARY KEY,
    name               TEXT    NOT NULL,
    seed               INTEGER NOT NULL,
    started_at_unix_ns INTEGER NOT NULL, -- since 1970-01-01 UTC
    testbed            TEXT    NOT NULL, -- the testbed file as run
    ended_ns           INTEGER,
    next_seq           INTEGER NOT NULL
);

CREATE TABLE name (
    id   INTEGER PRIMARY KEY,
    text TEXT NOT NULL UNIQUE
);

-- In which stretches of 5 s a series has samples. A series is one robot (kind 0), radio unit (1), link and
-- direction (2), VNF's placement (3), virtual link's mapping (4) or robot and sensor (17); a is the id of its name, b its
-- direction or the id of its second name, or 0.
CREATE TABLE presence (
    run     INTEGER NOT NULL,
    kind    INTEGER NOT NULL,
    a       INTEGER NOT NULL,
    b       INTEGER NOT NULL,
    stretch INTEGER NOT NULL,          -- at_ns / 5e9, rounded down
    PRIMARY KEY (run, kind, a, b, stretch)
) WITHOUT ROWID;

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
    run             INTEGER NOT NULL,
    kind            INTEGER NOT NULL,
    rolled_up_to_ns INTEGER NOT NULL,
    step_ms         REAL    NOT NULL,
    dropped_to_ns   INTEGER NOT NULL,
    PRIMARY KEY (run, kind)
) WITHOUT ROWID;

-- Events that were lost: between at_ns and until_ns so many could not be kept.
CREATE TABLE gap (
    run      INTEGER NOT NULL,
    at_ns    INTEGER NOT NULL,
    seq      INTEGER NOT NULL,
    until_ns INTEGER NOT NULL,
    events   INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- κ(r): σ(r) here, φ(r,R) in `attachment`.
-- Sources of a pose: 0 simulator, 1 odometry, 2 localization. cov_* are the row-major covariance of (x, y, heading).
CREATE TABLE robot (
    run                INTEGER NOT NULL,
    at_ns              INTEGER NOT NULL,
    seq                INTEGER NOT NULL,
    robot              INTEGER NOT NULL,
    waypoint           INTEGER NOT NULL,
    x                  REAL,
    y                  REAL,
    heading            REAL,
    cov_xx             REAL,
    cov_xy             REAL,
    cov_xh             REAL,
    cov_yx             REAL,
    cov_yy             REAL,
    cov_yh             REAL,
    cov_hx             REAL,
    cov_hy             REAL,
    cov_hh             REAL,
    source             INTEGER NOT NULL,
    odometry_x         REAL,
    odometry_y         REAL,
    odometry_heading   REAL,
    odometry_cov_xx    REAL,
    odometry_cov_xy    REAL,
    odometry_cov_xh    REAL,
    odometry_cov_yx    REAL,
    odometry_cov_yy    REAL,
    odometry_cov_yh    REAL,
    odometry_cov_hx    REAL,
    odometry_cov_hy    REAL,
    odometry_cov_hh    REAL,
    odometry_source    INTEGER NOT NULL,
    "linear"           REAL,
    angular            REAL,
    bumper             INTEGER NOT NULL,
    nearest_obstacle_m REAL,            -- NULL: nothing in range
    health             TEXT,            -- faults, spaces between: as `absent`, `silent` or `flood`; NULL: none
    z                  REAL,            -- above the floor
    roll               REAL,
    pitch              REAL,
    odometry_z         REAL,
    odometry_roll      REAL,
    odometry_pitch     REAL,
    vertical           REAL,            -- upward
    speed_limit_mps    REAL,            -- that an instruction set; NULL: none
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- φ(r,R) of the robot context with the same key, in its order.
CREATE TABLE attachment (
    run        INTEGER NOT NULL,
    at_ns      INTEGER NOT NULL,
    seq        INTEGER NOT NULL,
    place      INTEGER NOT NULL,
    radio_unit INTEGER NOT NULL,
    attached   INTEGER NOT NULL,
    signal_dbm REAL,                   -- NULL: not heard yet
    PRIMARY KEY (run, at_ns, seq, place)
) WITHOUT ROWID;

-- ι(R); its stations are in `station`.
CREATE TABLE radio (
    run        INTEGER NOT NULL,
    at_ns      INTEGER NOT NULL,
    seq        INTEGER NOT NULL,
    radio_unit INTEGER NOT NULL,
    channel    INTEGER NOT NULL,
    "load"     REAL,                   -- share of the last second, 0 to 1
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

CREATE TABLE station (
    run          INTEGER NOT NULL,
    at_ns        INTEGER NOT NULL,
    seq          INTEGER NOT NULL,
    place        INTEGER NOT NULL,
    robot        INTEGER NOT NULL,
    signal_dbm   REAL,
    downlink_bps REAL,
    uplink_bps   REAL,
    PRIMARY KEY (run, at_ns, seq, place)
) WITHOUT ROWID;

-- d, λ, ψ, δ of one direction (0 forward, 1 backward) of a link. Counters count from the run's beginning. The last
-- columns are what active measurements told: of probes, and of the last test of the throughput. Each figure's age when
-- it was told stands beside it; NULL where nothing was measured.
CREATE TABLE link (
    run                   INTEGER NOT NULL,
    at_ns                 INTEGER NOT NULL,
    seq                   INTEGER NOT NULL,
    link                  INTEGER NOT NULL,
    direction             INTEGER NOT NULL,
    delay_ms              REAL,            -- d; NULL: nothing crossed
    throughput_bps        REAL,            -- λ
    delay_scale           REAL,            -- ψ
    drop_scale            REAL,            -- δ
    asked                 INTEGER NOT NULL, -- row of `conditions`
    effective             INTEGER NOT NULL, -- row of `conditions`
    packets               INTEGER NOT NULL,
    bytes                 INTEGER NOT NULL,
    lost                  INTEGER NOT NULL,
    overflowed            INTEGER NOT NULL,
    duplicated            INTEGER NOT NULL,
    corrupted             INTEGER NOT NULL,
    probed_delay_ms       REAL,
    probed_jitter_ms      REAL,
    probed_delay_age_ms   REAL,            -- of the jitter, too
    probed_loss           REAL,            -- share, 0 to 1
    probed_loss_age_ms    REAL,
    tested_throughput_bps REAL,            -- what came out
    tested_offered_bps    REAL,            -- what was sent
    tested_age_ms         REAL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- Conditions that links had; written when they change, shared by the samples in between.
CREATE TABLE conditions (
    id                  INTEGER PRIMARY KEY,
    delay_ms            REAL NOT NULL,
    jitter_deviation_ms REAL,            -- NULL: no jitter
    jitter_distribution TEXT,            -- uniform, normal, pareto
    loss                TEXT    NOT NULL, -- none, independent, bursty
    loss_share          REAL,
    loss_mean_burst     REAL,            -- packets
    duplication         REAL    NOT NULL, -- shares, 0 to 1
    corruption          REAL    NOT NULL,
    reordering          REAL    NOT NULL,
    rate_bps            INTEGER,         -- NULL without a trace: unlimited
    trace_ms            TEXT,            -- JSON array: Mahimahi's delivery opportunities
    queue_packets       INTEGER,         -- one of the two is set
    queue_bytes         INTEGER
);

-- a(n).
CREATE TABLE placement (
    run   INTEGER NOT NULL,
    at_ns INTEGER NOT NULL,
    seq   INTEGER NOT NULL,
    vnf   INTEGER NOT NULL,
    node  INTEGER NOT NULL,            -- of several instances, that of the first
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- Of several instances: nodes of all but the first.
CREATE TABLE replica_node (
    run   INTEGER NOT NULL,
    at_ns INTEGER NOT NULL,
    seq   INTEGER NOT NULL,
    place INTEGER NOT NULL,
    node  INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq, place)
) WITHOUT ROWID;

-- a(n1,n2); the links are in `hop`, in order.
CREATE TABLE virtual_link (
    run      INTEGER NOT NULL,
    at_ns    INTEGER NOT NULL,
    seq      INTEGER NOT NULL,
    from_vnf INTEGER NOT NULL,
    to_vnf   INTEGER NOT NULL,
    path     TEXT    NOT NULL,         -- shortest, mapped, fallback
    others   TEXT,                     -- between other instances, as in JSON
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

CREATE TABLE hop (
    run   INTEGER NOT NULL,
    at_ns INTEGER NOT NULL,
    seq   INTEGER NOT NULL,
    place INTEGER NOT NULL,
    link  INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq, place)
) WITHOUT ROWID;

CREATE TABLE service_time (
    run             INTEGER NOT NULL,
    at_ns           INTEGER NOT NULL,
    seq             INTEGER NOT NULL,
    service         INTEGER NOT NULL,
    robot           INTEGER NOT NULL,
    sequence        INTEGER NOT NULL,
    emitted_ns      INTEGER NOT NULL,
    service_time_ms REAL,              -- NULL: no answer in time
    attachment      INTEGER,
    server          INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

CREATE TABLE handover (
    run             INTEGER NOT NULL,
    at_ns           INTEGER NOT NULL,
    seq             INTEGER NOT NULL,
    robot           INTEGER NOT NULL,
    from_radio_unit INTEGER,
    to_radio_unit   INTEGER NOT NULL,
    fast            INTEGER NOT NULL,
    gap_ms          REAL NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

CREATE TABLE detached (
    run             INTEGER NOT NULL,
    at_ns           INTEGER NOT NULL,
    seq             INTEGER NOT NULL,
    robot           INTEGER NOT NULL,
    from_radio_unit INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

CREATE TABLE scanned (
    run   INTEGER NOT NULL,
    at_ns INTEGER NOT NULL,
    seq   INTEGER NOT NULL,
    robot INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- Life cycle of a VNF's process: started, died, stopped, failed.
CREATE TABLE vnf (
    run    INTEGER NOT NULL,
    at_ns  INTEGER NOT NULL,
    seq    INTEGER NOT NULL,
    vnf    INTEGER NOT NULL,
    node   INTEGER NOT NULL,
    state  TEXT    NOT NULL,
    detail TEXT,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- What a plug-in asked for. subject is the robot, VNF or link; object the radio unit or node that it shall get.
CREATE TABLE decision (
    run         INTEGER NOT NULL,
    at_ns       INTEGER NOT NULL,
    seq         INTEGER NOT NULL,
    plugin      INTEGER NOT NULL,
    instruction TEXT    NOT NULL,      -- move, limit_speed, navigate_to, report, scan, attach, place, map, condition
    subject     INTEGER NOT NULL,
    object      INTEGER,
    "linear"    REAL,                  -- of limit_speed: the limit; NULL: none
    angular     REAL,
    waypoint    INTEGER,
    direction   INTEGER,               -- NULL: both
    "change"    TEXT,                  -- JSON: the wished change of conditions, goal, or values
    reason      TEXT,
    refused     TEXT,                  -- NULL: it was done
    vertical    REAL,                  -- of a move
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

CREATE TABLE plugin_fault (
    run    INTEGER NOT NULL,
    at_ns  INTEGER NOT NULL,
    seq    INTEGER NOT NULL,
    plugin INTEGER NOT NULL,
    reason TEXT    NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- How late the emulator delivered, from the run's beginning.
CREATE TABLE lateness (
    run    INTEGER NOT NULL,
    at_ns  INTEGER NOT NULL,
    seq    INTEGER NOT NULL,
    frames INTEGER NOT NULL,
    p50_us REAL,
    p99_us REAL,
    max_us REAL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

CREATE TABLE walk_finished (
    run   INTEGER NOT NULL,
    at_ns INTEGER NOT NULL,
    seq   INTEGER NOT NULL,
    robot INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- What became of a goal that a robot was given.
CREATE TABLE goal (
    run         INTEGER NOT NULL,
    at_ns       INTEGER NOT NULL,
    seq         INTEGER NOT NULL,
    robot       INTEGER NOT NULL,
    x           REAL,
    y           REAL,
    z           REAL,
    state       TEXT    NOT NULL,       -- set, progress, reached, replaced, canceled, failed
    remaining_m REAL,                   -- of the way, of progress
    reason      TEXT,                   -- of a failure
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- What a sensor of a robot read; the numbers are in `sensor_value`, by the names of their components. The last five columns
-- are those of large data, whose bytes are in files of the run's folder.
CREATE TABLE sensor (
    run         INTEGER NOT NULL,
    at_ns       INTEGER NOT NULL,
    seq         INTEGER NOT NULL,
    robot       INTEGER NOT NULL,
    sensor      INTEGER NOT NULL,
    measured_ns INTEGER NOT NULL,       -- or reported
    sequence    INTEGER,                -- of the sensor's readings, from 0
    format      TEXT,                   -- scan, mono8, rgb8, jpeg, png
    width       INTEGER,                -- columns of an image, rays of a scan
    height      INTEGER,                -- rows of an image; 1 of a scan
    bytes       INTEGER,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

CREATE TABLE sensor_value (
    run       INTEGER NOT NULL,
    at_ns     INTEGER NOT NULL,
    seq       INTEGER NOT NULL,
    place     INTEGER NOT NULL,
    component INTEGER NOT NULL,
    "value"   REAL,
    PRIMARY KEY (run, at_ns, seq, place)
) WITHOUT ROWID;

CREATE TABLE notice (
    run     INTEGER NOT NULL,
    at_ns   INTEGER NOT NULL,
    seq     INTEGER NOT NULL,
    message TEXT    NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- Answers that a robot did not follow, counted since the run began.
CREATE TABLE answers_rejected (
    run       INTEGER NOT NULL,
    at_ns     INTEGER NOT NULL,
    seq       INTEGER NOT NULL,
    robot     INTEGER NOT NULL,
    late      INTEGER NOT NULL,
    forged    INTEGER NOT NULL,
    repeated  INTEGER NOT NULL,
    unknown   INTEGER NOT NULL,
    invalid   INTEGER NOT NULL,
    redundant INTEGER NOT NULL,
    PRIMARY KEY (run, at_ns, seq)
) WITHOUT ROWID;

-- How many batches of a process have been taken in, if it had to spool them because its server was away: what was
-- taken in is not taken in again. Of use to servers only.
CREATE TABLE spool (
    writer  TEXT    NOT NULL UNIQUE,
    batches INTEGER NOT NULL
);
