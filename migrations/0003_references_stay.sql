-- Which references a scan was reduced with is as unchangeable as the scan itself.
CREATE TRIGGER scan_calibrations_kept BEFORE UPDATE ON scan_calibrations BEGIN SELECT RAISE(ABORT, 'references of a scan are never changed'); END;
CREATE TRIGGER scan_calibrations_stay BEFORE DELETE ON scan_calibrations BEGIN SELECT RAISE(ABORT, 'references of a scan are never deleted'); END;
