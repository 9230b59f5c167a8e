"""A solve's result: where the sub-maps' frames and shared landmarks lie, and how surely."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from submaps.atlas.component import Component
from submaps.atlas.placed import Placed
from submaps.atlas.sparse import Factorisation, InverseSubset
from submaps.atlas.state import AtlasState
from submaps.errors import MeasurementError

Floats = NDArray[np.float64]


class Solution:
    """Values of a solve over the state that it was computed from.

    ``frames`` (submaps, 3) and ``ends`` (robots, 3) are poses (x m, y m, theta rad), ``landmarks``
    (m, 2) the shared landmarks, component after component. Covariances are derived when first
    asked for, from these values alone: a replayed solution gives the same bits.
    """

    def __init__(
        self, base: AtlasState, frames: Floats, ends: Floats, landmarks: Floats, iterations: int, cost: float,
        components: dict[int, Component] | None = None,
    ) -> None:  # fmt: skip
        self.base = base
        self.frames = frames
        self.ends = ends
        self.landmarks = landmarks
        self.iterations = iterations
        self.cost = cost
        self._lock = threading.RLock()
        self._components = components or {}
        self._inverses: dict[int, InverseSubset] = {}
        self._placed: dict[int, Placed] = {}

    def columns(self) -> dict[str, Floats]:
        """What a journal keeps of a solve: its values, iterations and cost."""
        return {
            "frames": self.frames,
            "ends": self.ends,
            "landmarks": self.landmarks,
            "iterations_cost": np.array([float(self.iterations), self.cost]),
        }

    @classmethod
    def from_columns(cls, state: AtlasState, columns: Mapping[str, Floats]) -> Solution:
        """The solution that ``columns`` of a solve of ``state`` describes, without solving again."""
        frames, ends = columns["frames"], columns["ends"]
        if frames.shape[0] != state.submap_count or ends.shape[0] != len(state.robots):
            raise MeasurementError(
                f"a solve of {frames.shape[0]} sub-maps and {ends.shape[0]} robots does not fit a state of "
                f"{state.submap_count} and {len(state.robots)}"
            )
        iterations, cost = columns["iterations_cost"]
        return cls(replace(state, solution=None), frames, ends, columns["landmarks"], int(iterations), float(cost))

    def component(self, robot: int) -> Component:
        """A robot's component with this solution's values in it."""
        with self._lock:
            if robot not in self._components:
                at = 0
                for number in range(len(self.base.robots)):
                    component = Component(self.base.chain(number))
                    chain = [s.number for s in component.chain]
                    component.frames[:-1] = self.frames[chain]
                    component.frames[-1] = self.ends[number]
                    component.points[:] = self.landmarks[at : at + len(component.landmarks)]
                    at += len(component.landmarks)
                    self._components[number] = component
            return self._components[robot]

    def placed(self, number: int) -> Placed:
        """Sub-map ``number`` of the base state, with the joint covariance of its global variables."""
        with self._lock:
            if number not in self._placed:
                robot = self.base.submap(number).robot
                component = self.component(robot)
                self._placed[number] = component.placed(number, self._inverse(robot))
            return self._placed[number]

    def _inverse(self, robot: int) -> InverseSubset:
        if robot not in self._inverses:
            component = self.component(robot)
            data = np.empty(component.pattern.indices.shape[0])
            component.assemble(len(component.chain), data, np.empty(component.pattern.size))
            self._inverses[robot] = Factorisation(component.pattern, data).inverse_subset()
        return self._inverses[robot]

    def point(self, robot: int, landmark: int) -> tuple[Floats, Floats] | None:
        """A shared landmark's position (2,) and covariance (2, 2), or ``None`` where it is not shared."""
        component = self.component(robot)
        variable = component.variable_of.get(landmark)
        if variable is None:
            return None
        with self._lock:
            covariance = self._inverse(robot).joint(np.array([variable]))
        return component.points[variable - len(component.chain)], covariance
