"""Recognizing micro-expressions: what classifiers see of a clip, leave-one-subject-out, and its metrics.

>>> features = numpy.load("features.npz")  # of `srflow mer features`
>>> result = srflow.mer.loso(features, lambda x, y, test: classify(x, y, test))
>>> result["last"]["uf1"]
"""

from ._srflow import mer as _mer

features = _mer.features
loso = _mer.loso
metrics = _mer.metrics
strain = _mer.strain

__all__ = ["features", "loso", "metrics", "strain"]
