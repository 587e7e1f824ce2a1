-- What active measurements told: of probes, and of the last test of the throughput. Each figure's age when it was told
-- stands beside it; NULL where nothing was measured.
ALTER TABLE link ADD COLUMN probed_delay_ns INTEGER;
ALTER TABLE link ADD COLUMN probed_jitter_ns INTEGER;
ALTER TABLE link ADD COLUMN probed_delay_age_ns INTEGER;  -- of the jitter, too
ALTER TABLE link ADD COLUMN probed_loss REAL;             -- share, 0 to 1
ALTER TABLE link ADD COLUMN probed_loss_age_ns INTEGER;
ALTER TABLE link ADD COLUMN tested_bps REAL;              -- what came out
ALTER TABLE link ADD COLUMN tested_offered_bps REAL;      -- what was sent
ALTER TABLE link ADD COLUMN tested_age_ns INTEGER;
