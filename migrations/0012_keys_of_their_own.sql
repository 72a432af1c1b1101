-- Idempotency keys belong to the caller that sent them, and are forgotten after a while.
ALTER TABLE idempotency_keys RENAME TO idempotency_keys_of_all;
CREATE TABLE idempotency_keys (
    who         TEXT NOT NULL,              -- name of the token, or `local`
    key         TEXT NOT NULL,
    request     TEXT NOT NULL,              -- SHA-256 of method, path and body: the same key for something else is an error
    status      INTEGER NOT NULL,
    location    TEXT,
    body        TEXT NOT NULL,
    at          TEXT NOT NULL,              -- the machine's wall-clock time; the age counts from here
    PRIMARY KEY (who, key)
) WITHOUT ROWID;
INSERT INTO idempotency_keys (who, key, request, status, location, body, at)
SELECT 'local', key, request, status, location, body, at FROM idempotency_keys_of_all;
DROP TABLE idempotency_keys_of_all;
CREATE INDEX idempotency_keys_by_age ON idempotency_keys (at);
