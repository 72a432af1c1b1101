-- Which controllers a rig has. The newest row of a rig counts: the first is written at the first connection, each further one
-- when a person accepts other controllers.
CREATE TABLE rig_stages (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    rig_id      INTEGER NOT NULL REFERENCES rigs(id),
    identity    TEXT NOT NULL,              -- JSON {theta_c: {serial, device_id, firmware}, phi_s: {…}}
    origin      TEXT NOT NULL CHECK (origin IN ('first-connection', 'accepted')),
    created_at  TEXT NOT NULL
);
CREATE INDEX rig_stages_of_rig ON rig_stages (rig_id, id);

-- The controllers of a scan: those it began with, then those it continued with.
CREATE TABLE scan_stages (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    scan_id     INTEGER NOT NULL REFERENCES scans(id),
    stages_id   INTEGER NOT NULL REFERENCES rig_stages(id),
    created_at  TEXT NOT NULL
);
CREATE INDEX scan_stages_of_scan ON scan_stages (scan_id, id);

CREATE TRIGGER rig_stages_kept BEFORE UPDATE ON rig_stages BEGIN SELECT RAISE(ABORT, 'the controllers of a rig are never changed'); END;
CREATE TRIGGER rig_stages_stay BEFORE DELETE ON rig_stages BEGIN SELECT RAISE(ABORT, 'the controllers of a rig are never deleted'); END;
CREATE TRIGGER scan_stages_kept BEFORE UPDATE ON scan_stages BEGIN SELECT RAISE(ABORT, 'the controllers of a scan are never changed'); END;
CREATE TRIGGER scan_stages_stay BEFORE DELETE ON scan_stages BEGIN SELECT RAISE(ABORT, 'the controllers of a scan are never deleted'); END;
