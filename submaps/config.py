"""What a map is made of: models, filter and bounds of a sub-map."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

from submaps.errors import ConfigError
from submaps.geometry.space import SPACES, Space

SpaceName = Literal["se2", "se3"]
MotionModel = Literal["odometry", "velocity", "bicycle", "ackermann", "odometry3d", "none"]
ObservationModel = Literal["cartesian", "range_bearing", "bearing", "cartesian3d", "stereo", "pinhole"]
FilterName = Literal["invariant", "standard"]
AssociationName = Literal["known", "greedy", "assignment", "joint"]
Noise = Literal["reading", "density"]

MOTION_CHANNELS: dict[str, tuple[str, ...]] = {
    "odometry": ("dx", "dy", "dtheta"),
    "velocity": ("v", "omega"),
    "bicycle": ("speed", "steer"),
    "ackermann": ("speed", "steer"),
    "odometry3d": ("dx", "dy", "dz", "rx", "ry", "rz"),
    "none": (),
}
VEHICLES = ("bicycle", "ackermann")  # the models that steer a wheel
_SIGMAS = {
    "odometry": (3,), "velocity": (2, 3), "bicycle": (2,), "ackermann": (2, 3), "odometry3d": (6,), "none": (0,)
}  # fmt: skip
OBSERVATION_CHANNELS: dict[str, tuple[str, ...]] = {
    "cartesian": ("x", "y"),
    "range_bearing": ("range", "bearing"),
    "bearing": ("bearing",),
    "cartesian3d": ("x", "y", "z"),
    "stereo": ("u_left", "v_left", "u_right", "v_right"),
    "pinhole": ("u", "v"),
}
# Which models are of which space; without motion, a map is of points that each reading shows whole.
_MOTIONS = {"se2": ("odometry", "velocity", "bicycle", "ackermann"), "se3": ("odometry3d", "none")}
_OBSERVATIONS = {"se2": ("cartesian", "range_bearing", "bearing"), "se3": ("cartesian3d", "stereo", "pinhole")}
WITHOUT_MOTION = ("cartesian3d", "stereo")
CAMERAS = ("stereo", "pinhole")
# A single reading of these leaves the depth open: a new landmark needs a prior.
WITHOUT_DEPTH = ("bearing", "pinhole")
# Of maps that find out which landmark an observation is of (docs/experiments/association.md).
DEFAULT_GATE, DEFAULT_NEW_GATE = 0.99, 0.99999


@dataclass(frozen=True)
class MotionConfig:
    """A motion model and the standard deviation of one step's reading.

    ``odometry``: (dx m, dy m, dtheta rad). ``velocity``: (v m/s, omega rad/s), with an optional
    third, the lateral slip in m/s. ``bicycle``: (speed m/s, steer rad) of the front wheel,
    ``wheelbase`` m ahead of the rear one. ``ackermann``: (speed m/s, steer rad), with an optional
    lateral slip in m/s; the speed is that of an encoder ``encoder_offset`` m to the left of the
    middle of the rear axle, the steer that of a wheel ``wheelbase`` m ahead of it. ``odometry3d``:
    (dx m, dy m, dz m, rx rad, ry rad, rz rad), the last three a rotation vector. ``none``: nothing is
    known of the motion; each pose is found from what is seen there.

    With ``noise`` "density", ``sigma`` is per root second: an increment's variance is sigma² dt, so
    that an interval may be split.
    """

    model: MotionModel
    sigma: tuple[float, ...]
    noise: Noise = "reading"
    wheelbase: float | None = None
    encoder_offset: float = 0.0

    def __post_init__(self) -> None:
        _check_choice("motion.model", self.model, get_args(MotionModel))
        _check_choice("motion.noise", self.noise, get_args(Noise))
        _check_numbers("motion.sigma", self.sigma, _SIGMAS[self.model], least=0.0)
        object.__setattr__(self, "sigma", tuple(float(s) for s in self.sigma))
        if self.model not in VEHICLES and self.wheelbase is not None:
            raise ConfigError("motion.wheelbase", self.wheelbase, f"none, as {self.model} has no wheels")
        if self.model in VEHICLES and not (self.wheelbase and 0.0 < self.wheelbase < math.inf):
            raise ConfigError("motion.wheelbase", self.wheelbase, f"m, above 0, for {self.model}")
        reach = self.wheelbase or 0.0 if self.model == "ackermann" else 0.0
        if self.encoder_offset != 0.0 and not abs(self.encoder_offset) < reach:
            expected = f"m, less than the wheelbase of {reach}" if reach else f"none for {self.model}"
            raise ConfigError("motion.encoder_offset", self.encoder_offset, expected)

    @property
    def space(self) -> SpaceName:
        """The space that the robot moves in."""
        return "se3" if self.model in _MOTIONS["se3"] else "se2"

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the control's channels, in the order of the columns."""
        return MOTION_CHANNELS[self.model]


@dataclass(frozen=True)
class Camera:
    """A calibrated pinhole camera: focal lengths and principal point in pixels; of a pair, the baseline in m.

    The sensor's z axis looks ahead, x to the right, y down; the right camera lies ``baseline`` along x.
    """

    fu: float
    fv: float
    cu: float
    cv: float
    baseline: float = 0.0

    def __post_init__(self) -> None:
        _check_numbers("observation.camera", (self.fu, self.fv), (2,), above=0.0)
        _check_numbers("observation.camera", (self.cu, self.cv), (2,))
        _check_numbers("observation.camera.baseline", (self.baseline,), (1,), least=0.0)


@dataclass(frozen=True)
class Depth:
    """The prior of a new landmark's depth: normal, ``mean`` m and ``sigma`` m."""

    mean: float
    sigma: float

    def __post_init__(self) -> None:
        _check_numbers("observation.depth", (self.mean, self.sigma), (2,), above=0.0)


@dataclass(frozen=True)
class ObservationConfig:
    """An observation model, its standard deviation, and the sensor's pose in the body frame.

    ``cartesian``: (m, m). ``range_bearing``: (m, rad). ``bearing``: (rad). ``cartesian3d``: (m, m, m).
    ``stereo``: (u_left, v_left, u_right, v_right), pixels. ``pinhole``: (u, v), pixels. ``mount``: (x m,
    y m, theta rad), in space (x m, y m, z m, qx, qy, qz, qw). The last two have a ``camera``; ``bearing``
    and ``pinhole`` a prior on ``depth``: the range, or the distance ahead.
    """

    model: ObservationModel
    sigma: tuple[float, ...]
    mount: tuple[float, ...] = ()
    camera: Camera | None = None
    depth: Depth | None = None

    def __post_init__(self) -> None:
        _check_choice("observation.model", self.model, get_args(ObservationModel))
        _check_numbers("observation.sigma", self.sigma, (len(self.channels),), above=0.0)
        object.__setattr__(self, "sigma", tuple(float(s) for s in self.sigma))
        planar = self.model in _OBSERVATIONS["se2"]
        mount = self.mount or ((0.0,) * 3 if planar else (0.0,) * 6 + (1.0,))
        _check_numbers("observation.mount", mount, (3 if planar else 7,))
        object.__setattr__(self, "mount", tuple(float(m) for m in mount))
        if not planar and not abs(math.hypot(*self.mount[3:]) - 1.0) < 1e-6:
            raise ConfigError("observation.mount", self.mount, "a unit quaternion (x, y, z, w) after x, y, z")
        self._check_camera()
        needs = self.model in WITHOUT_DEPTH
        if needs != (self.depth is not None):
            expected = f"a mean and sigma in m, for {self.model}" if needs else f"none, as {self.model} shows it"
            raise ConfigError("observation.depth", self.depth, expected)

    def _check_camera(self) -> None:
        needs = self.model in CAMERAS
        if needs != (self.camera is not None):
            expected = f"fu, fv, cu, cv for {self.model}" if needs else f"none for {self.model}"
            raise ConfigError("observation.camera", self.camera, expected)
        if self.camera is not None and (self.camera.baseline > 0.0) != (self.model == "stereo"):
            expected = "m, above 0, for stereo" if self.model == "stereo" else f"none for {self.model}"
            raise ConfigError("observation.camera.baseline", self.camera.baseline, expected)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the observation's channels, in the order of the columns."""
        return OBSERVATION_CHANNELS[self.model]


@dataclass(frozen=True)
class MapConfig:
    """Everything that decides how a map estimates.

    ``gate`` is the chi-square probability beyond which an observation is rejected (``None``: all
    are used). With ``association`` other than "known" observations come without landmarks: one within
    the gate may be of a landmark, one beyond ``new_gate`` from all of them begins one, and one in between
    is ambiguous, and rejected; both gates have defaults then. A sub-map closes at ``max_landmarks``, or
    when the heading's standard deviation in its own frame passes ``max_heading_sigma`` (rad), or that of
    its position ``max_position_sigma`` (m), after ``min_observed_steps`` steps with observations.
    """

    motion: MotionConfig
    observation: ObservationConfig
    filter: FilterName = "invariant"
    gate: float | None = field(default=None)
    max_landmarks: int = 50
    max_heading_sigma: float = 0.010
    min_observed_steps: int = 5
    max_position_sigma: float = 0.15
    space: SpaceName = "se2"
    association: AssociationName = "known"
    new_gate: float | None = None

    def __post_init__(self) -> None:
        _check_choice("space", self.space, get_args(SpaceName))
        check_models(self.space, self.motion, self.observation)
        _check_choice("filter", self.filter, get_args(FilterName))
        self._check_association()
        if not 1 <= self.max_landmarks <= 1000:
            raise ConfigError("submap.max_landmarks", self.max_landmarks, "an integer in 1..1000")
        if not 0.0 < self.max_heading_sigma < math.inf:
            raise ConfigError("submap.max_heading_sigma", self.max_heading_sigma, "rad, above 0")
        if not 0.0 < self.max_position_sigma < math.inf:
            raise ConfigError("submap.max_position_sigma", self.max_position_sigma, "m, above 0")
        if not 1 <= self.min_observed_steps <= 1_000_000:
            raise ConfigError("submap.min_observed_steps", self.min_observed_steps, "an integer in 1..1000000")

    def _check_association(self) -> None:
        _check_choice("association.method", self.association, get_args(AssociationName))
        if not self.named:
            if self.motion.model == "none":
                _check_choice("association.method", self.association, ("known",), " without a motion model")
            object.__setattr__(self, "gate", DEFAULT_GATE if self.gate is None else self.gate)
            object.__setattr__(self, "new_gate", DEFAULT_NEW_GATE if self.new_gate is None else self.new_gate)
        elif self.new_gate is not None:
            raise ConfigError("association.new_gate", self.new_gate, "none where landmarks are known")
        if self.gate is not None and not 0.0 < self.gate < 1.0:
            raise ConfigError("association.gate", self.gate, "null or a probability in (0, 1)")
        if self.new_gate is not None and not (self.gate or 0.0) <= self.new_gate < 1.0:
            raise ConfigError("association.new_gate", self.new_gate, f"a probability from the gate's {self.gate} to 1")

    @property
    def geometry(self) -> Space:
        """The plane or space, as a value."""
        return SPACES[self.space]

    @property
    def named(self) -> bool:
        """Whether observations say which landmark they are of."""
        return self.association == "known"


def check_models(space: str, motion: MotionConfig, observation: ObservationConfig) -> None:
    """Raise ``ConfigError`` where a model is not one of the map's space, or does not go with the other."""
    _check_choice("motion.model", motion.model, _MOTIONS[space], f" in {space}")
    _check_choice("observation.model", observation.model, _OBSERVATIONS[space], f" in {space}")
    if motion.model == "none":
        _check_choice("observation.model", observation.model, WITHOUT_MOTION, " without a motion model")


@dataclass(frozen=True)
class Start:
    """Where a robot's first pose lies, as far as its operator knows.

    ``pose`` (x m, y m, theta rad; in space x, y, z m and a rotation vector, rad) in ``frame`` (``map`` or
    ``submap/k``), with the ``covariance`` (3, 3) or (6, 6) of its additive errors, symmetric and positive
    definite.
    """

    frame: str
    pose: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        if not re.fullmatch(r"map|submap/\d{1,9}", self.frame):
            raise ConfigError("start.frame", self.frame, "map or submap/NUMBER")
        _check_numbers("start.pose", self.pose, (3, 6))
        size = len(self.pose)
        if len(self.covariance) != size:
            raise ConfigError("start.covariance", self.covariance, f"{size} rows of {size} numbers")
        for row in self.covariance:
            _check_numbers("start.covariance", row, (size,))
        if not _is_positive_definite(self.covariance):
            raise ConfigError("start.covariance", self.covariance, "a symmetric positive definite matrix")


@dataclass(frozen=True)
class RobotConfig:
    """What sets a robot apart from its map's defaults."""

    motion: MotionConfig
    observation: ObservationConfig
    start: Start | None = None


# What says how a robot's measurements are read: its own, or its map's.
Models = MapConfig | RobotConfig


def _is_positive_definite(matrix: Sequence[Sequence[float]]) -> bool:
    """Whether a matrix equals its transpose and every pivot of its elimination is positive."""
    size = len(matrix)
    symmetric = all(matrix[i][j] == matrix[j][i] for i in range(size) for j in range(i))
    rest = [list(row) for row in matrix]
    for k in range(size):
        if not rest[k][k] > 0.0:
            return False
        for i in range(k + 1, size):
            for j in range(k + 1, size):
                rest[i][j] -= rest[i][k] * rest[k][j] / rest[k][k]
    return symmetric


def _check_choice(name: str, got: object, known: Sequence[str], where: str = "") -> None:
    if got not in known:
        raise ConfigError(name, got, "one of " + ", ".join(known) + where)


def _check_numbers(
    name: str,
    got: Sequence[float],
    lengths: Sequence[int],
    *,
    least: float = -math.inf,
    above: float = -math.inf,
) -> None:
    expected = " or ".join(str(n) for n in lengths) + " finite numbers"
    if above == 0.0:
        expected += " above 0"
    elif least == 0.0:
        expected += ", none below 0"
    good = len(got) in lengths and all(math.isfinite(v) and v >= least and v > above for v in got)
    if not good:
        raise ConfigError(name, tuple(got), expected)
