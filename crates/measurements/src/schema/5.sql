-- The most packets that waited at a time over the last second; NULL: the queue cannot be seen.
ALTER TABLE link ADD COLUMN queued_packets INTEGER;

-- Distance between the pose of localization and the true one; NULL: nobody localizes the robot, or nobody knows the truth.
ALTER TABLE robot ADD COLUMN localization_error_m REAL;
