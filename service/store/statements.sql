-- name: create_map
INSERT INTO map (key, id, config) VALUES (?, ?, ?);
-- name: mark_deleted
UPDATE map SET deleted = 1 WHERE key = ?;
-- name: append_batch
INSERT INTO batch (map, position, robot, sequence, digest, data) VALUES (?, ?, ?, ?, ?, ?);
-- name: append_solve
INSERT INTO solve (map, position, base, number, problem_digest, data, seconds, iterations, cost)
VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?);
-- name: append_robot
INSERT INTO robot (map, position, robot, data) VALUES (?, ?, ?, ?);
-- name: derive
INSERT OR REPLACE INTO derived (map, robot, sequence, began, ended, acknowledgement, track)
SELECT * FROM (VALUES (?, ?, ?, ?, ?, ?, ?)) WHERE EXISTS (SELECT 1 FROM map WHERE key = column1 AND NOT deleted);
-- name: maps
SELECT key, id, config FROM map WHERE NOT deleted ORDER BY key;
-- name: last_key
SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'map';
-- name: batches
SELECT b.map, b.position, b.robot, b.sequence, b.digest, b.data, d.map IS NOT NULL
FROM batch b LEFT JOIN derived d ON d.map = b.map AND d.robot = b.robot AND d.sequence = b.sequence
WHERE b.map = ? AND b.position > ? ORDER BY b.position;
-- name: solves
SELECT map, position, base, number, problem_digest, data, seconds, iterations, cost
FROM solve WHERE map = ? AND position > ? ORDER BY position;
-- name: robots
SELECT map, position, robot, data FROM robot WHERE map = ? AND position > ? ORDER BY position;
-- name: solve_bases
SELECT base FROM solve WHERE map = ?;
-- name: acknowledgement
SELECT b.digest, d.acknowledgement
FROM batch b LEFT JOIN derived d ON d.map = b.map AND d.robot = b.robot AND d.sequence = b.sequence
WHERE b.map = ? AND b.robot = ? AND b.sequence = ?;
-- name: tracks
SELECT track FROM derived
WHERE map = ? AND robot = ? AND ended >= ? AND began <= ? ORDER BY sequence;
-- name: one_deleted
SELECT key FROM map WHERE deleted ORDER BY key LIMIT 1;
-- name: clear_derived
DELETE FROM derived WHERE rowid IN (SELECT rowid FROM derived WHERE map = ? LIMIT ?);
-- name: clear_solve
DELETE FROM solve WHERE rowid IN (SELECT rowid FROM solve WHERE map = ? LIMIT ?);
-- name: clear_batch
DELETE FROM batch WHERE rowid IN (SELECT rowid FROM batch WHERE map = ? LIMIT ?);
-- name: clear_robot
DELETE FROM robot WHERE rowid IN (SELECT rowid FROM robot WHERE map = ? LIMIT ?);
-- name: clear_map
DELETE FROM map WHERE key = ?;
