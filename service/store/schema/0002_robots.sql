-- What sets a robot apart from its map's defaults: it shares the positions of batches and solves, and
-- the last before the robot's first batch holds.
CREATE TABLE robot (
    map      INTEGER NOT NULL REFERENCES map (key),
    position INTEGER NOT NULL,
    robot    TEXT NOT NULL,
    data     BLOB NOT NULL,
    PRIMARY KEY (map, position)
);
