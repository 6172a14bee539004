"""Types of the functions; their documentation is in the module. Written by crates/python/stubs.py."""

import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import NotRequired

class Scores(TypedDict):
    p_m: float
    r_m: float
    f1_m: float
    f1_mu: float
    g_m: float
    uf1: float
    uar: float
    confusion: NDArray[np.int64]

class Results(TypedDict):
    last: dict[str, Any]
    best: list[dict[str, Any]]
    seeds: NotRequired[list[dict[str, Any]]]
    epochs: list[dict[str, Any]]
    baseline: dict[str, Any]
    folds: list[dict[str, Any]]
    classes: list[str]
    predictions: NDArray[np.int64]

class Spotted(TypedDict):
    events: list[dict[str, Any]]
    regions: list[str]
    curves: dict[str, NDArray[Any]]

Recognition = TypedDict(
    "Recognition",
    {"probabilities": dict[str, float], "class": str | None, "most_probable": str, "doubt": str | None},
)

def spot(
    video: str | os.PathLike[str], *, out: str | os.PathLike[str] | None = None, **options: Any
) -> Spotted: ...
def predict(
    model: str | os.PathLike[str],
    inputs: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    out: str | os.PathLike[str] | None = None,
    **options: Any,
) -> list[dict[str, Any]]: ...

class Model:
    @property
    def classes(self) -> list[str]: ...
    def card(self) -> dict[str, Any]: ...
    def __call__(
        self, features: ArrayLike, /, *, face_px: int | None = None, least_probability: float = 0.5
    ) -> Recognition: ...

def features(
    onset: ArrayLike,
    apex: ArrayLike,
    method: str | None = None,
    *,
    protocol: str = "srflow",
    resize: str | None = None,
    head_motion: str | None = None,
    strain: str = "literature",
    **options: Any,
) -> NDArray[np.float32]: ...
def regions(which: str = "parts", landmarks: ArrayLike | None = None) -> tuple[list[str], NDArray[np.int64]]: ...
def strain(flow: ArrayLike, formula: str = "literature") -> NDArray[np.float32]: ...
def metrics(
    truth: ArrayLike, predicted: ArrayLike, subjects: Iterable[object], *, classes: int | None = None
) -> Scores: ...
def loso(
    features: Mapping[str, Any],
    classifier: Callable[[NDArray[Any], NDArray[np.int64], NDArray[Any]], ArrayLike] | str | None = None,
    *,
    callback: Callable[[dict[str, int]], object] | None = None,
    folder: str | os.PathLike[str] | None = None,
    epochs: int | None = None,
    record_every: int | None = None,
    batch: int | None = None,
    learning_rate: float | None = None,
    seed: int | None = None,
    seeds: int | None = None,
) -> Results: ...
def load_model(model: str | os.PathLike[str] | None = None) -> Model: ...
