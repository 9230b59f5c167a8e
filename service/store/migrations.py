"""The SQL files beside this one: numbered migrations and named statements."""

from __future__ import annotations

import re
import sqlite3
from importlib.resources import files

from service.store.base import StoreError

_NAME = re.compile(r"^-- name: (\w+)$", re.MULTILINE)


def load_statements() -> dict[str, str]:
    """Return the statements of ``statements.sql`` by name."""
    text = files(__package__).joinpath("statements.sql").read_text(encoding="utf-8")
    _, *parts = _NAME.split(text)
    return dict(zip(parts[::2], (part.strip() for part in parts[1::2]), strict=True))


def load_migrations() -> list[tuple[int, str]]:
    """Return the migrations ``(version, SQL)``, in order."""
    folder = files(__package__).joinpath("schema")
    found = [
        (int(file.name[:4]), file.read_text(encoding="utf-8"))
        for file in folder.iterdir()
        if file.name.endswith(".sql")
    ]
    return sorted(found)


def migrate(connection: sqlite3.Connection) -> None:
    """Bring the schema up to date; each migration is one transaction.

    Raises ``StoreError`` where the file was written by a later version.
    """
    connection.execute("CREATE TABLE IF NOT EXISTS migration (version INTEGER PRIMARY KEY)")
    (done,) = connection.execute("SELECT coalesce(max(version), 0) FROM migration").fetchone()
    migrations = load_migrations()
    if done > migrations[-1][0]:
        raise StoreError(f"the journal has schema {done}; this version knows {migrations[-1][0]}")
    for version, sql in migrations:
        if version > done:
            connection.executescript(f"BEGIN IMMEDIATE; {sql}; INSERT INTO migration VALUES ({version}); COMMIT")
