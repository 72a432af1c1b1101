-- What the camera's program stated about a frame: counter, start of the exposure, settings read back, serial number, temperature.
-- A table of its own, so that a program reads the frames of a store that an older one wrote.
CREATE TABLE frame_tags (
    frame_id    INTEGER PRIMARY KEY REFERENCES frames(id),
    tag         TEXT NOT NULL               -- JSON; a frame of which nothing was stated has no row
);
CREATE TRIGGER frame_tags_kept BEFORE UPDATE ON frame_tags BEGIN SELECT RAISE(ABORT, 'frames are never changed'); END;
CREATE TRIGGER frame_tags_stay BEFORE DELETE ON frame_tags BEGIN SELECT RAISE(ABORT, 'frames are never deleted'); END;

-- A frame that was accepted may turn out not to count: a reference pose that is visited again shows that the stage slipped since.
-- Nothing else about it changes.
DROP TRIGGER frames_kept;
CREATE TRIGGER frames_kept BEFORE UPDATE ON frames
WHEN NOT (OLD.accepted = 1 AND NEW.accepted = 0 AND NEW.reason IS NOT NULL
    AND OLD.id = NEW.id AND OLD.scan_id = NEW.scan_id AND OLD.shot_id IS NEW.shot_id AND OLD.name = NEW.name
    AND OLD.kind = NEW.kind AND OLD.theta_c_deg = NEW.theta_c_deg AND OLD.phi_s_deg = NEW.phi_s_deg
    AND OLD.exposure_s = NEW.exposure_s AND OLD.repeat = NEW.repeat AND OLD.timestamp = NEW.timestamp
    AND OLD.sha256 = NEW.sha256 AND OLD.bytes = NEW.bytes AND OLD.width_px = NEW.width_px
    AND OLD.height_px = NEW.height_px AND OLD.mean_dn = NEW.mean_dn AND OLD.max_dn = NEW.max_dn
    AND OLD.saturated_px = NEW.saturated_px AND OLD.original_sha256 IS NEW.original_sha256)
BEGIN SELECT RAISE(ABORT, 'frames are never changed'); END;

DROP TRIGGER shots_kept;
CREATE TRIGGER shots_kept BEFORE UPDATE ON shots
WHEN NOT (OLD.accepted = 1 AND NEW.accepted = 0 AND NEW.reason IS NOT NULL
    AND OLD.id = NEW.id AND OLD.scan_id = NEW.scan_id AND OLD.plan_index = NEW.plan_index AND OLD.attempt = NEW.attempt
    AND OLD.kind = NEW.kind AND OLD.asked_theta_c_deg IS NEW.asked_theta_c_deg AND OLD.asked_phi_s_deg IS NEW.asked_phi_s_deg
    AND OLD.theta_c_deg = NEW.theta_c_deg AND OLD.phi_s_deg = NEW.phi_s_deg AND OLD.taken_at = NEW.taken_at)
BEGIN SELECT RAISE(ABORT, 'shots are never changed'); END;
