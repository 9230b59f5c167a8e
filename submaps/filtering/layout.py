"""Where things stand in the arrays that compiled code and Python share."""

from __future__ import annotations

# What the walk comes back for.
DONE, GENESIS, GROW = 0, 1, 2
# Places in a sub-map's ``counts``: state dimension, steps with observations, steps, observations
# used, observations rejected.
DIM, OBSERVED, STEPS, OBSERVATIONS, REJECTED, COUNTS = 0, 1, 2, 3, 4, 5
# Places in ``motion``: pending increment (3), its covariance (9, row order), sum of NIS, and the
# number of observations that it sums.
NOISE, NIS_SUM, NIS_COUNT, MOTION = 3, 12, 13, 14
# Places in the integer and real settings.
MODEL, INVARIANT, MAX_LANDMARKS, MIN_OBSERVED = 0, 1, 2, 3
MOUNT, GATE, FLAG, MAX_HEADING_VARIANCE, MAX_POSITION_VARIANCE, BODY = 0, 4, 5, 6, 7, 8
