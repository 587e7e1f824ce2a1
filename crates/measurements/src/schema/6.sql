-- Discipline of the queue with its parameters, as JSON; NULL: drop tail.
ALTER TABLE conditions ADD COLUMN queue_discipline TEXT;
