"""SLAM without odometry: a flat prior on every pose, the one before marginalised, the new one by maximum likelihood.

After Klečka, "Comparison of different approaches to adaptation of unscented Kalman filter for
non-odometry SLAM", 2018, called the paper below. Where its equations are misprinted they are
corrected, each beside its code:

- eq. 2: the variable of integration is x_(i−1).
- weights (after eq. 6): λ = α²(L + κ) − L, W_k = 1/(2(L + λ)); as printed they sum to 1.99 at α = 0.1, and
  the sigma points carry twice the covariance (``filtering/unscented.py``).
- eq. 15, 16, 17: the weight's index is the sum's k, not the view's i. In 17 the sum runs over k, and the
  bracket closes after the measurement's deviation, before S⁻¹: each term of the sum is a product.
- eq. 18: the mean of the pose before the update is Σ W_k χ_k^x, as in 17, which differs from eq. 21's
  in the third variant; K is of the tangent space, so the update retracts.
- eq. 19: the pose would be left without uncertainty of its own, and with less than none after the
  update. Given the map the view leaves it (HₓᵀR⁻¹Hₓ)⁻¹; the sigma points' spread comes on top, and so
  does their covariance with the map, which is printed as 0 (``moments.py``).
- eq. 20, 7: L is the dimension of the map alone; the pose has no sigma points of its own.
- eq. 23: a gradient of ℓ has the other sign, Hₓᵀ R⁻¹ (z − h − ...); its zero, eq. 24, is not touched.
- eq. 25: the map's sigma point is χ_k of i|i−1, not of N|N−1.
"""
