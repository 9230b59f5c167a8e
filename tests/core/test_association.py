"""Laws of data association: distances from their definition, and each method against all there is to choose from."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from submaps.association.assignment import assignment, costs
from submaps.association.candidates import Candidates, Readings, candidates
from submaps.association.joint import joint
from submaps.association.known import known
from submaps.association.methods import METHODS, Method
from submaps.association.readings import predicted_readings
from submaps.association.result import AMBIGUOUS, NEW, Association, Gates
from submaps.geometry.logarithm import log
from submaps.observation.models import MODELS, sensor_of
from tests.core.filters import SENSORS, difference, plus, seen, space_of
from tests.core.support import jacobian, random_covariance, wrapped

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
GATES = Gates(0.99, 0.99999)
Pairs = tuple[tuple[int, int], ...]


def world(rng: np.random.Generator, n: int, d: int = 2, pose: int = 3, apart: float = 1.0) -> Readings:
    """Readings of n landmarks, about ``apart`` from each other, that err together through a pose and little alone."""
    share = np.where(np.arange(pose + d * n) < pose, 1.0, 0.2)
    P = random_covariance(rng, pose + d * n) * np.outer(share, share)
    own = pose + d * np.arange(n)[:, np.newaxis] + np.arange(d)
    entries = np.concatenate([np.tile(np.arange(pose), (n, 1)), own], axis=1)
    H = rng.normal(size=(n, d, pose + d))
    H[:, :, :pose] = H[0, :, :pose] + 0.2 * H[:, :, :pose]
    h = rng.uniform(-1.0, 1.0, size=(n, d)) * apart * 3.0
    return Readings(h, H, entries, P, np.zeros(d, dtype=np.uint8))


def dense(readings: Readings) -> Floats:
    """The Jacobian (n d, N) of all readings by the whole state."""
    n, d, _ = readings.H.shape
    whole = np.zeros((n, d, readings.P.shape[0]))
    for j in range(n):
        whole[j][:, readings.entries[j]] = readings.H[j]
    return whole.reshape(n * d, -1)


def drawn(rng: np.random.Generator, n: int, m: int, d: int = 2, apart: float = 3.0) -> tuple[Candidates, Ints]:
    """Observations of some of the landmarks, as the state's own uncertainty has them err; and of what they are."""
    readings = world(rng, n, d, apart=apart)
    H, R = dense(readings), random_covariance(rng, d, 0.2)
    truth = readings.h + (H @ rng.multivariate_normal(np.zeros(H.shape[1]), readings.P)).reshape(n, d)
    seen = rng.permutation(n)[:m]
    z = truth[seen] + rng.multivariate_normal(np.zeros(d), R, size=seen.size)
    stray = rng.uniform(-4.0, 4.0, size=(m - seen.size, d)) * apart
    return candidates(readings, np.concatenate([z, stray]), R[np.newaxis]), seen


def test_distances_are_those_of_their_definition() -> None:
    rng = np.random.default_rng(0)
    for d, pose in ((1, 3), (2, 3), (3, 6)):
        readings = world(rng, 5, d, pose)
        z, R = rng.normal(size=(4, d)), np.stack([random_covariance(rng, d) for _ in range(4)])
        found = candidates(readings, z, R)
        S_all = dense(readings) @ readings.P @ dense(readings).T
        for i, j in itertools.product(range(4), range(5)):
            v, S = z[i] - readings.h[j], S_all[d * j : d * j + d, d * j : d * j + d] + R[i]
            assert np.allclose(found.innovation[i, j], v)
            assert np.allclose(found.covariance[i, j], S)
            squared = v @ np.linalg.solve(S, v)
            assert found.squared[i, j] == pytest.approx(squared, rel=1e-12)
            ratio = np.linalg.slogdet(S)[1] - np.linalg.slogdet(R[i])[1]
            assert found.distance[i, j] == pytest.approx(squared + ratio, rel=1e-12)
        chosen = np.array([4, 0, 2])
        joint_v, joint_S = found.joint(np.array([1, 3, 0]), chosen)
        rows = (d * chosen[:, np.newaxis] + np.arange(d)).ravel()
        expected = S_all[np.ix_(rows, rows)]
        for k, i in enumerate((1, 3, 0)):
            expected[d * k : d * k + d, d * k : d * k + d] += R[i]
        assert np.allclose(joint_S, expected)
        assert np.allclose(joint_v, (z[[1, 3, 0]] - readings.h[chosen]).ravel())


def test_an_angle_is_wrapped() -> None:
    readings = world(np.random.default_rng(1), 1)
    readings.h[0] = (5.0, 3.1)
    angular = Readings(readings.h, readings.H, readings.entries, readings.P, np.array([0, 1], dtype=np.uint8))
    found = candidates(angular, np.array([[9.0, -3.1]]), np.eye(2)[np.newaxis])
    assert np.allclose(found.innovation[0, 0], (4.0, wrapped(-6.2)))


def test_the_logarithm_is_good_to_an_ulp() -> None:
    rng = np.random.default_rng(2)
    for x in np.concatenate([np.exp(rng.uniform(-700.0, 700.0, 500)), rng.uniform(0.5, 2.0, 500), [1.0, 5e-324]]):
        assert abs(log(x) - math.log(x)) <= np.spacing(abs(math.log(x)))


def test_what_has_no_covariance_is_no_candidate() -> None:
    readings = world(np.random.default_rng(3), 2)
    readings.P[:] = np.nan
    found = candidates(readings, readings.h.copy(), np.eye(2)[np.newaxis])
    assert np.isinf(found.squared).all()
    assert np.isinf(found.distance).all()
    for method in METHODS.values():
        assert method(found, GATES).landmark.tolist() == [NEW, NEW]


# -- laws of every method ----------------------------------------------------------------------


def everything() -> Iterator[Candidates]:
    """Problems of every size, crowded and roomy."""
    rng = np.random.default_rng(4)
    for d, n, m, apart in itertools.product((1, 2, 3), (0, 1, 4, 9), (0, 1, 5), (0.7, 3.0, 12.0)):
        if n == 0:
            nothing = Readings(
                np.empty((0, d)), np.empty((0, d, 3 + d)), np.empty((0, 3 + d), dtype=np.int64), np.eye(3),
                np.zeros(d, dtype=np.uint8),
            )  # fmt: skip
            yield candidates(nothing, rng.normal(size=(m, d)), np.eye(d)[np.newaxis])
        else:
            yield drawn(rng, n, m, d, apart)[0]


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_gates_hold(method: Method) -> None:
    seen = {"matched": 0, "new": 0, "ambiguous": 0}
    for c in everything():
        found = method(c, GATES)
        d = c.readings.dimension
        inner, outer = chi2.ppf(0.99, d), chi2.ppf(0.99999, d)
        matched = found.landmark[found.matched]
        assert len(set(matched.tolist())) == matched.size  # a landmark is seen once a step
        assert found.complete
        for i, landmark in enumerate(found.landmark.tolist()):
            least = c.squared[i].min(initial=np.inf)
            if landmark >= 0:
                assert c.squared[i, landmark] <= inner * (1.0 + 1e-9)
                assert (found.nearest[i], found.squared[i]) == (landmark, c.squared[i, landmark])
            elif landmark == NEW:
                assert least > outer * (1.0 - 1e-9)
            else:
                assert landmark == AMBIGUOUS
                assert least <= outer * (1.0 + 1e-9)
                assert found.squared[i] == least == c.squared[i, found.nearest[i]]
            seen["matched" if landmark >= 0 else "new" if landmark == NEW else "ambiguous"] += 1
    assert min(seen.values()) > 5


@pytest.mark.parametrize("name", ["greedy", "assignment"])
def test_no_free_landmark_within_its_gate_is_left(name: str) -> None:
    """Joint compatibility may leave one: where it does not fit the others."""
    alone = 0
    for c in everything():
        found = METHODS[name](c, GATES)
        free = np.setdiff1d(np.arange(c.landmarks), found.landmark)
        assert (c.squared[np.ix_(~found.matched, free)] > GATES.bound(c.readings.dimension)).all()
        alone += int(np.count_nonzero(~found.matched))
    assert alone > 50


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_landmarks_far_apart_are_found(method: Method) -> None:
    rng = np.random.default_rng(5)
    right = wrong = 0
    for _ in range(200):
        c, seen = drawn(rng, 8, 5, apart=1000.0)
        found = method(c, GATES).landmark
        right += int(np.count_nonzero(found == seen))
        wrong += int(np.count_nonzero((found >= 0) & (found != seen)))
    # One in a hundred lies beyond the gate, three standard deviations of which are allowed for here.
    assert wrong == 0
    assert abs(right / 1000 - 0.99) < 3.0 * math.sqrt(0.99 * 0.01 / 1000) + 0.01


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_a_vague_landmark_does_not_take_what_a_sure_one_explains(method: Method) -> None:
    """Both are within their gates, and d^2 is the smaller for the vague one: its likelihood is not."""
    h, H = np.array([[0.0], [1.0]]), np.ones((2, 1, 1))
    readings = Readings(h, H, np.array([[0], [1]]), np.diag([0.01, 100.0]), np.zeros(1, dtype=np.uint8))
    c = candidates(readings, np.array([[0.2]]), np.full((1, 1, 1), 0.01))
    assert c.squared[0, 1] < c.squared[0, 0] < GATES.bound(1)
    assert method(c, GATES).landmark.tolist() == [0]


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_ties_are_broken_alike_every_time(method: Method) -> None:
    h, H = np.array([[-1.0], [1.0]]), np.ones((2, 1, 1))
    readings = Readings(h, H, np.array([[0], [1]]), np.eye(2), np.zeros(1, dtype=np.uint8))
    c = candidates(readings, np.zeros((2, 1)), np.ones((1, 1, 1)))
    assert np.unique(c.squared).size == 1
    found = [method(c, GATES).landmark.tolist() for _ in range(5)]
    assert sorted(found[0]) == [0, 1]
    assert found == [found[0]] * 5


# -- against everything there is to choose from ------------------------------------------------


def pairings(m: int, n: int) -> Iterator[Pairs]:
    """Every way to give observations landmarks, none of them twice."""
    for choice in itertools.product(range(-1, n), repeat=m):
        used = [j for j in choice if j >= 0]
        if len(set(used)) == len(used):
            yield tuple((i, j) for i, j in enumerate(choice) if j >= 0)


def as_pairs(found: Association) -> Pairs:
    return tuple((i, int(j)) for i, j in enumerate(found.landmark) if j >= 0)


@pytest.mark.parametrize("apart", [0.4, 1.0, 3.0])
def test_the_assignment_is_the_best_there_is(apart: float) -> None:
    rng = np.random.default_rng(6)
    contested = 0
    for _ in range(60):
        c, _ = drawn(rng, 4, 4, apart=apart)
        cost = costs(c, GATES)

        def total(pairs: Pairs, c: Candidates = c, cost: Floats = cost) -> float:
            alone = set(range(4)) - {i for i, _ in pairs}
            return float(sum(cost[i, j] for i, j in pairs) + sum(cost[i, c.landmarks + i] for i in alone))

        best = min(map(total, pairings(4, 4)))
        found = as_pairs(assignment(c, GATES))
        assert total(found) == pytest.approx(best, rel=1e-12)
        contested += found != as_pairs(METHODS["greedy"](c, GATES))
    assert contested > (1 if apart < 3.0 else -1)


def hypotheses(c: Candidates, gates: Gates) -> Iterator[tuple[Pairs, float]]:
    """Every hypothesis that is jointly compatible, as are those on the way to it; and its score."""
    d = c.readings.dimension
    within = c.squared <= gates.bound(d)
    rows = np.argsort(within.sum(axis=1), kind="stable")
    noise = np.linalg.slogdet(c.noise)[1]

    def grown(pairs: Pairs, score: float, rest: list[int]) -> Iterator[tuple[Pairs, float]]:
        if not rest:
            yield pairs, score
            return
        i = rest[0]
        yield from grown(pairs, score, rest[1:])
        for j in np.flatnonzero(within[i]).tolist():
            if j not in [landmark for _, landmark in pairs]:
                longer = (*pairs, (i, j))
                v, S = c.joint(*np.array(longer).T)
                squared = float(v @ np.linalg.solve(S, v))
                if squared <= gates.bound(d * len(longer)):
                    ratio = np.linalg.slogdet(S)[1] - noise[[a for a, _ in longer]].sum()
                    yield from grown(longer, squared + float(ratio), rest[1:])

    yield from grown((), 0.0, rows.tolist())


def test_joint_compatibility_finds_the_largest_and_the_likeliest_of_these() -> None:
    rng = np.random.default_rng(7)
    refused = otherwise = 0
    for d, apart in [(1, 1.0), (2, 0.4), (2, 1.0), (2, 3.0), (3, 0.7)] * 30:
        c, _ = drawn(rng, 5, 4, d, apart)
        every = list(hypotheses(c, GATES))
        most = max(len(pairs) for pairs, _ in every)
        least = min(score for pairs, score in every if len(pairs) == most)
        found = joint(c, GATES)
        assert found.complete
        pairs = as_pairs(found)
        assert len(pairs) == most
        score = next(s for p, s in every if set(p) == set(pairs))
        assert score == pytest.approx(least, rel=1e-9, abs=1e-9)
        alone = as_pairs(assignment(c, GATES))
        refused += most < len(alone)
        otherwise += alone != pairs
    assert refused > 0  # pairs that fit alone and not together
    assert otherwise > 20


def test_an_error_that_all_share_misleads_each_alone_and_not_all_together() -> None:
    """All readings are off by 0.6, as the pose is: the first and the third are nearer to a neighbour."""
    along = np.array([0.0, 1.0, 2.5, 3.5, 5.5])
    n = along.size
    h = np.stack([along, np.zeros(n)], axis=1)
    H = np.concatenate([np.tile(-np.eye(2), (n, 1, 1)), np.tile(np.eye(2), (n, 1, 1))], axis=2)
    entries = np.stack([[0, 1, 2 + 2 * j, 3 + 2 * j] for j in range(n)])
    P = np.diag([0.25, 0.25, *([1e-4] * 2 * n)])
    readings = Readings(h, H, entries, P, np.zeros(2, dtype=np.uint8))
    c = candidates(readings, h[[0, 1, 2]] + (0.6, 0.0), 1e-4 * np.eye(2)[np.newaxis])
    assert METHODS["greedy"](c, GATES).landmark.tolist() == [1, 2, 3]
    assert joint(c, GATES).landmark.tolist() == [0, 1, 2]


def test_a_search_that_is_cut_short_says_so_and_fits_together() -> None:
    rng = np.random.default_rng(8)
    cut = 0
    for _ in range(20):
        c, _ = drawn(rng, 8, 8, apart=0.4)
        whole = joint(c, GATES)
        for most in (1, 5, 20):
            found = joint(c, GATES, most)
            assert found.nodes <= most
            assert found.complete == (whole.nodes <= most)
            pairs = as_pairs(found)
            assert len(pairs) <= len(as_pairs(whole))
            if pairs:
                v, S = c.joint(*np.array(pairs).T)
                assert v @ np.linalg.solve(S, v) <= GATES.bound(2 * len(pairs)) * (1.0 + 1e-9)
            cut += not found.complete
    assert cut > 20


def test_known_identities_are_taken_as_they_are() -> None:
    c, _ = drawn(np.random.default_rng(9), 3, 3)
    found = known(c, np.array([7, 5, 6]), np.array([5, 6, 8]))
    assert found.landmark.tolist() == [NEW, 0, 1]
    assert found.squared.tolist() == [np.inf, c.squared[1, 0], c.squared[2, 1]]
    nothing = drawn(np.random.default_rng(9), 1, 0)[0]
    assert known(nothing, np.empty(0, dtype=np.int64), np.array([5])).landmark.size == 0


# -- a state -----------------------------------------------------------------------------------


@pytest.mark.parametrize("invariant", [True, False])
@pytest.mark.parametrize("name", SENSORS)
def test_a_state_reads_as_numeric_derivatives_say(name: str, invariant: bool) -> None:
    """The last two landmarks err by themselves, additively; the others in the filter's own error."""
    rng = np.random.default_rng(10)
    sensor = SENSORS[name]
    space, channels = space_of(sensor), len(sensor.channels)
    dim, pose, size = space.dim, space.pose, space.pose + 4 * space.dim
    x = np.concatenate([0.3 * rng.normal(size=pose), rng.uniform(2.0, 6.0, 4 * dim)])
    P = random_covariance(rng, size, 0.1)
    readings = predicted_readings(
        space, x, P, 4, MODELS[sensor.model], sensor_of(space, sensor), channels, invariant, carried=2
    )
    for j in range(4):
        slot = pose + dim * j
        base = seen(sensor, x, slot)

        def reading(xi: Floats, slot: int = slot, base: Floats = base) -> Floats:
            moved = plus(space, x, xi, invariant)
            moved[pose + 2 * dim :] = x[pose + 2 * dim :] + xi[pose + 2 * dim :]
            return difference(sensor, seen(sensor, moved, slot), base)

        expected = jacobian(reading, np.zeros(size), 1e-3)
        found = dense(readings)[channels * j : channels * j + channels]
        assert np.allclose(readings.h[j], base, rtol=1e-12)
        assert np.allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    wrap_last = difference(sensor, np.full(channels, 3.0), np.full(channels, -3.0)) < 5.0
    assert readings.angular.astype(bool).tolist() == wrap_last.tolist()
