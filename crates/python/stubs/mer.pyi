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
