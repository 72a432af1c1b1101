-- What a reduction computes of each frame, so that no answer reads a frame again. Both tables are made of the frames: a
-- program that needs another form of the sums adds rows of its own, and rows that are missing are computed when they are
-- first needed.
CREATE TABLE calibration_sums (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    key         TEXT NOT NULL UNIQUE,       -- SHA-256 of camera, rig, white reference, layout, frames and form of the sums
    dark_frames TEXT NOT NULL,              -- JSON list of frame ids
    flat_frames TEXT NOT NULL,              -- JSON list of frame ids
    body        TEXT NOT NULL,              -- JSON: noise and levels of darks and flats, response by cell, frames left out
    program     TEXT NOT NULL,
    created_at  TEXT NOT NULL
);

CREATE TABLE frame_sums (
    calibration_id INTEGER NOT NULL REFERENCES calibration_sums(id),
    frame_id    INTEGER NOT NULL REFERENCES frames(id),
    part        TEXT NOT NULL,              -- sums (of the whole frame), sums REGION, exposures (of a pose), picture (of a board)
    body        TEXT NOT NULL,              -- JSON: per segment and cell the number of pixels and the powers of their counts; or why the frame is left out
    PRIMARY KEY (calibration_id, frame_id, part)
) WITHOUT ROWID;
CREATE INDEX frame_sums_of_frame ON frame_sums (frame_id);

CREATE TRIGGER calibration_sums_kept BEFORE UPDATE ON calibration_sums BEGIN SELECT RAISE(ABORT, 'sums are never changed'); END;
CREATE TRIGGER calibration_sums_stay BEFORE DELETE ON calibration_sums BEGIN SELECT RAISE(ABORT, 'sums are never deleted'); END;
CREATE TRIGGER frame_sums_kept BEFORE UPDATE ON frame_sums BEGIN SELECT RAISE(ABORT, 'sums are never changed'); END;
CREATE TRIGGER frame_sums_stay BEFORE DELETE ON frame_sums BEGIN SELECT RAISE(ABORT, 'sums are never deleted'); END;
