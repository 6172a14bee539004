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
