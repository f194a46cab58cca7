import os
from collections.abc import Callable, Sequence
from typing import Any, Literal, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import BudgetError as BudgetError
from .errors import Error as Error
from .errors import InputError as InputError
from .errors import Interrupted as Interrupted
from .errors import UsageError as UsageError

__version__: str

_Path = Union[str, os.PathLike[str]]
_Light = Union[str, os.PathLike[str], float, Sequence[float], NDArray[Any]]
_Progress = Callable[[str, float], object]
_Result = Literal[
    "irradiance",
    "surface_irradiance",
    "sky_irradiance",
    "ambient_occlusion",
    "sky_visibility",
    "bent_normal",
    "specular_indirect",
]

class Octree:
    path: str
    def __init__(self, path: _Path) -> None: ...
    def __fspath__(self) -> str: ...
    def info(self) -> dict[str, Any]: ...

def bake(
    input: _Path | Sequence[_Path],
    output: _Path,
    *,
    surfels: int | str | None = None,
    spacing: float | None = None,
    memory_limit: int | str | None = None,
    env: _Light | None = None,
    env_placement: Literal["openexr", "mitsuba", "blender", "three"] = "openexr",
    env_rotate: float = 0.0,
    env_scale: float = 1.0,
    bounces: int = 0,
    bounce_share: int = 1,
    up: Literal["y", "z"] | None = None,
    threads: int | None = None,
    temp_dir: _Path | None = None,
    force: bool = False,
    progress: _Progress | None = None,
) -> dict[str, Any]: ...
def shade_points(
    octree: _Path,
    positions: ArrayLike,
    normals: ArrayLike,
    *,
    results: Sequence[_Result] | None = None,
    report: dict[str, Any] | None = None,
    env: _Light | None = None,
    env_placement: Literal["openexr", "mitsuba", "blender", "three"] = "openexr",
    env_rotate: float = 0.0,
    env_scale: float = 1.0,
    solid_angle: float | None = None,
    target_error: float | None = None,
    interpolation: float | None = None,
    raster: int | None = None,
    directions: int | None = None,
    check: int = 0,
    gloss: bool = False,
    roughness: float | None = None,
    metalness: float | None = None,
    specular: float | None = None,
    eye: Sequence[float] | None = None,
    memory_limit: int | str | None = None,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> dict[str, NDArray[np.float32]]: ...
def shade_gbuffer(
    octree: _Path,
    position: ArrayLike,
    normal: ArrayLike,
    *,
    results: Sequence[_Result] | None = None,
    report: dict[str, Any] | None = None,
    env: _Light | None = None,
    env_placement: Literal["openexr", "mitsuba", "blender", "three"] = "openexr",
    env_rotate: float = 0.0,
    env_scale: float = 1.0,
    solid_angle: float | None = None,
    target_error: float | None = None,
    interpolation: float | None = None,
    raster: int | None = None,
    directions: int | None = None,
    check: int = 0,
    gloss: bool = False,
    roughness: float | None = None,
    metalness: float | None = None,
    specular: float | None = None,
    eye: Sequence[float] | None = None,
    memory_limit: int | str | None = None,
    threads: int | None = None,
    progress: _Progress | None = None,
) -> dict[str, NDArray[np.float32]]: ...
