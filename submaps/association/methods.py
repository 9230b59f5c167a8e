"""The table of methods that find an observation's landmark."""

from __future__ import annotations

from collections.abc import Callable

from submaps.association.assignment import assignment
from submaps.association.candidates import Candidates
from submaps.association.greedy import greedy
from submaps.association.joint import joint
from submaps.association.result import Association, Gates

Method = Callable[[Candidates, Gates], Association]

METHODS: dict[str, Method] = {"greedy": greedy, "assignment": assignment, "joint": joint}
