-- One short row per scan of a sample, for lists and searches; one per region where the sample has several. The row has the
-- newest completed fit and the newest verdict. The triggers below make it of the rows of the other tables, so that it can
-- be made again at any time. Every query reads the table once from end to end, which 100,000 rows permit, so it needs no
-- index.
CREATE TABLE results (
    scan_id             INTEGER NOT NULL REFERENCES scans(id),
    region              TEXT NOT NULL,      -- empty for the whole sample
    sample_id           INTEGER NOT NULL,   -- that the scan is assigned to now
    part                TEXT NOT NULL,      -- the sample's name now
    lot                 TEXT,
    recipe              TEXT,               -- name and version that the scan was started with
    recipe_version      INTEGER,
    external_id         TEXT,
    operator_name       TEXT,
    material            TEXT,               -- dielectric or conductor
    eta                 REAL,               -- index of refraction n + ik of the sample
    k                   REAL,
    origin              TEXT NOT NULL,
    who                 TEXT NOT NULL,
    state               TEXT NOT NULL,
    created_at          TEXT NOT NULL,
    ended_at            TEXT,               -- NULL while the scan can go on
    fit_id              INTEGER,            -- number of the fit
    fitted_at           TEXT,
    variant             TEXT,
    status              TEXT,
    theta_r_deg         REAL,               -- NULL where the data do not determine it; so the other parameters
    theta_r_deg_std     REAL,               -- k = 1
    theta_r_deg_expanded REAL,
    coverage_factor     REAL,
    alpha_u             REAL,
    alpha_u_std         REAL,
    alpha_v             REAL,
    alpha_v_std         REAL,
    rho_d               REAL,
    rho_d_std           REAL,
    scale               REAL,
    scale_std           REAL,
    background          REAL,
    background_std      REAL,
    azimuth_offset_deg  REAL,
    azimuth_offset_deg_std REAL,
    tilt_offset_deg     REAL,
    tilt_offset_deg_std REAL,
    translucency        REAL,
    translucency_std    REAL,
    crest_radius        REAL,
    crest_radius_std    REAL,
    rms_residual        REAL,
    verdict_id          INTEGER,            -- number of the verdict
    verdict             TEXT,
    specification       TEXT,
    archived            INTEGER NOT NULL,   -- 1: left out of lists
    tags                TEXT,               -- JSON list; NULL without tags
    note                TEXT,
    PRIMARY KEY (scan_id, region)
) WITHOUT ROWID;

-- The rows as they should be. A result that is not JSON is damaged; its fields are NULL.
CREATE VIEW result_now AS
SELECT scan_id, region, sample_id, part, lot, recipe, recipe_version, external_id, operator_name,
    material ->> '$.kind' AS material, material ->> '$.eta' AS eta, COALESCE(material ->> '$.k', 0) AS k,
    origin, who, state, created_at, ended_at, fit_id, fitted_at, variant, status,
    report ->> '$.parameters.theta_r_deg.value', report ->> '$.parameters.theta_r_deg.std',
    report ->> '$.parameters.theta_r_deg.expanded', report ->> '$.parameters.theta_r_deg.coverage_factor',
    report ->> '$.parameters.alpha_u.value', report ->> '$.parameters.alpha_u.std',
    report ->> '$.parameters.alpha_v.value', report ->> '$.parameters.alpha_v.std',
    report ->> '$.parameters.rho_d.value', report ->> '$.parameters.rho_d.std',
    report ->> '$.parameters.scale.value', report ->> '$.parameters.scale.std',
    report ->> '$.parameters.background.value', report ->> '$.parameters.background.std',
    report ->> '$.parameters.azimuth_offset_deg.value', report ->> '$.parameters.azimuth_offset_deg.std',
    report ->> '$.parameters.tilt_offset_deg.value', report ->> '$.parameters.tilt_offset_deg.std',
    report ->> '$.parameters.translucency.value', report ->> '$.parameters.translucency.std',
    report ->> '$.parameters.crest_radius.value', report ->> '$.parameters.crest_radius.std',
    report ->> '$.rms_residual',
    verdict_id, judgement ->> '$.verdict', judgement ->> '$.specification',
    archived, tags, note
FROM (
    SELECT s.id AS scan_id, COALESCE(f.region, '') AS region, w.sample_id AS sample_id, n.name AS part,
        s.lot AS lot, d.name AS recipe, r.version AS recipe_version, s.external_id AS external_id,
        s.operator_name AS operator_name,
        CASE WHEN json_valid(p.material) THEN p.material END AS material,
        s.origin AS origin, s.who AS who, t.state AS state, s.created_at AS created_at,
        CASE WHEN t.state IN ('completed', 'aborted', 'failed') THEN t.at END AS ended_at,
        f.number AS fit_id, fe.at AS fitted_at, fe.variant AS variant, fe.status AS status,
        CASE WHEN json_valid(fe.result) THEN fe.result END AS report,
        v.number AS verdict_id,
        CASE WHEN json_valid(ve.result) THEN ve.result END AS judgement,
        COALESCE(c.archived, 0) AS archived, NULLIF(c.tags, '[]') AS tags, c.note AS note
    FROM scans s
    JOIN scan_now w ON w.scan_id = s.id
    JOIN sample_now n ON n.sample_id = w.sample_id
    JOIN samples p ON p.id = w.sample_id
    LEFT JOIN definition_versions r ON r.id = s.recipe_version_id
    LEFT JOIN definitions d ON d.id = r.definition_id
    JOIN scan_states t ON t.id = (SELECT MAX(id) FROM scan_states WHERE scan_id = s.id)
    LEFT JOIN scan_records c ON c.id = (SELECT MAX(id) FROM scan_records WHERE scan_id = s.id)
    LEFT JOIN job_region f ON f.scan_id = s.id AND f.kind = 'fit' AND f.id = (
        SELECT MAX(j.id) FROM job_region j JOIN job_ends e ON e.job_id = j.id
        WHERE j.scan_id = s.id AND j.kind = 'fit' AND j.region = f.region AND e.state = 'completed')
    LEFT JOIN job_ends fe ON fe.job_id = f.id
    LEFT JOIN jobs v ON v.id = (
        SELECT MAX(j.id) FROM job_region j JOIN job_ends e ON e.job_id = j.id
        WHERE j.scan_id = s.id AND j.kind = 'verdict' AND j.region = COALESCE(f.region, '') AND e.state = 'completed')
    LEFT JOIN job_ends ve ON ve.job_id = v.id
    -- A scan for calibrations only has no sample.
    WHERE s.plan IS NULL OR (json_valid(s.plan) AND s.plan ->> '$.repeats' > 0)
);

-- The region that a fit or verdict was asked for; empty for the whole sample.
CREATE VIEW job_region AS
SELECT id, kind, number, scan_id,
    CASE WHEN json_valid(request) THEN COALESCE(request ->> '$.region', '') ELSE '' END AS region
FROM jobs;

INSERT INTO results SELECT * FROM result_now;

CREATE TRIGGER results_of_scans AFTER INSERT ON scan_states BEGIN
    DELETE FROM results WHERE scan_id = NEW.scan_id;
    INSERT INTO results SELECT * FROM result_now WHERE scan_id = NEW.scan_id;
END;
CREATE TRIGGER results_of_assignments AFTER INSERT ON scan_samples BEGIN
    DELETE FROM results WHERE scan_id = NEW.scan_id;
    INSERT INTO results SELECT * FROM result_now WHERE scan_id = NEW.scan_id;
END;
CREATE TRIGGER results_of_records AFTER INSERT ON scan_records BEGIN
    UPDATE results SET archived = NEW.archived, tags = NULLIF(NEW.tags, '[]'), note = NEW.note WHERE scan_id = NEW.scan_id;
END;
CREATE TRIGGER results_of_names AFTER INSERT ON sample_names BEGIN
    UPDATE results SET part = NEW.name WHERE sample_id = NEW.sample_id;
END;
CREATE TRIGGER results_of_jobs AFTER INSERT ON job_ends WHEN NEW.state = 'completed' BEGIN
    DELETE FROM results WHERE scan_id = (SELECT scan_id FROM jobs WHERE id = NEW.job_id AND kind IN ('fit', 'verdict'));
    INSERT INTO results SELECT * FROM result_now
    WHERE scan_id = (SELECT scan_id FROM jobs WHERE id = NEW.job_id AND kind IN ('fit', 'verdict'));
END;
