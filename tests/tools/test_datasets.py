"""Readers of recorded runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.datasets import VICTORIA_PARK, Dataset, DatasetError, read_source
from service.datasets.dataset import cut
from service.datasets.isam import parse_isam, read_isam
from service.datasets.lines import NoiseForm
from tests.tools.fleet import LANDMARKS, dataset, drive

CHAIN = [
    "ODOMETRY 0 1 1.0 0 0.1 100 0 0 500 0 250",
    "LANDMARK 0 7 4 1 2 0 2",
    "EDGE2 1 2 1.0 0 0.2 100 0 0 500 0 250",
    "LANDMARK 2 7 2 1 2 0 2",
    "LANDMARK 1 1 3 1 2 0 2",
]


def parse(lines: list[str], noise: NoiseForm = "sqrt_information") -> Dataset:
    return parse_isam(lines, noise=noise, name="run", source="run.txt")


def test_pose_k_of_the_chain_is_step_k_and_the_first_has_no_control() -> None:
    run = parse(CHAIN)
    assert run.columns.t.tolist() == [0.0, 1.0, 2.0]
    assert run.columns.control_step.tolist() == [1, 2]
    assert run.columns.control.tolist() == [[1.0, 1.0], [0.0, 0.0], [0.1, 0.2]]


def test_observations_belong_to_the_step_of_their_pose_wherever_their_lines_stand() -> None:
    run = parse(CHAIN)
    assert run.columns.observation_step.tolist() == [0, 1, 2]
    assert run.columns.landmark == ("7", "1", "7")  # one counter or two: ids of landmarks are names
    assert run.columns.z.tolist() == [[4.0, 3.0, 2.0], [1.0, 1.0, 1.0]]


def test_a_diagonal_root_of_the_information_gives_sigma_and_no_covariances() -> None:
    run = parse(CHAIN)
    assert run.motion.sigma == pytest.approx((0.01, 0.002, 0.004), rel=1e-15)
    assert run.observation.sigma == (0.5, 0.5)
    assert run.columns.control_covariance is None
    assert run.columns.observation_covariance is None


def test_a_full_triangle_gives_the_inverse_of_its_information() -> None:
    root = np.array([[10.0, 1.0, -2.0], [0.0, 20.0, 3.0], [0.0, 0.0, 30.0]])
    run = parse(["ODOMETRY 0 1 1 0 0 10 1 -2 20 3 30", "LANDMARK 1 1 1 1 4 1 5"])
    assert run.columns.control_covariance is not None
    assert run.columns.observation_covariance is not None
    np.testing.assert_allclose(run.columns.control_covariance[0] @ root.T @ root, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(run.motion.sigma, np.sqrt(np.diagonal(run.columns.control_covariance[0])))
    assert run.columns.observation_covariance[0, 0, 1] != 0.0


def test_noise_that_varies_stays_with_its_line() -> None:
    run = parse([*CHAIN, "LANDMARK 0 9 1 1 4 0 4"])
    assert run.columns.landmark == ("7", "9", "1", "7")
    assert run.columns.observation_covariance is not None
    np.testing.assert_allclose(run.columns.observation_covariance[:, 0, 0], [0.25, 0.0625, 0.25, 0.25])


def test_covariances_are_read_as_such() -> None:
    run = parse(["ODOMETRY 0 1 1 0 0 4 0 0 9 0 16", "LANDMARK 0 1 1 1 4 1 4"], "covariance")
    assert run.motion.sigma == (2.0, 3.0, 4.0)
    assert run.columns.observation_covariance is not None
    assert run.columns.observation_covariance[0].tolist() == [[4.0, 1.0], [1.0, 4.0]]


def test_comments_and_empty_lines_are_passed_over() -> None:
    assert parse(["# a run", "", *CHAIN]).columns.steps == 3


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("ODOMETRY 2 3 1 0 0 1 0 0 1 0", "takes 12 fields"),
        ("LANDMARK 2 3 1 0 1 0 1 9", "takes 8 fields"),
        ("LANDMARK 2 3 1 zero 1 0 1", "expected a finite number, got 'zero'"),
        ("LANDMARK 2 3 nan 0 1 0 1", "expected a finite number, got 'nan'"),
        ("LANDMARK two 3 1 0 1 0 1", "expected a pose id, got 'two'"),
        ("LANDMARK 9 3 1 0 1 0 1", "expected the id of a pose that an earlier line leads to, got 9"),
        ("LANDMARK 2 3 1 0 1 0 0", "zero on its diagonal"),
        ("ODOMETRY 1 3 1 0 0 1 0 0 1 0 1", "expected an edge from pose 2, the last one, to a new pose, got 1 to 3"),
        ("EDGE2 2 0 1 0 0 1 0 0 1 0 1", "to a new pose, got 2 to 0"),
        ("VERTEX2 0 0 0 0", "expected ODOMETRY, EDGE2 or LANDMARK, got 'VERTEX2'"),
    ],
)
def test_a_broken_line_is_named_with_what_was_expected(line: str, says: str) -> None:
    with pytest.raises(DatasetError) as caught:
        parse([*CHAIN, line])
    assert str(caught.value).startswith("run.txt:6: ")
    assert says in str(caught.value)


def test_noise_that_is_no_covariance_is_refused() -> None:
    with pytest.raises(DatasetError, match=r"run\.txt:2: the noise is no positive definite covariance"):
        parse([CHAIN[0], "LANDMARK 1 3 1 0 1 2 1"], "covariance")


def test_an_empty_file_is_refused() -> None:
    with pytest.raises(DatasetError, match="expected ODOMETRY"):
        parse([])


def test_a_missing_file_says_what_can_be_given(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=rf"no such file; give .* {VICTORIA_PARK}"):
        read_source(str(tmp_path / "none.txt"))


def test_a_folder_and_a_file_that_is_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DatasetError, match=r"a folder without Barcodes\.dat"):
        read_source(str(tmp_path))
    with pytest.raises(DatasetError, match="cannot be read"):
        read_isam(tmp_path)
    with pytest.raises(DatasetError, match="not a text file"):
        read_source(str(tmp_path / "binary.txt"))


@pytest.mark.parametrize(("observations", "steps"), [(1, 10), (2, 10), (1000, 1), (1000, 2), (1000, 10)])
def test_batches_hold_the_run_in_order_within_their_bounds(observations: int, steps: int) -> None:
    run = parse([*CHAIN, "LANDMARK 2 8 1 1 4 0 4"])
    parts = [part for _, part in run.batches(observations, steps)]
    assert np.concatenate([part.t for part in parts]).tolist() == run.columns.t.tolist()
    assert np.concatenate([part.z for part in parts], axis=1).tolist() == run.columns.z.tolist()
    assert sum((part.landmark for part in parts), ()) == run.columns.landmark
    assert np.concatenate([part.control for part in parts], axis=1).tolist() == run.columns.control.tolist()
    for part in parts:
        assert part.steps <= steps
        assert part.observations <= observations or part.steps == 1
        assert part.observation_covariance is not None
        assert part.observation_covariance.shape == (part.observations, 2, 2)


def test_a_cut_counts_its_steps_from_zero() -> None:
    part = cut(parse(CHAIN).columns, 1, 3)
    assert part.control_step.tolist() == [0, 1]
    assert part.observation_step.tolist() == [0, 1]


def test_victoria_park_and_city_trees_hold_what_is_known_of_them(data_dir: Path) -> None:
    park = read_source(str(data_dir / "isam" / "victoriaPark.txt"))
    city = read_source(str(data_dir / "isam" / "cityTrees10000.txt"))
    assert (park.columns.steps, len(set(park.columns.landmark)), park.columns.observations) == (6969, 151, 3640)
    assert (city.columns.steps, len(set(city.columns.landmark)), city.columns.observations) == (10000, 100, 4443)
    assert park.motion.sigma == pytest.approx((0.01, 0.002, 0.002), rel=1e-12)
    assert city.observation.sigma == pytest.approx((0.1, 0.1), rel=1e-12)


def test_the_copy_in_gtsam_has_the_same_numbers(data_dir: Path) -> None:
    shipped = read_source(VICTORIA_PARK)
    park = read_source(str(data_dir / "isam" / "victoriaPark.txt"))
    np.testing.assert_array_equal(shipped.columns.z, park.columns.z)
    np.testing.assert_array_equal(shipped.columns.control, park.columns.control)
    assert shipped.columns.landmark == park.columns.landmark
    assert shipped.observation.sigma == pytest.approx(park.observation.sigma, rel=1e-6)


def test_a_run_of_one_robot_is_not_cut_by_time() -> None:
    run = dataset(drive(0.0))
    alone = Dataset(run.name, run.config, {"ann": run.robots["ann"]})
    assert [robot for robot, _ in alone.batches(window=1.0)] == ["ann"]
    assert alone.columns is run.robots["ann"]
    with pytest.raises(ValueError, match="too many values"):
        _ = run.columns


@pytest.mark.parametrize(("observations", "window"), [(1000, 10.0), (1000, 3.7), (5, 10.0), (1000, 1e9)])
def test_robots_take_turns_in_the_order_in_which_their_batches_end(observations: int, window: float) -> None:
    run = dataset(drive(0.0))
    parts = list(run.batches(observations, window=window))
    ends = [float(part.t[-1]) for _, part in parts]
    assert ends == sorted(ends)
    for _, part in parts:
        assert np.floor(part.t[0] / window) == np.floor(part.t[-1] / window)
        assert part.observations <= max(observations, len(LANDMARKS) + 1)
    for robot, whole in run.robots.items():
        own = [part for name, part in parts if name == robot]
        assert np.concatenate([part.t for part in own]).tolist() == whole.t.tolist()
        assert sum((part.landmark for part in own), ()) == whole.landmark
        assert np.concatenate([part.control for part in own], axis=1).tolist() == whole.control.tolist()
    assert run.steps == sum(part.steps for _, part in parts)
    assert run.observations == sum(part.observations for _, part in parts)
