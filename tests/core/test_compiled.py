"""No request waits for a compiler: everything is compiled when the package is imported."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import replace
from typing import get_args

import numpy as np
from numba.core.dispatcher import Dispatcher

import submaps
from benchmarks.consistency import configure
from submaps.association.methods import METHODS
from submaps.atlas.joining import join
from submaps.config import FilterName
from submaps.mapper import Mapper
from submaps.simulation import circle, drive


def compiled() -> dict[str, int]:
    """How many signatures each compiled function of the package has."""
    found = {}
    for module in pkgutil.walk_packages(submaps.__path__, "submaps."):
        for name, value in vars(importlib.import_module(module.name)).items():
            if isinstance(value, Dispatcher):
                found[f"{module.name}.{name}"] = len(value.signatures)
    return found


def test_nothing_is_compiled_after_import() -> None:
    world = circle(laps=1.05)
    before = compiled()
    for one_map in (False, True):
        for filter in get_args(FilterName):
            mapper = Mapper(configure(world, filter, one_map))
            mapper.apply("robot", drive(world, np.random.default_rng(1)).batch)
            mapper.view().pose("robot")
            mapper.install(join(mapper.problem()))
            view = mapper.view()
            view.pose("robot")
            view.landmarks()
            view.transform(0, view.submap_count - 1)
    run = drive(world, np.random.default_rng(1)).batch
    for method in METHODS:
        mapper = Mapper(replace(configure(world, "invariant", False), association=method))  # type: ignore[arg-type]
        mapper.apply("robot", replace(run, landmark=("",) * run.observations))
    assert compiled() == before
    assert sum(before.values()) > 20
