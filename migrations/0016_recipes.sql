-- Recipes and specifications, by name. A change is a new version; the earlier ones stay, and scans stay linked to the
-- version that they used.
CREATE TABLE definitions (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    kind        TEXT NOT NULL CHECK (kind IN ('recipe', 'specification')),
    number      INTEGER NOT NULL,           -- within the kind: /recipes/7 is kind recipe, number 7
    name        TEXT NOT NULL,
    created_at  TEXT NOT NULL,
    UNIQUE (kind, number),
    UNIQUE (kind, name)
);

CREATE TABLE definition_versions (
    id            INTEGER PRIMARY KEY AUTOINCREMENT,
    definition_id INTEGER NOT NULL REFERENCES definitions(id),
    version       INTEGER NOT NULL,         -- from 1
    content       TEXT NOT NULL,            -- JSON with the keys of the TOML file
    who           TEXT NOT NULL,
    at            TEXT NOT NULL,
    UNIQUE (definition_id, version)
);

-- Archived definitions are not offered any more; the latest row counts.
CREATE TABLE definition_archivals (
    id            INTEGER PRIMARY KEY AUTOINCREMENT,
    definition_id INTEGER NOT NULL REFERENCES definitions(id),
    archived      INTEGER NOT NULL,         -- 1 archived, 0 restored
    who           TEXT NOT NULL,
    at            TEXT NOT NULL
);
CREATE INDEX definition_archivals_of_definition ON definition_archivals (definition_id, id);

CREATE TRIGGER definitions_kept BEFORE UPDATE ON definitions BEGIN SELECT RAISE(ABORT, 'definitions are never changed'); END;
CREATE TRIGGER definitions_stay BEFORE DELETE ON definitions BEGIN SELECT RAISE(ABORT, 'definitions are never deleted'); END;
CREATE TRIGGER definition_versions_kept BEFORE UPDATE ON definition_versions BEGIN SELECT RAISE(ABORT, 'versions are never changed'); END;
CREATE TRIGGER definition_versions_stay BEFORE DELETE ON definition_versions BEGIN SELECT RAISE(ABORT, 'versions are never deleted'); END;
CREATE TRIGGER definition_archivals_kept BEFORE UPDATE ON definition_archivals BEGIN SELECT RAISE(ABORT, 'archivals are never changed'); END;
CREATE TRIGGER definition_archivals_stay BEFORE DELETE ON definition_archivals BEGIN SELECT RAISE(ABORT, 'archivals are never deleted'); END;

-- What a scan was made for: NULL where it was not stated, as of all earlier scans.
ALTER TABLE scans ADD COLUMN recipe_version_id INTEGER REFERENCES definition_versions(id);
ALTER TABLE scans ADD COLUMN specification_version_id INTEGER REFERENCES definition_versions(id);
ALTER TABLE scans ADD COLUMN operator_name TEXT; -- the person at the rig
ALTER TABLE scans ADD COLUMN lot TEXT;
ALTER TABLE scans ADD COLUMN external_id TEXT;  -- number of the part or order in another system
