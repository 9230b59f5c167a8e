"""The estimators of the lectures in plain NumPy, composed: filter × retraction × motion × observation.

Here the equations are read, and the compiled kernel is held against them. Nothing here is on the
main path.

- ``space``: what the plane and other spaces are made of; ``retraction``: the standard and the
  right-invariant error.
- ``motion``: controls to body-frame increments; ``observation``: readings of a point, and
  ``compiled`` those of the main path.
- ``ekf``: predict, augment, update. ``moments``: the same filter with other moments than a
  linearisation's: of second order, and exact ones.
"""
