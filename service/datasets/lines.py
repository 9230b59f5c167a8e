"""What the readers of text formats share: fields, and noise that stands in each line as a triangle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, TextIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from service.datasets.dataset import DatasetError

NoiseForm = Literal["sqrt_information", "information", "covariance"]
Floats = NDArray[np.float64]
Number = TypeVar("Number", int, float)


class BadLine(Exception):
    """What is wrong with a line."""


@contextmanager
def opened(path: Path) -> Iterator[TextIO]:
    """A text file to read; raises ``DatasetError`` where it cannot be."""
    try:
        with path.open(encoding="utf-8") as lines:
            yield lines
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: not a text file (no UTF-8 at byte {error.start})") from error


def number(text: str, kind: type[Number], expected: str) -> Number:
    """A finite number of a kind; raises ``BadLine``."""
    try:
        value = kind(text)
    except ValueError:
        raise BadLine(f"expected {expected}, got {text!r}") from None
    if not math.isfinite(value):
        raise BadLine(f"expected {expected}, got {text!r}")
    return value


def finite(texts: Iterable[str]) -> tuple[float, ...]:
    """Finite numbers; raises ``BadLine``."""
    return tuple(number(text, float, "a finite number") for text in texts)


def table(path: Path, columns: int, separator: str | None = None) -> Floats:
    """The numbers (n, columns) of a file, its comments left out.

    They stand apart by white space, or by a separator. Raises ``DatasetError``, naming the line.
    """
    rows = []
    with opened(path) as lines:
        for k, line in enumerate(lines, start=1):
            if line.isspace() or line.lstrip().startswith("#"):
                continue
            try:
                row = finite(line.split(separator))
            except BadLine:
                row = ()
            if len(row) != columns:
                raise DatasetError(f"{path}:{k}: expected {columns} finite numbers, got {line.strip()!r}")
            rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, columns)


class LineNoise:
    """Covariances of one kind of line, each distinct triangle (upper, in row order) turned into a matrix once."""

    def __init__(self, form: NoiseForm, size: int) -> None:
        self.form = form
        self.size = size
        self.rows: list[int] = []
        self.known: dict[tuple[float, ...], int] = {}
        self.matrices: list[Floats] = []

    def add(self, triangle: tuple[float, ...], turn: float = 0.0) -> None:
        """Take in a line's noise, its first two axes turned by ``turn`` (rad); raises ``BadLine``."""
        key = (*triangle, turn)
        if key not in self.known:
            self.matrices.append(self._covariance(triangle, turn))
            self.known[key] = len(self.matrices) - 1
        self.rows.append(self.known[key])

    def sigma(self) -> tuple[float, ...]:
        """Standard deviations of the first line."""
        return tuple(float(s) for s in np.sqrt(np.diagonal(self.matrices[0])))

    def covariances(self, order: Iterable[int]) -> Floats | None:
        """One matrix a row, or ``None`` where ``sigma`` says it all."""
        first = self.matrices[0]
        if len(self.matrices) == 1 and np.array_equal(first, np.diag(np.diagonal(first))):
            return None
        return np.stack(self.matrices)[[self.rows[i] for i in order]]

    def _covariance(self, triangle: tuple[float, ...], turn: float) -> Floats:
        upper = np.zeros((self.size, self.size))
        upper[np.triu_indices(self.size)] = triangle
        covariance: Floats = upper + np.triu(upper, 1).T
        if self.form == "sqrt_information":
            if np.any(np.diagonal(upper) == 0.0):
                raise BadLine("the square-root information has a zero on its diagonal")
            inverse = np.linalg.inv(upper)
            covariance = inverse @ inverse.T
        elif self.form == "information":
            self._check(covariance)
            covariance = np.asarray(np.linalg.inv(covariance))
            covariance = 0.5 * (covariance + covariance.T)
        self._check(covariance)
        if turn:
            c, s = math.cos(turn), math.sin(turn)
            A = np.eye(self.size)
            A[:2, :2] = (c, -s), (s, c)
            covariance = A @ covariance @ A.T
            covariance = 0.5 * (covariance + covariance.T)
        return covariance

    def _check(self, matrix: Floats) -> None:
        if not np.all(np.isfinite(matrix)) or np.linalg.eigvalsh(matrix)[0] <= 0.0:
            raise BadLine(f"the noise is no positive definite {self.form.replace('_', ' ')}")
