"""The errors that the estimator raises for a caller's mistake."""

from __future__ import annotations


class SubmapsError(Exception):
    """Something asked of Submaps cannot be done as asked."""


class ConfigError(SubmapsError):
    """A setting has a value that it cannot have."""

    def __init__(self, field: str, got: object, expected: str) -> None:
        super().__init__(f"{field}: got {got!r}, expected {expected}")
        self.field = field
        self.got = got
        self.expected = expected


class MeasurementError(SubmapsError):
    """A batch of measurements does not have the shape that its model asks for."""


class UnknownName(SubmapsError):
    """No robot, landmark, sub-map or frame of that name exists in the map."""


class NotConnected(SubmapsError):
    """No path of ties leads from one frame to the other."""


class DigestMismatch(SubmapsError):
    """A recorded solve was computed from another state than the one at hand."""


class NumericalError(SubmapsError):
    """A solve met a pivot that is not positive, or left the finite numbers."""
