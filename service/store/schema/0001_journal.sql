-- One row of `map` for each map that exists; `deleted` ones are being cleared away.
-- AUTOINCREMENT: a key is never used again, so nothing late can reach a newer map of the same id.
CREATE TABLE map (
    key     INTEGER PRIMARY KEY AUTOINCREMENT,
    id      TEXT NOT NULL,
    config  BLOB NOT NULL,
    deleted INTEGER NOT NULL DEFAULT 0
);
CREATE UNIQUE INDEX map_id ON map (id) WHERE NOT deleted;

-- What happened to a map, in one order: batches and solves share the positions 1, 2, 3, ...
CREATE TABLE batch (
    map      INTEGER NOT NULL REFERENCES map (key),
    position INTEGER NOT NULL,
    robot    TEXT NOT NULL,
    sequence INTEGER NOT NULL,
    digest   BLOB NOT NULL,
    data     BLOB NOT NULL,
    PRIMARY KEY (map, position)
);
CREATE UNIQUE INDEX batch_sequence ON batch (map, robot, sequence);

CREATE TABLE solve (
    map            INTEGER NOT NULL REFERENCES map (key),
    position       INTEGER NOT NULL,
    base           INTEGER NOT NULL,
    number         INTEGER NOT NULL,
    problem_digest BLOB NOT NULL,
    data           BLOB NOT NULL,
    seconds        REAL NOT NULL,
    iterations     INTEGER NOT NULL,
    cost           REAL NOT NULL,
    PRIMARY KEY (map, position)
);

-- What applying a batch gave; a replay writes what is missing here.
CREATE TABLE derived (
    map             INTEGER NOT NULL REFERENCES map (key),
    robot           TEXT NOT NULL,
    sequence        INTEGER NOT NULL,
    began           REAL NOT NULL,
    ended           REAL NOT NULL,
    acknowledgement BLOB NOT NULL,
    track           BLOB NOT NULL,
    PRIMARY KEY (map, robot, sequence)
);
