"""Two calibrated cameras: epipolar geometry, motion up to scale, depth.

After Forsyth, "EKF SLAM" (lecture), part "Two calibrated cameras yield 3D points". Its frames: X is a
point in camera one's coordinates and X' = R (X − t) in camera two's, so that t is where camera two
stands in camera one's frame. Coordinates of a camera are (right, down, forward), image points
y = (x₁/x₃, x₂/x₃).

Correspondences are taken to be right: wrong matches are for the matcher to remove, whose library knows
the images (OpenCV's ``findFundamentalMat`` returns a mask of those that fit).
"""
