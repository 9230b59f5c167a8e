"""Rows of figures by name, and the few of them that a printed table has room for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from service.experiments.base import Table

Figures = Mapping[str, object]


def chosen(rows: Sequence[Figures], columns: Mapping[str, str]) -> Table:
    """The table of ``columns``, figure -> heading, one row for each of ``rows``."""
    return Table(tuple(columns.values()), tuple(tuple(row[key] for key in columns) for row in rows))
