-- Time of the reading on the core's clock, and how much it is wrong by at most; NULL: unknown.
ALTER TABLE machine ADD COLUMN measured_ns INTEGER;
ALTER TABLE machine ADD COLUMN time_error_ms REAL;
