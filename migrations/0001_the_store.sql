-- The store of one lab. Rows are only ever added: the triggers at the end refuse every change and
-- every deletion of what was measured, decided or told. A state is the latest row of a log, never a
-- field that is overwritten. Times are RFC 3339 UTC text with milliseconds (readable in any tool,
-- sorts like time); they label and never order: order is by id. Angles are degrees because stages
-- and people speak degrees; the unit is the end of every name.

CREATE TABLE samples (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    name        TEXT NOT NULL,              -- what people call it; not unique, batches repeat names
    material    TEXT NOT NULL,              -- JSON {kind, eta, eta_std[, k, k_std]}: the fit needs the index and its uncertainty
    note        TEXT,                       -- free text of the lab
    simulated   TEXT,                       -- JSON: how a simulated rig paints it; NULL for a real one
    created_at  TEXT NOT NULL
);

-- A rig as it was when something was measured with it. A changed setting is a new row, so an old
-- scan keeps the rig it was made with.
CREATE TABLE rigs (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    settings    TEXT NOT NULL UNIQUE,       -- canonical JSON: stages (limits, zeros, backlash), camera's description, geometry, white reference
    created_at  TEXT NOT NULL
);

CREATE TABLE scans (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    sample_id   INTEGER NOT NULL REFERENCES samples(id),
    rig_id      INTEGER REFERENCES rigs(id),-- NULL for an imported series: its rig is in the manifest
    origin      TEXT NOT NULL CHECK (origin IN ('rig', 'import')),
    name        TEXT NOT NULL,              -- series name in an export
    plan        TEXT,                       -- JSON of the whole plan, nothing left to defaults; NULL for an import
    manifest    TEXT NOT NULL,              -- manifest.toml as a reduction reads it (an import's own text, byte for byte)
    frames_csv  TEXT,                       -- an import's frames.csv, byte for byte, so that an export is bit-equal; NULL for a scan
    program     TEXT NOT NULL,              -- program and version that made it
    created_at  TEXT NOT NULL
);

-- One row per state a scan was in; the latest is its state.
CREATE TABLE scan_states (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    scan_id     INTEGER NOT NULL REFERENCES scans(id),
    state       TEXT NOT NULL,
    reason      TEXT,                       -- why, where it is not the plan's own course
    operator    TEXT,                       -- what a person has to do, while waiting for it
    at          TEXT NOT NULL
);
CREATE INDEX scan_states_of_scan ON scan_states (scan_id, id);

-- A set of dark or white-reference frames that more than one scan may use.
CREATE TABLE calibrations (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    kind        TEXT NOT NULL CHECK (kind IN ('dark', 'flat')),
    scan_id     INTEGER NOT NULL REFERENCES scans(id), -- the scan that took the frames
    rig_id      INTEGER NOT NULL REFERENCES rigs(id),  -- frames of another rig or camera setting do not count
    exposures_s TEXT NOT NULL,              -- JSON list, ascending: a scan needs all of its own among them
    theta_c_deg TEXT NOT NULL,              -- JSON list, ascending; empty for dark frames
    n_frames    INTEGER NOT NULL,
    created_at  TEXT NOT NULL               -- age counts from here
);

-- Which calibrations a scan uses, its own included.
CREATE TABLE scan_calibrations (
    scan_id        INTEGER NOT NULL REFERENCES scans(id),
    calibration_id INTEGER NOT NULL REFERENCES calibrations(id),
    PRIMARY KEY (scan_id, calibration_id)
) WITHOUT ROWID;

-- One visit to a point of the plan: frames and verified angles, committed together or not at all.
CREATE TABLE shots (
    id             INTEGER PRIMARY KEY AUTOINCREMENT,
    scan_id        INTEGER NOT NULL REFERENCES scans(id),
    plan_index     INTEGER NOT NULL,        -- place in the plan, from 0
    attempt        INTEGER NOT NULL,        -- 0, then one more for each retake
    kind           TEXT NOT NULL CHECK (kind IN ('sample', 'dark', 'flat')),
    asked_theta_c_deg REAL,                 -- what the plan asked for; NULL where the pose does not matter
    asked_phi_s_deg   REAL,
    theta_c_deg    REAL NOT NULL,           -- position read back from the stage
    phi_s_deg      REAL NOT NULL,           -- position read back, in the turn the plan states
    accepted       INTEGER NOT NULL,        -- 1 if it counts; a rejected visit is kept and redone
    reason         TEXT,                    -- why it does not count
    taken_at       TEXT NOT NULL
);
CREATE INDEX shots_of_scan ON shots (scan_id, plan_index);

CREATE TABLE frames (
    id           INTEGER PRIMARY KEY AUTOINCREMENT,
    scan_id      INTEGER NOT NULL REFERENCES scans(id),
    shot_id      INTEGER REFERENCES shots(id),   -- NULL for an import, whose poses are its own record
    name         TEXT NOT NULL,             -- file name in a series
    kind         TEXT NOT NULL CHECK (kind IN ('sample', 'dark', 'flat')),
    theta_c_deg  REAL NOT NULL,             -- position read back
    phi_s_deg    REAL NOT NULL,
    exposure_s   REAL NOT NULL,
    repeat       INTEGER NOT NULL,          -- from 0
    timestamp    TEXT NOT NULL,             -- UTC, start of exposure, as the camera's clock or the series says
    sha256       TEXT NOT NULL,             -- of the PNG file; also its name: frames/ab/cdef….png
    bytes        INTEGER NOT NULL,          -- size of the file, to find a truncated one without reading it
    width_px     INTEGER NOT NULL,
    height_px    INTEGER NOT NULL,
    mean_dn      REAL NOT NULL,             -- for lists and quick checks; the file is the record
    max_dn       INTEGER NOT NULL,
    saturated_px INTEGER NOT NULL,          -- pixels at or above the camera's saturation level
    accepted     INTEGER NOT NULL,
    reason       TEXT
);
CREATE INDEX frames_of_scan ON frames (scan_id, id);
CREATE INDEX frames_by_file ON frames (sha256);

-- A reduction of a scan (or of one region of it): everything a fit reads.
CREATE TABLE observation_sets (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    scan_id     INTEGER NOT NULL REFERENCES scans(id),
    region      TEXT,                       -- NULL for the whole frame
    context     TEXT NOT NULL,              -- JSON: rig, material, flats, white reference, background prior, region azimuth, frames used and rejected, warnings
    last_frame_id INTEGER NOT NULL,         -- newest frame it knows: a later frame makes it out of date
    program     TEXT NOT NULL,
    created_at  TEXT NOT NULL
);
CREATE INDEX observation_sets_of_scan ON observation_sets (scan_id, id);

CREATE TABLE observations (
    set_id          INTEGER NOT NULL REFERENCES observation_sets(id),
    position        INTEGER NOT NULL,       -- order within the set, from 0
    theta_c_deg     REAL NOT NULL,
    phi_s_deg       REAL NOT NULL,
    signal          REAL NOT NULL,          -- radiance for lamp irradiance 1 (arbitrary unit without white reference)
    sigma           REAL NOT NULL,          -- own standard uncertainty, same unit
    white_reference REAL NOT NULL,          -- change of signal per standard uncertainty of the reference: common to all
    led_drift       REAL NOT NULL,          -- change of signal per standard uncertainty of the lamp: common to all
    theta_c_zero_deg REAL NOT NULL,         -- standard uncertainty of the tilt's zero beyond what the fit solves for
    phi_s_zero_deg  REAL NOT NULL,          -- the same for the azimuth
    n_frames        INTEGER NOT NULL,
    PRIMARY KEY (set_id, position)
) WITHOUT ROWID;

-- A fit with all its inputs; how it ended is in fit_ends.
CREATE TABLE fits (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    scan_id     INTEGER NOT NULL REFERENCES scans(id),
    variant     TEXT NOT NULL,              -- asked for: auto, paper, sawtooth, …
    region      TEXT,
    options     TEXT NOT NULL,              -- JSON: number of starts, seed, bounds as given
    program     TEXT NOT NULL,
    created_at  TEXT NOT NULL
);
CREATE INDEX fits_of_scan ON fits (scan_id, id);

CREATE TABLE fit_ends (
    fit_id      INTEGER PRIMARY KEY REFERENCES fits(id),
    state       TEXT NOT NULL CHECK (state IN ('completed', 'failed', 'cancelled', 'interrupted')),
    set_id      INTEGER REFERENCES observation_sets(id), -- the observations it was made of
    report      TEXT,                       -- JSON as `fit --json` prints it
    variant     TEXT,                       -- chosen
    status      TEXT,                       -- converged, at-bound, …
    theta_r_deg REAL,                       -- for searching; NULL where not identifiable
    error_code  TEXT,
    error_detail TEXT,
    at          TEXT NOT NULL
);

-- The story, numbered: what page and log saw.
CREATE TABLE events (
    id      INTEGER PRIMARY KEY AUTOINCREMENT,
    at      TEXT NOT NULL,
    kind    TEXT NOT NULL,                  -- rig, scan, frame, fit, alarm
    scan_id INTEGER,
    body    TEXT NOT NULL                   -- JSON
);

CREATE INDEX events_of_scan ON events (scan_id, id);

-- Answers to requests that carried an Idempotency-Key: the same request again gets the same answer.
CREATE TABLE idempotency_keys (
    key         TEXT PRIMARY KEY,
    request     TEXT NOT NULL,              -- SHA-256 of method, path and body: the same key for something else is an error
    status      INTEGER NOT NULL,
    location    TEXT,
    body        TEXT NOT NULL,
    at          TEXT NOT NULL
) WITHOUT ROWID;

CREATE TRIGGER samples_kept BEFORE UPDATE ON samples BEGIN SELECT RAISE(ABORT, 'samples are never changed'); END;
CREATE TRIGGER samples_stay BEFORE DELETE ON samples BEGIN SELECT RAISE(ABORT, 'samples are never deleted'); END;
CREATE TRIGGER rigs_kept BEFORE UPDATE ON rigs BEGIN SELECT RAISE(ABORT, 'rigs are never changed'); END;
CREATE TRIGGER rigs_stay BEFORE DELETE ON rigs BEGIN SELECT RAISE(ABORT, 'rigs are never deleted'); END;
CREATE TRIGGER scans_kept BEFORE UPDATE ON scans BEGIN SELECT RAISE(ABORT, 'scans are never changed'); END;
CREATE TRIGGER scans_stay BEFORE DELETE ON scans BEGIN SELECT RAISE(ABORT, 'scans are never deleted'); END;
CREATE TRIGGER scan_states_kept BEFORE UPDATE ON scan_states BEGIN SELECT RAISE(ABORT, 'states are never changed'); END;
CREATE TRIGGER scan_states_stay BEFORE DELETE ON scan_states BEGIN SELECT RAISE(ABORT, 'states are never deleted'); END;
CREATE TRIGGER calibrations_kept BEFORE UPDATE ON calibrations BEGIN SELECT RAISE(ABORT, 'calibrations are never changed'); END;
CREATE TRIGGER calibrations_stay BEFORE DELETE ON calibrations BEGIN SELECT RAISE(ABORT, 'calibrations are never deleted'); END;
CREATE TRIGGER shots_kept BEFORE UPDATE ON shots BEGIN SELECT RAISE(ABORT, 'shots are never changed'); END;
CREATE TRIGGER shots_stay BEFORE DELETE ON shots BEGIN SELECT RAISE(ABORT, 'shots are never deleted'); END;
CREATE TRIGGER frames_kept BEFORE UPDATE ON frames BEGIN SELECT RAISE(ABORT, 'frames are never changed'); END;
CREATE TRIGGER frames_stay BEFORE DELETE ON frames BEGIN SELECT RAISE(ABORT, 'frames are never deleted'); END;
CREATE TRIGGER observation_sets_kept BEFORE UPDATE ON observation_sets BEGIN SELECT RAISE(ABORT, 'observations are never changed'); END;
CREATE TRIGGER observation_sets_stay BEFORE DELETE ON observation_sets BEGIN SELECT RAISE(ABORT, 'observations are never deleted'); END;
CREATE TRIGGER observations_kept BEFORE UPDATE ON observations BEGIN SELECT RAISE(ABORT, 'observations are never changed'); END;
CREATE TRIGGER observations_stay BEFORE DELETE ON observations BEGIN SELECT RAISE(ABORT, 'observations are never deleted'); END;
CREATE TRIGGER fits_kept BEFORE UPDATE ON fits BEGIN SELECT RAISE(ABORT, 'fits are never changed'); END;
CREATE TRIGGER fits_stay BEFORE DELETE ON fits BEGIN SELECT RAISE(ABORT, 'fits are never deleted'); END;
CREATE TRIGGER fit_ends_kept BEFORE UPDATE ON fit_ends BEGIN SELECT RAISE(ABORT, 'fits are never changed'); END;
CREATE TRIGGER fit_ends_stay BEFORE DELETE ON fit_ends BEGIN SELECT RAISE(ABORT, 'fits are never deleted'); END;
CREATE TRIGGER events_kept BEFORE UPDATE ON events BEGIN SELECT RAISE(ABORT, 'events are never changed'); END;
CREATE TRIGGER events_stay BEFORE DELETE ON events BEGIN SELECT RAISE(ABORT, 'events are never deleted'); END;
