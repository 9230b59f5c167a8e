"""The same measurements give the same bits, whatever the processor is said to be.

The variant with another code generator compiles the whole kernel, about half a minute on a slow
core the first time; Numba's cache, which keeps processors apart, has it from then on.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.core.drive_digest import digests
from tests.core.support import R, after

VARIANTS = {
    "again": {},
    "plain": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "older": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-AVX2_Usable,-FMA,-FMA_Usable,-AVX512F",
        "OPENBLAS_CORETYPE": "Prescott",
    },
}


@pytest.fixture(scope="module")
def measurements(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of two rounds among twenty landmarks, with noise."""
    rng = np.random.default_rng(0)
    angle = 2.0 * np.pi * np.arange(20) / 20
    world = np.stack([12.0 * np.sin(angle), 10.0 - 12.0 * np.cos(angle)], axis=1)
    pose, step, name, z = np.zeros(3), [], [], []
    for k in range(200):
        if k:
            pose = after(pose, np.array([np.sin(0.07), 1.0 - np.cos(0.07), 0.07]) / (0.07, 0.07, 1.0))
        local = ((world - pose[:2]) @ R(pose[2]) - (0.3, -0.1)) @ R(0.2)
        for i in np.flatnonzero(np.hypot(local[:, 0], local[:, 1]) < 6.0):
            step.append(k)
            name.append(i)
            reading = np.hypot(*local[i]), np.arctan2(local[i, 1], local[i, 0])
            z.append(np.array(reading) + rng.normal(size=2) * (0.1, 0.01))
    control = np.array([[1.0], [0.07]]) + rng.normal(size=(2, 199)) * [[0.05], [0.02]]
    path = tmp_path_factory.mktemp("drive") / "measurements.npz"
    np.savez(
        path, t=np.arange(200.0), control_step=np.arange(1, 200), control=control,
        observation_step=np.array(step), landmark=np.array(name), z=np.ascontiguousarray(np.array(z).T),
    )  # fmt: skip
    return path


def test_other_processors_give_the_same_bits(measurements: Path) -> None:
    columns = measurements.with_name("columns.npz")
    expected = digests(measurements, columns)
    assert digests(measurements, columns) == expected
    assert len(set(expected)) == len(expected) == 9
    command = [sys.executable, "-m", "tests.core.drive_digest", str(measurements), str(columns)]
    for name, changes in VARIANTS.items():
        env = os.environ | changes
        done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=1200, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines() == expected, name
