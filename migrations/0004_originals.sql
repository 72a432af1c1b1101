-- A frame of an imported series that came as a TIFF is kept as the PNG of the same counts.
ALTER TABLE frames ADD COLUMN original_sha256 TEXT; -- of the file as it came; NULL where it is the kept PNG itself
