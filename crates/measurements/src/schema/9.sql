-- Name of the trace's file; NULL: it is in no file, or there is no trace.
ALTER TABLE conditions ADD COLUMN trace_file TEXT;

-- What robots know of radio units from earlier scans: a line for each radio unit of the robot's network, in order, with its signal,
-- dBm, the time at which the robot heard it, ns, and its name; `- -` if it did not, and for its own radio unit.
CREATE TABLE heard (
    id      INTEGER PRIMARY KEY,
    signals TEXT NOT NULL
);

-- NULL: all is in `attachment`. Otherwise, that has only what was heard since the context before.
ALTER TABLE robot ADD COLUMN heard INTEGER;

-- Time since the signal was received; NULL: unknown.
ALTER TABLE attachment ADD COLUMN signal_age_ms REAL;

-- Where the packets of a sample without an answer ended, as JSON; NULL: it was answered, or that is unknown.
ALTER TABLE service_time ADD COLUMN lost_at TEXT;
