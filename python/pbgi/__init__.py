"""Point-based global illumination: bake surfels into an octree file, gather light for points."""

import json
import os

import numpy as np

from . import _pbgi
from ._pbgi import __version__
from .errors import BudgetError, Error, InputError, Interrupted, UsageError

__all__ = [
    "BudgetError",
    "Error",
    "InputError",
    "Interrupted",
    "Octree",
    "UsageError",
    "bake",
    "shade_gbuffer",
    "shade_points",
]

_DEFAULT_RESULTS = ("irradiance", "ambient_occlusion", "sky_visibility", "bent_normal")


class Octree:
    """A baked octree file. Goes wherever a path to one does."""

    def __init__(self, path):
        self.path = os.fspath(path)
        _pbgi.info(self.path)

    def __fspath__(self):
        return self.path

    def __repr__(self):
        return f"Octree({self.path!r})"

    def info(self):
        """What header and page table say, as `pbgi info --json` has them under `header`."""
        return json.loads(_pbgi.info(self.path))


def bake(
    input,
    output,
    *,
    surfels=None,
    spacing=None,
    memory_limit=None,
    env=None,
    env_placement="openexr",
    env_rotate=0.0,
    env_scale=1.0,
    bounces=0,
    bounce_share=1,
    up=None,
    threads=None,
    temp_dir=None,
    force=False,
    progress=None,
):
    """Bakes meshes and point clouds into one octree file and returns the report.

    `input` is a path, the name of a procedural scene such as `demo:cornell`, or a list of such; see
    `pbgi bake --help` for what each option means.
    """
    inputs = [input] if isinstance(input, (str, os.PathLike)) else list(input)
    settings = {
        "inputs": [os.fspath(name) for name in inputs],
        "output": os.fspath(output),
        "surfels": None if surfels is None else str(surfels),
        "spacing": spacing,
        "memory_limit": _size(memory_limit),
        "threads": _threads(threads),
        "env": _light(env, env_placement, env_rotate, env_scale),
        "bounces": bounces,
        "bounce_share": bounce_share,
        "up": up,
        "temp_dir": temp_dir,
        "force": force,
    }
    return json.loads(_pbgi.bake(settings, progress))


def shade_points(octree, positions, normals, *, results=None, report=None, **settings):
    """Gathers light at points: arrays of shape (N, 3) in, a dictionary of arrays of N rows out.

    A point without a normal, or at no finite place, is an InputError. `report` is a dictionary that is
    filled with the statistics of the run. All settings are those of `shade_gbuffer`.
    """
    positions, normals = _rows(positions, normals, 2, "(N, 3)")
    return _shade(octree, positions, normals, False, results, report, **settings)


def shade_gbuffer(octree, position, normal, *, results=None, report=None, **settings):
    """Gathers light at the pixels of a picture: arrays of shape (H, W, 3) in, arrays of H rows and W columns out.

    A pixel whose normal is 0, or whose position or normal is not finite, shows no surface: it is 0 in all results.
    """
    positions, normals = _rows(position, normal, 3, "(H, W, 3)")
    height, width = positions.shape[:2]
    flat = [array.reshape(-1, 3) for array in (positions, normals)]
    arrays = _shade(octree, *flat, True, results, report, **settings)
    return {name: array.reshape(height, width, *array.shape[1:]) for name, array in arrays.items()}


def _shade(
    octree,
    positions,
    normals,
    skip_empty,
    results,
    report,
    *,
    env=None,
    env_placement="openexr",
    env_rotate=0.0,
    env_scale=1.0,
    solid_angle=None,
    target_error=None,
    interpolation=None,
    raster=None,
    directions=None,
    check=0,
    gloss=False,
    roughness=None,
    metalness=None,
    specular=None,
    eye=None,
    memory_limit=None,
    threads=None,
    progress=None,
):
    is_glossy = gloss or any(number is not None for number in (roughness, metalness, specular))
    if results is None:
        results = _DEFAULT_RESULTS + (("specular_indirect",) if is_glossy else ())
    settings = {
        "env": _light(env, env_placement, env_rotate, env_scale),
        "solid_angle": solid_angle,
        "target_error": target_error,
        "interpolation": interpolation,
        "raster": raster,
        "directions": directions,
        "check": check,
        "gloss": gloss,
        "roughness": roughness,
        "metalness": metalness,
        "specular": specular,
        "memory_limit": _size(memory_limit),
        "threads": _threads(threads),
    }
    eye = None if eye is None else [float(x) for x in eye]
    arrays, text = _pbgi.shade(
        os.fspath(octree), positions, normals, skip_empty, eye, list(results), settings, progress
    )
    if report is not None:
        report.update(json.loads(text))
    return arrays


def _rows(positions, normals, dimensions, shape):
    """Both as contiguous arrays; those that are `float32`, or `float64` positions, are not copied."""
    positions, normals = np.asarray(positions), np.asarray(normals)
    for name, array in (("positions", positions), ("normals", normals)):
        if array.ndim != dimensions or array.shape[-1] != 3 or array.dtype.kind not in "fiu":
            raise UsageError(f"{name} have shape {array.shape} and type {array.dtype}; expected numbers of shape {shape}")
    if positions.shape != normals.shape:
        raise UsageError(f"positions have shape {positions.shape} and normals {normals.shape}; expected the same")
    if positions.dtype != np.float32:
        positions = positions.astype(np.float64, copy=False)
    return np.ascontiguousarray(positions), np.ascontiguousarray(normals, dtype=np.float32)


def _light(env, placement, rotate, scale):
    light = {"path": None, "color": None, "placement": placement, "rotate": rotate, "scale": scale}
    if isinstance(env, (str, os.PathLike)):
        light["path"] = os.fspath(env)
    elif env is not None:
        color = np.asarray(env, dtype=np.float32)
        if color.shape not in ((), (3,)):
            raise UsageError(f"env has shape {color.shape}; expected a path, a number or three of them")
        light["color"] = np.broadcast_to(color, 3).tolist()
    return light


def _size(memory_limit):
    return "1GiB" if memory_limit is None else str(memory_limit)


def _threads(threads):
    return 0 if threads is None else threads
