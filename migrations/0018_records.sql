-- Tags, note and archived flag of a scan. Each change is a row with the whole record after it; the newest row counts.
CREATE TABLE scan_records (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    scan_id     INTEGER NOT NULL REFERENCES scans(id),
    tags        TEXT NOT NULL,              -- JSON list
    note        TEXT,
    archived    INTEGER NOT NULL,           -- 1: left out of lists
    who         TEXT NOT NULL,
    at          TEXT NOT NULL
);
CREATE INDEX scan_records_of_scan ON scan_records (scan_id, id);

CREATE TRIGGER scan_records_kept BEFORE UPDATE ON scan_records BEGIN SELECT RAISE(ABORT, 'records of scans are never changed'); END;
CREATE TRIGGER scan_records_stay BEFORE DELETE ON scan_records BEGIN SELECT RAISE(ABORT, 'records of scans are never deleted'); END;
