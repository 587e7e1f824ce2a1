-- Correlation of a packet's jitter with that of the next packet; NULL: none.
ALTER TABLE conditions ADD COLUMN jitter_correlation REAL;
