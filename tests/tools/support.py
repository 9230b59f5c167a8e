"""The command ``submaps`` as a process, and a run for it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

STEPS = 40


def submaps(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    return subprocess.run(
        [sys.executable, "-m", "service.cli", *words],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
        env={**os.environ, "COLUMNS": "120", **environment},
    )


def write_rounds(path: Path) -> Path:
    """Twice round a circle of 20 steps past twelve trees, as an iSAM file."""
    random = np.random.default_rng(5)
    trees = 9.0 * np.exp(2j * np.pi * np.arange(12) / 12) + 6j
    turn = 2 * np.pi / 20
    lines, at, heading = [], 0j, 0.0
    for k in range(STEPS):
        if k:
            dx, dy, dtheta = np.array([2.0, 0.0, turn]) + random.normal(size=3) * (0.02, 0.02, 0.01)
            at, heading = at + 2.0 * np.exp(1j * heading), heading + turn
            lines.append(f"ODOMETRY {k - 1} {k} {dx} {dy} {dtheta} 50 0 0 50 0 100")
        seen = (trees - at) * np.exp(-1j * heading)
        for j in np.flatnonzero(abs(seen) < 8.0):
            x, y = np.array([seen[j].real, seen[j].imag]) + 0.1 * random.normal(size=2)
            lines.append(f"LANDMARK {k} {j} {x} {y} 10 0 10")
    path.write_text("\n".join(lines) + "\n")
    return path
