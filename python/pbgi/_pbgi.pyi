from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__version__: str

def bake(settings: dict[str, Any], progress: Callable[[str, float], object] | None) -> str: ...
def info(path: str) -> str: ...
def run_program(arguments: list[str]) -> int: ...
def shade(
    octree: str,
    positions: NDArray[np.float32] | NDArray[np.float64],
    normals: NDArray[np.float32],
    skip_empty: bool,
    eye: list[float] | None,
    names: list[str],
    settings: dict[str, Any],
    progress: Callable[[str, float], object] | None,
) -> tuple[dict[str, NDArray[np.float32]], str]: ...
