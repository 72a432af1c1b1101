-- The queue: parts to be measured, in sequence. An order's content stays; its place in the sequence is the only column that
-- changes. Its state follows from its newest scan and from the newest row of queue_changes.
CREATE TABLE queue_orders (
    id               INTEGER PRIMARY KEY AUTOINCREMENT,
    position         INTEGER NOT NULL UNIQUE, -- place in the sequence, ascending
    sample_id        INTEGER NOT NULL REFERENCES samples(id),
    recipe_id        INTEGER NOT NULL REFERENCES definitions(id),
    specification_id INTEGER REFERENCES definitions(id),
    lot              TEXT,
    external_id      TEXT,                  -- unique among the orders that are not removed
    operator_name    TEXT,
    note             TEXT,
    who              TEXT NOT NULL,
    created_at       TEXT NOT NULL
);
CREATE INDEX queue_orders_by_external_id ON queue_orders (external_id);

-- What was done with an order beside its scans.
CREATE TABLE queue_changes (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    order_id    INTEGER NOT NULL REFERENCES queue_orders(id),
    change      TEXT NOT NULL CHECK (change IN ('removed', 'failed', 'retried')),
    scan_id     INTEGER REFERENCES scans(id), -- the order's newest scan at that time
    reason      TEXT,
    who         TEXT NOT NULL,
    at          TEXT NOT NULL
);
CREATE INDEX queue_changes_of_order ON queue_changes (order_id, id);

-- One row per state of the queue; the latest is its state. Without a row it is stopped.
CREATE TABLE queue_states (
    id          INTEGER PRIMARY KEY AUTOINCREMENT,
    state       TEXT NOT NULL CHECK (state IN ('stopped', 'running', 'stopping', 'paused')),
    reason      TEXT,
    who         TEXT NOT NULL,
    at          TEXT NOT NULL
);

ALTER TABLE scans ADD COLUMN order_id INTEGER REFERENCES queue_orders(id);
CREATE INDEX scans_of_order ON scans (order_id, id);

CREATE TRIGGER queue_orders_kept BEFORE UPDATE OF id, sample_id, recipe_id, specification_id, lot, external_id, operator_name, note, who, created_at
    ON queue_orders BEGIN SELECT RAISE(ABORT, 'orders are never changed'); END;
CREATE TRIGGER queue_orders_stay BEFORE DELETE ON queue_orders BEGIN SELECT RAISE(ABORT, 'orders are never deleted'); END;
CREATE TRIGGER queue_changes_kept BEFORE UPDATE ON queue_changes BEGIN SELECT RAISE(ABORT, 'changes are never changed'); END;
CREATE TRIGGER queue_changes_stay BEFORE DELETE ON queue_changes BEGIN SELECT RAISE(ABORT, 'changes are never deleted'); END;
CREATE TRIGGER queue_states_kept BEFORE UPDATE ON queue_states BEGIN SELECT RAISE(ABORT, 'states are never changed'); END;
CREATE TRIGGER queue_states_stay BEFORE DELETE ON queue_states BEGIN SELECT RAISE(ABORT, 'states are never deleted'); END;
