-- Who started a scan or a job, and who caused an event: the name of a token, `local` (a caller on this machine without one) or
-- `daemon`. Everything before this column came from this machine; who caused an old event is not known.
ALTER TABLE scans ADD COLUMN who TEXT NOT NULL DEFAULT 'local';
ALTER TABLE jobs ADD COLUMN who TEXT NOT NULL DEFAULT 'local';
ALTER TABLE events ADD COLUMN who TEXT;
