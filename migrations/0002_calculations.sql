-- What is worked out from scans beside fits: maps, contrasts, verdicts, traces. Like fits, they are
-- begun with all their inputs and end once; nothing is ever changed or deleted.
CREATE TABLE calculations (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    kind        TEXT NOT NULL CHECK (kind IN ('map', 'contrast', 'verdict', 'trace')),
    scan_id     INTEGER REFERENCES scans(id), -- NULL for a trace, which needs no scan
    request     TEXT NOT NULL,              -- JSON of all that was asked for
    program     TEXT NOT NULL,
    created_at  TEXT NOT NULL
);
CREATE INDEX calculations_by_kind ON calculations (kind, id);

CREATE TABLE calculation_ends (
    calculation_id INTEGER PRIMARY KEY REFERENCES calculations(id),
    state       TEXT NOT NULL CHECK (state IN ('completed', 'failed', 'cancelled', 'interrupted')),
    result      TEXT,                       -- JSON as the command of that name prints it; a map's files lie below maps/ID/
    error_code  TEXT,
    error_detail TEXT,
    at          TEXT NOT NULL
);

CREATE TRIGGER calculations_kept BEFORE UPDATE ON calculations BEGIN SELECT RAISE(ABORT, 'calculations are never changed'); END;
CREATE TRIGGER calculations_stay BEFORE DELETE ON calculations BEGIN SELECT RAISE(ABORT, 'calculations are never deleted'); END;
CREATE TRIGGER calculation_ends_kept BEFORE UPDATE ON calculation_ends BEGIN SELECT RAISE(ABORT, 'calculations are never changed'); END;
CREATE TRIGGER calculation_ends_stay BEFORE DELETE ON calculation_ends BEGIN SELECT RAISE(ABORT, 'calculations are never deleted'); END;
