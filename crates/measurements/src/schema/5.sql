-- The most packets that waited at a time over the last second; NULL: the queue cannot be seen.
ALTER TABLE link ADD COLUMN queued_packets INTEGER;
