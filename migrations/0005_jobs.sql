-- Fits, maps, contrasts, verdicts and traces are jobs in one table. Rows move; their numbers stay.
CREATE TABLE jobs (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    kind        TEXT NOT NULL CHECK (kind IN ('fit', 'map', 'contrast', 'verdict', 'trace')),
    number      INTEGER NOT NULL,           -- within the kind: /fits/7 is kind fit, number 7
    scan_id     INTEGER REFERENCES scans(id), -- NULL for a trace, which needs no scan
    variant     TEXT,                       -- requested; NULL for kinds without one
    request     TEXT NOT NULL,              -- JSON of the request as the client sent it
    options     TEXT,                       -- JSON of all options of a fit with their defaults; NULL for other kinds
    program     TEXT NOT NULL,
    created_at  TEXT NOT NULL,
    UNIQUE (kind, number),
    CHECK (scan_id IS NOT NULL OR kind = 'trace')
);
CREATE INDEX jobs_of_scan ON jobs (scan_id, kind, number);

CREATE TABLE job_ends (
    job_id      INTEGER PRIMARY KEY REFERENCES jobs(id),
    state       TEXT NOT NULL CHECK (state IN ('completed', 'failed', 'cancelled', 'interrupted')),
    set_id      INTEGER REFERENCES observation_sets(id), -- the observations of a fit
    result      TEXT,                       -- JSON as the command of that name prints it; files are below maps/NUMBER/ and traces/NUMBER/
    variant     TEXT,                       -- chosen by a fit
    status      TEXT,                       -- of a fit: converged, at-bound, …
    theta_r_deg REAL,                       -- of a fit, for searching; NULL where not identifiable
    error_code  TEXT,
    error_detail TEXT,
    at          TEXT NOT NULL
);

-- Ordered by time, so that the id of a job grows with its age across the kinds. Fits of the oldest programs have no
-- request among their options; it is made of the columns. A damaged row stays damaged.
INSERT INTO jobs (kind, number, scan_id, variant, request, options, program, created_at)
SELECT kind, number, scan_id, variant, request, options, program, created_at FROM (
    SELECT 'fit' AS kind, id AS number, scan_id, variant,
        CASE json_valid(options) WHEN 1 THEN COALESCE(json_extract(options, '$.request'),
            json_object('scan_id', scan_id, 'variant', variant, 'region', region)) ELSE options END AS request,
        CASE json_valid(options) WHEN 1 THEN json_remove(options, '$.request') ELSE options END AS options,
        program, created_at
    FROM fits
    UNION ALL
    SELECT kind, id, scan_id, CASE WHEN kind = 'verdict' AND json_valid(request) THEN json_extract(request, '$.variant') END,
        request, NULL, program, created_at
    FROM calculations
) ORDER BY created_at, kind, number;

INSERT INTO job_ends (job_id, state, set_id, result, variant, status, theta_r_deg, error_code, error_detail, at)
SELECT j.id, e.state, e.set_id, e.report, e.variant, e.status, e.theta_r_deg, e.error_code, e.error_detail, e.at
FROM fit_ends e JOIN jobs j ON j.kind = 'fit' AND j.number = e.fit_id;

INSERT INTO job_ends (job_id, state, result, error_code, error_detail, at)
SELECT j.id, e.state, e.result, e.error_code, e.error_detail, e.at
FROM calculation_ends e JOIN jobs j ON j.kind <> 'fit' AND j.number = e.calculation_id;

DROP TABLE fit_ends;
DROP TABLE fits;
DROP TABLE calculation_ends;
DROP TABLE calculations;

CREATE TRIGGER jobs_kept BEFORE UPDATE ON jobs BEGIN SELECT RAISE(ABORT, 'jobs are never changed'); END;
CREATE TRIGGER jobs_stay BEFORE DELETE ON jobs BEGIN SELECT RAISE(ABORT, 'jobs are never deleted'); END;
CREATE TRIGGER job_ends_kept BEFORE UPDATE ON job_ends BEGIN SELECT RAISE(ABORT, 'jobs are never changed'); END;
CREATE TRIGGER job_ends_stay BEFORE DELETE ON job_ends BEGIN SELECT RAISE(ABORT, 'jobs are never deleted'); END;
