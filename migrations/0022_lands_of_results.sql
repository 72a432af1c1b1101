-- The share of flat lands between the ridges joins the row of a result.
DROP VIEW result_now;
ALTER TABLE results ADD COLUMN land_share REAL;        -- NULL where the fit has none
ALTER TABLE results ADD COLUMN land_share_std REAL;

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
    archived, tags, note,
    report ->> '$.findings[0].code',
    -- Values that a verdict rests on are those of a fit, up to rounding. An azimuth is judged on the turn of its limits, and an
    -- item without a value has nothing to compare.
    CASE WHEN report IS NOT NULL AND judgement IS NOT NULL THEN NOT EXISTS (
        SELECT 1
        FROM (
            SELECT item.value ->> '$.value' AS judged, item.value ->> '$.std' AS std,
                report -> ('$.parameters.' || (item.value ->> '$.quantity')) AS parameter
            FROM json_each(judgement, '$.items') AS item
            WHERE item.value ->> '$.quantity' <> 'azimuth_offset_deg'
        )
        WHERE judged IS NOT NULL AND parameter IS NOT NULL
            AND COALESCE(ABS(judged - (parameter ->> '$.value')) > 0.01 * std, 1)
    ) END,
    report ->> '$.parameters.land_share.value', report ->> '$.parameters.land_share.std'
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

DELETE FROM results;
INSERT INTO results SELECT * FROM result_now;
