"""Types of the functions; their documentation is in the module. `tests/test_stubs.py` holds the two together."""

import os
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

class Metrics(TypedDict):
    epe: float
    px1: float
    px3: float
    px5: float
    f1_all: float
    wauc: float
    valid_pixels: int

class Pair(TypedDict, total=False):
    id: str
    frame1: NDArray[np.uint8]
    frame2: NDArray[np.uint8]
    flow: NDArray[np.float32]
    valid: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    occlusion: NDArray[np.bool_]

class Estimate(TypedDict, total=False):
    flow: NDArray[np.float32]
    uncertainty: NDArray[np.float32]
    occlusion: NDArray[np.float32]

class Dataset:
    def __new__(cls, spec: str, split: str | None = None) -> Dataset: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Pair: ...
    @property
    def ids(self) -> list[str]: ...
    @property
    def split(self) -> str: ...

class Network:
    def __new__(cls, name: str = "srflow", weights: str | os.PathLike[str] | None = None, **options: Any) -> Network: ...
    def __call__(
        self, frame1: ArrayLike, frame2: ArrayLike, *, initial: ArrayLike | None = None
    ) -> NDArray[np.float32]: ...
    def sequence(self, *, warm_start: bool = False) -> Sequence: ...
    @property
    def name(self) -> str: ...

class Sequence:
    def push(self, frame: ArrayLike) -> Estimate | None: ...

def flow(
    frame1: ArrayLike,
    frame2: ArrayLike,
    method: str | None = None,
    *,
    initial: ArrayLike | None = None,
    **options: Any,
) -> NDArray[np.float32]: ...
def read_flow(path: str | os.PathLike[str]) -> NDArray[np.float32]: ...
def write_flow(path: str | os.PathLike[str], flow: ArrayLike) -> None: ...
def flow_to_rgb(flow: ArrayLike, max_flow: float | None = None) -> NDArray[np.uint8]: ...
def warp(frame2: ArrayLike, flow: ArrayLike) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]: ...
def consistency(forward: ArrayLike, backward: ArrayLike, pixels: float | None = None) -> NDArray[np.bool_]: ...
def metrics(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike | None = None) -> Metrics: ...
def run(arguments: list[str]) -> int: ...
