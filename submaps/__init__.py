"""Submaps: SLAM in large maps by many small, bounded EKF sub-maps."""
