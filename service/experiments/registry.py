"""Experiments by name. A module is imported when its experiment is asked for, and not before."""

from __future__ import annotations

from importlib import import_module

from service.experiments.base import Experiment

# Name -> module that exposes it as EXPERIMENT.
REGISTRY = {
    "association": "service.experiments.association",
    "banana": "service.experiments.banana",
    "beads": "service.experiments.beads",
    "flatland": "service.experiments.flatland",
    "nonodometry": "service.experiments.nonodometry",
    "phantom": "service.experiments.phantom",
    "scaling": "service.experiments.scaling",
    "stereo": "service.experiments.stereo",
}


def load(name: str) -> Experiment:
    """The experiment of a name in ``REGISTRY``; raises ``KeyError``."""
    experiment = import_module(REGISTRY[name]).EXPERIMENT
    assert isinstance(experiment, Experiment)
    return experiment
