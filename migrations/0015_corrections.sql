-- The name of a sample and the sample of a scan can be corrected. What was stored first stays, and so does each
-- correction; the newest one counts.
CREATE TABLE sample_names (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    sample_id   INTEGER NOT NULL REFERENCES samples(id),
    name        TEXT NOT NULL,
    at          TEXT NOT NULL
);
CREATE INDEX sample_names_of_sample ON sample_names (sample_id, id);

CREATE TABLE scan_samples (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    scan_id     INTEGER NOT NULL REFERENCES scans(id),
    sample_id   INTEGER NOT NULL REFERENCES samples(id),
    manifest    TEXT NOT NULL,              -- manifest.toml as a reduction reads it, with the material of this sample
    at          TEXT NOT NULL
);
CREATE INDEX scan_samples_of_scan ON scan_samples (scan_id, id);

CREATE TRIGGER sample_names_kept BEFORE UPDATE ON sample_names BEGIN SELECT RAISE(ABORT, 'names of samples are never changed'); END;
CREATE TRIGGER sample_names_stay BEFORE DELETE ON sample_names BEGIN SELECT RAISE(ABORT, 'names of samples are never deleted'); END;
CREATE TRIGGER scan_samples_kept BEFORE UPDATE ON scan_samples BEGIN SELECT RAISE(ABORT, 'samples of scans are never changed'); END;
CREATE TRIGGER scan_samples_stay BEFORE DELETE ON scan_samples BEGIN SELECT RAISE(ABORT, 'samples of scans are never deleted'); END;

-- What counts now.
CREATE VIEW sample_now AS
SELECT p.id AS sample_id,
    COALESCE((SELECT n.name FROM sample_names n WHERE n.sample_id = p.id ORDER BY n.id DESC LIMIT 1), p.name) AS name
FROM samples p;

CREATE VIEW scan_now AS
SELECT s.id AS scan_id,
    COALESCE((SELECT a.sample_id FROM scan_samples a WHERE a.scan_id = s.id ORDER BY a.id DESC LIMIT 1), s.sample_id) AS sample_id,
    COALESCE((SELECT a.manifest FROM scan_samples a WHERE a.scan_id = s.id ORDER BY a.id DESC LIMIT 1), s.manifest) AS manifest
FROM scans s;
