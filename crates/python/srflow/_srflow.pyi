"""Types of the functions; their documentation is in the module. Written by crates/python/stubs.py."""

import os
from collections.abc import Callable
from types import ModuleType
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str
mer: ModuleType

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
    iterations: float

class Frame(TypedDict, total=False):
    color: NDArray[np.float32]
    image: NDArray[np.uint8]
    alpha: NDArray[np.float32]
    mask: NDArray[np.bool_]
    depth: NDArray[np.float32]
    flow: NDArray[np.float32]
    flow_normalized: NDArray[np.float32]
    depth_next: NDArray[np.float32]

class CameraGradient(TypedDict):
    translation: NDArray[np.float64]
    rotation: NDArray[np.float64]
    fx: float
    fy: float
    cx: float
    cy: float

class Gradients(TypedDict, total=False):
    means: NDArray[np.float32]
    scales: NDArray[np.float32]
    rotations: NDArray[np.float32]
    opacities: NDArray[np.float32]
    sh: NDArray[np.float32]
    means_next: NDArray[np.float32]
    camera: CameraGradient
    camera_next: CameraGradient
    centers: NDArray[np.float32]
    centers_absolute: NDArray[np.float32]
    visible: NDArray[np.bool_]

class Face(TypedDict):
    score: float
    box: tuple[int, int, int, int]
    landmarks: NDArray[np.float64]
    mesh: NDArray[np.float64]

class Avatar:
    @staticmethod
    def builtin(seed: int = 1) -> Avatar: ...
    @staticmethod
    def read(head: str | os.PathLike[str], seed: int = 1) -> Avatar: ...
    def pose(
        self,
        units: dict[int | str, float] | None = None,
        *,
        rotation: ArrayLike | None = None,
        neck: ArrayLike | None = None,
        jaw: ArrayLike | None = None,
        eyes: ArrayLike | None = None,
        translation: ArrayLike | None = None,
    ) -> Gaussians: ...
    def at(self, timestep: int) -> Gaussians: ...
    @property
    def timesteps(self) -> int: ...
    @property
    def action_units(self) -> list[int]: ...

class Camera:
    @property
    def name(self) -> str: ...
    @property
    def distortion(self) -> str | None: ...
    def __new__(
        cls,
        width: int,
        height: int,
        fx: float,
        fy: float | None = None,
        cx: float | None = None,
        cy: float | None = None,
        camera_from_world: ArrayLike | None = None,
    ) -> Camera: ...
    @staticmethod
    def facing(gaussians: Gaussians, width: int = 800, height: int = 800) -> Camera: ...
    @staticmethod
    def read(path: str | os.PathLike[str], size: tuple[int, int] | None = None) -> list[Camera]: ...
    def resized(self, width: int, height: int) -> Camera: ...
    def orbit(self, center: ArrayLike, degrees: float, count: int) -> list[Camera]: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...
    @property
    def camera_from_world(self) -> NDArray[np.float64]: ...
    @property
    def position(self) -> NDArray[np.float64]: ...

class Dataset:
    def __new__(cls, spec: str, split: str | None = None) -> Dataset: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Pair: ...
    @property
    def ids(self) -> list[str]: ...
    @property
    def split(self) -> str: ...

class FaceFinder:
    def __new__(cls, models: str | os.PathLike[str] | None = None) -> FaceFinder: ...
    def __call__(self, frame: ArrayLike, /) -> list[Face]: ...

class Gaussians:
    def __new__(
        cls,
        means: ArrayLike,
        scales: ArrayLike,
        rotations: ArrayLike,
        opacities: ArrayLike,
        sh: ArrayLike,
        antialiased: bool = False,
    ) -> Gaussians: ...
    @staticmethod
    def read(path: str | os.PathLike[str]) -> Gaussians: ...
    def write(self, path: str | os.PathLike[str]) -> None: ...
    @property
    def means(self) -> NDArray[np.float32]: ...
    @property
    def scales(self) -> NDArray[np.float32]: ...
    @property
    def rotations(self) -> NDArray[np.float32]: ...
    @property
    def opacities(self) -> NDArray[np.float32]: ...
    @property
    def sh(self) -> NDArray[np.float32]: ...
    @property
    def antialiased(self) -> bool: ...
    def __len__(self) -> int: ...

class Network:
    @property
    def name(self) -> str: ...
    def __new__(
        cls, name: str = "srflow", weights: str | os.PathLike[str] | None = None, **options: Any
    ) -> Network: ...
    def __call__(
        self, frame1: ArrayLike, frame2: ArrayLike, *, initial: ArrayLike | None = None
    ) -> NDArray[np.float32]: ...
    def sequence(self, *, warm_start: bool = False) -> Sequence: ...

class Sequence:
    def push(self, frame: ArrayLike) -> Estimate | None: ...

def crop_face(frame: ArrayLike, landmarks: ArrayLike) -> NDArray[np.uint8]: ...
def read_flow(path: str | os.PathLike[str]) -> NDArray[np.float32]: ...
def write_flow(path: str | os.PathLike[str], flow: ArrayLike) -> None: ...
def flow_to_rgb(flow: ArrayLike, max_flow: float | None = None) -> NDArray[np.uint8]: ...
def warp(frame2: ArrayLike, flow: ArrayLike) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]: ...
def consistency(forward: ArrayLike, backward: ArrayLike, pixels: float | None = None) -> NDArray[np.bool_]: ...
def metrics(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike | None = None) -> Metrics: ...
def run_job(
    name: str, settings: dict[str, Any], callback: Callable[[dict[str, Any]], object] | None = None
) -> tuple[dict[str, Any], str, str | None]: ...
def flow(
    frame1: ArrayLike, frame2: ArrayLike, method: str | None = None, *, initial: ArrayLike | None = None, **options: Any
) -> NDArray[np.float32]: ...
def rasterize(
    gaussians: Gaussians,
    camera: Camera,
    next: Gaussians | None = None,
    *,
    camera_next: Camera | None = None,
    background: ArrayLike | str | None = None,
    sort_per_pixel: bool = False,
    antialiased: bool | None = None,
    pixel_convention: str = "splat",
) -> Frame: ...
def rasterize_backward(
    gradients: dict[str, Any],
    gaussians: Gaussians,
    camera: Camera,
    next: Gaussians | None = None,
    *,
    camera_next: Camera | None = None,
    background: ArrayLike | str | None = None,
    sort_per_pixel: bool = False,
    antialiased: bool | None = None,
    pixel_convention: str = "splat",
) -> Gradients: ...
def run(arguments: list[str]) -> int: ...
