"""Small scenes whose light is known in closed form."""

import numpy as np
import pytest

import pbgi


def write_mesh(path, vertices, faces):
    """A PLY mesh as text."""
    header = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    rows = [" ".join(map(str, vertex)) for vertex in vertices]
    rows += [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
    path.write_text("\n".join(header + rows) + "\n")


def write_cloud(path, columns):
    """A PLY cloud as text, of named columns."""
    header = ["ply", "format ascii 1.0", f"element vertex {len(next(iter(columns.values())))}"]
    header += [f"property float {name}" for name in columns]
    rows = [" ".join(map(str, row)) for row in zip(*columns.values())]
    path.write_text("\n".join(header + ["end_header"] + rows) + "\n")


def spread_directions(count):
    """Unit vectors spread evenly over the sphere, on a spiral of golden angles."""
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    angle = index * np.pi * (3 - 5**0.5)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


@pytest.fixture(scope="session")
def wall(tmp_path_factory):
    """The plane x = 0, two hundred units wide, as 20 thousand surfels."""
    folder = tmp_path_factory.mktemp("wall")
    corners = [(0, -100, -100), (0, 100, -100), (0, 100, 100), (0, -100, 100)]
    write_mesh(folder / "wall.ply", corners, [(0, 1, 2, 3)])
    pbgi.bake(folder / "wall.ply", folder / "wall.pbgi", surfels="20k")
    return pbgi.Octree(folder / "wall.pbgi")


@pytest.fixture(scope="session")
def room(tmp_path_factory):
    """A closed sphere of radius 2 that shines inward with the radiance (1, 2, 3)."""
    folder = tmp_path_factory.mktemp("room")
    count = 20_000
    outward = spread_directions(count)
    columns = dict(zip(["x", "y", "z"], 2 * outward.T))
    columns |= dict(zip(["nx", "ny", "nz"], -outward.T))
    columns["radius"] = np.full(count, 1.5 * 2 * (4 / count) ** 0.5)
    columns |= {f"radiance_{c}": np.full(count, value) for c, value in zip("rgb", (1, 2, 3))}
    write_cloud(folder / "room.ply", columns)
    pbgi.bake(folder / "room.ply", folder / "room.pbgi")
    return pbgi.Octree(folder / "room.pbgi")


@pytest.fixture(scope="session")
def street(tmp_path_factory):
    """A large octree, for runs that take long."""
    output = tmp_path_factory.mktemp("street") / "street.pbgi"
    pbgi.bake("demo:street", output, surfels="200k")
    return output
