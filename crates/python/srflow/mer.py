"""Micro-expressions: features and leave-one-subject-out; expressions in videos, and their classes.

>>> features = numpy.load("features.npz")  # of `srflow mer features`
>>> result = srflow.mer.loso(features, lambda x, y, test: classify(x, y, test))
>>> result["last"]["uf1"]

>>> found = srflow.mer.spot("interview.mp4", face="detect")
>>> found["events"], found["curves"]["regions"].shape

>>> model = srflow.mer.load_model("rendered")
>>> model(srflow.mer.features(onset, apex))["class"]
"""

from ._spotting import predict, spot
from ._srflow import mer as _mer

Model = _mer.Model
features = _mer.features
load_model = _mer.load_model
loso = _mer.loso
metrics = _mer.metrics
regions = _mer.regions
strain = _mer.strain

__all__ = ["Model", "features", "load_model", "loso", "metrics", "predict", "regions", "spot", "strain"]
