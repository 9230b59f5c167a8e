"""Where things stand in the arrays that compiled code and Python share."""

from __future__ import annotations

# What the walk comes back for.
DONE, GENESIS, GROW = 0, 1, 2
# Places in a sub-map's ``counts``: state dimension, steps with observations, steps, observations
# used, observations rejected.
DIM, OBSERVED, STEPS, OBSERVATIONS, REJECTED, COUNTS = 0, 1, 2, 3, 4, 5
# Places in ``motion``: sum of NIS, the number of observations that it sums, then the pending increment
# (as many numbers as a pose has) and its covariance (row order).
NIS_SUM, NIS_COUNT, PENDING = 0, 1, 2
# Places in the integer settings. ``MOTIONLESS``: nothing is known of the motion.
MODEL, INVARIANT, MAX_LANDMARKS, MIN_OBSERVED, MOTIONLESS = 0, 1, 2, 3, 4
# Places in the real settings: then the sensor, and the body itself as one (``observation.models``).
GATE, FLAG, MAX_HEADING_VARIANCE, MAX_POSITION_VARIANCE, SENSOR = 0, 1, 2, 3, 4


def motion_size(pose: int) -> int:
    """Length of ``motion`` where a pose has ``pose`` numbers."""
    return PENDING + pose + pose * pose
