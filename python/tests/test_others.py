"""Other programs' libraries open what the program writes, and find the values that are expected.

Libraries that are not there are skipped; `pytest -rs` says so.
"""

import csv
import json
import subprocess
import sys

import numpy as np
import pytest

import pbgi
from conftest import write_mesh

SCENE = "demo:spheres?size=6"
LIGHT = ["--env-color", "1,0.5,0.25"]
CAMERA = ["--camera-position=4,3,6", "--camera-target=0,0.5,0", "--resolution", "64x48"]


def run(command, *arguments):
    """Runs a command of the program that comes with the module, which must succeed; its standard output."""
    done = subprocess.run([sys.executable, "-m", "pbgi", command, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def octree(tmp_path_factory):
    path = tmp_path_factory.mktemp("spheres") / "spheres.pbgi"
    pbgi.bake(SCENE, path, surfels=5000, env=1.0)
    return path


def read_exr(path):
    """Header and channels, each an array of rows and columns."""
    OpenEXR = pytest.importorskip("OpenEXR")
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: channel.pixels.copy() for name, channel in file.channels().items()}
        return dict(file.header()), channels


def write_exr(path, channels):
    OpenEXR = pytest.importorskip("OpenEXR")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # The library puts channels of its own in place of the arrays: a copy keeps them.
    OpenEXR.File(header, dict(channels)).write(str(path))


def vector(channels, layer, components="XYZ"):
    return np.stack([channels[f"{layer}.{k}"] for k in components], axis=-1)


@pytest.fixture(scope="module")
def picture(octree):
    """A picture by the names of each program."""
    folder = octree.parent
    pytest.importorskip("OpenEXR")
    for preset in ["arnold", "blender", "renderman"]:
        more = ["--preview", folder / "arnold.png", "--contact-sheet", folder / "sheet.png"] if preset == "arnold" else []
        run(
            "shade", octree, "--scene", SCENE, *LIGHT, *CAMERA, "-o", folder / f"{preset}.exr",
            "--aov-names", preset, "--stats-json", folder / f"{preset}.json", "-q", *more,
        )
    return {preset: read_exr(folder / f"{preset}.exr") for preset in ["arnold", "blender", "renderman"]}


def test_openexr_reads_all_channels_of_a_picture(picture, octree):
    header, channels = picture["arnold"]
    for name, pixels in channels.items():
        assert pixels.shape == (48, 64) and np.isfinite(pixels).all(), name
    full = channels["A"] == 1
    assert 500 < full.sum() < 48 * 64
    beauty = np.stack([channels[c] for c in "RGB"], axis=-1)
    direct, indirect = (vector(channels, name, "RGB") for name in ("diffuse_direct", "diffuse_indirect"))
    assert np.allclose(beauty[full], (direct + indirect)[full], rtol=1e-4, atol=1e-6)
    assert np.allclose(beauty[channels["A"] == 0], [1, 0.5, 0.25])
    assert np.allclose(np.linalg.norm(vector(channels, "N"), axis=-1)[full], 1, atol=1e-3)
    assert (0 <= channels["AO"]).all() and (channels["AO"] <= 1.001).all()
    # OpenEXR's matrices act on rows.
    matrix = np.array(header["worldToCamera"]).reshape(4, 4)
    place = np.concatenate([vector(channels, "P"), np.ones((48, 64, 1))], axis=-1) @ matrix
    assert np.allclose(-place[..., 2][full], channels["Z"][full], rtol=1e-3)
    statistics = json.loads((octree.parent / "arnold.json").read_text())
    assert statistics["warnings"] == []
    assert int(header["pbgi:surfels"]) == statistics["surfels"] == pbgi.Octree(octree).info()["surfels"]


def test_names_of_all_programs_hold_the_same_light(picture):
    arnold, blender, renderman = (picture[name][1] for name in ("arnold", "blender", "renderman"))
    assert np.array_equal(arnold["AO"], blender["Ambient Occlusion"])
    assert np.allclose(arnold["AO"], 1 - renderman["occlusion"], atol=1e-6)
    for theirs in [vector(blender, "Irradiance", "RGB"), vector(renderman, "irradiance", "RGB")]:
        assert np.array_equal(vector(arnold, "irradiance", "RGB"), theirs)
    for theirs in [vector(blender, "Normal"), vector(renderman, "__Nworld")]:
        assert np.array_equal(vector(arnold, "N"), theirs)
    # Blender's light passes are without color.
    light = vector(blender, "Diffuse Direct", "RGB") + vector(blender, "Diffuse Indirect", "RGB")
    assert np.allclose(np.pi * light, vector(blender, "Irradiance", "RGB"), rtol=1e-4, atol=1e-6)


def test_pillow_reads_previews(picture, octree):
    Image = pytest.importorskip("PIL.Image")
    with Image.open(octree.parent / "arnold.png") as preview:
        assert preview.size == (64, 48)
        pixels = np.asarray(preview.convert("RGB")).astype(float)
    channels = picture["arnold"][1]
    beauty, shown = channels["G"].ravel(), pixels[..., 1].ravel()
    assert np.corrcoef(np.argsort(np.argsort(beauty)), np.argsort(np.argsort(shown)))[0, 1] > 0.95
    with Image.open(octree.parent / "sheet.png") as sheet:
        assert sheet.size[0] > 64 and sheet.size[1] > 48


def test_gbuffers_written_by_openexr_come_back(picture, octree, tmp_path):
    channels = picture["arnold"][1]
    given = {name: channels[name] for name in ["A"] + [f"{v}.{k}" for v in "PN" for k in "XYZ"]}
    rng = np.random.default_rng(5)
    given["id"] = rng.integers(0, 2**32, (48, 64), dtype=np.uint32)
    given["half"] = rng.normal(size=(48, 64)).astype(np.float16)
    write_exr(tmp_path / "g.exr", given)
    run(
        "shade", octree, "--gbuffer", tmp_path / "g.exr", "--pass-through", *LIGHT, "--aovs", "irradiance,AO",
        "-o", tmp_path / "o.exr", "-q",
    )
    found = read_exr(tmp_path / "o.exr")[1]
    for name, pixels in given.items():
        assert found[name].dtype == pixels.dtype and np.array_equal(found[name], pixels), name
    normal = np.where(channels["A"][..., None] > 0, vector(channels, "N"), 0)
    again = pbgi.shade_gbuffer(octree, vector(channels, "P"), normal, env=(1, 0.5, 0.25))
    assert np.allclose(vector(found, "irradiance", "RGB"), again["irradiance"], rtol=1e-3, atol=1e-4)
    assert np.allclose(found["AO"], again["ambient_occlusion"], rtol=1e-3, atol=1e-4)


def test_plyfile_numpy_and_csv_read_the_same_points(octree, tmp_path):
    plyfile = pytest.importorskip("plyfile")
    count = 50
    rng = np.random.default_rng(6)
    types = [(name, "f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    types += [("id", "i4"), ("level", "u1"), ("time", "f8")]
    vertices = np.zeros(count, dtype=types)
    places = rng.uniform(-2, 2, (count, 3)).astype(np.float32) + np.float32([0, 3, 0])
    normals = rng.normal(size=(count, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for k in range(3):
        vertices["xyz"[k]], vertices[("nx", "ny", "nz")[k]] = places[:, k], normals[:, k]
    vertices["id"], vertices["level"] = rng.integers(-(2**31), 2**31, count), rng.integers(0, 256, count)
    vertices["time"] = rng.uniform(1e8, 2e8, count)
    faces = np.empty(2, dtype=[("vertex_indices", "i4", (3,))])
    faces["vertex_indices"] = [[0, 1, 2], [2, 3, 4]]
    elements = [plyfile.PlyElement.describe(vertices, "vertex"), plyfile.PlyElement.describe(faces, "face")]
    plyfile.PlyData(elements).write(str(tmp_path / "in.ply"))
    for name in ["out.ply", "out.npy", "out.csv"]:
        run("shade", octree, "--receivers", tmp_path / "in.ply", *LIGHT, "-o", tmp_path / name, "-q")
    ply = plyfile.PlyData.read(str(tmp_path / "out.ply"))
    rows, table = ply["vertex"].data, np.load(tmp_path / "out.npy")
    assert rows.dtype.names == table.dtype.names
    with open(tmp_path / "out.csv", newline="") as file:
        text = list(csv.DictReader(file))
    assert len(rows) == len(table) == len(text) == count
    for name in rows.dtype.names:
        assert np.array_equal(rows[name], table[name]), name
        assert np.array_equal(rows[name], np.array([row[name] for row in text]).astype(rows[name].dtype)), name
    for name in vertices.dtype.names:
        assert rows[name].dtype.newbyteorder("=") == vertices[name].dtype and np.array_equal(rows[name], vertices[name]), name
    assert [list(face) for face in ply["face"]["vertex_indices"]] == [[0, 1, 2], [2, 3, 4]]
    light = pbgi.shade_points(octree, places, normals, env=(1, 0.5, 0.25))
    found = np.stack([rows[f"irradiance_{c}"] for c in "rgb"], axis=1)
    assert np.allclose(found, light["irradiance"], rtol=1e-4, atol=1e-5)
    assert np.allclose(rows["ao"], light["ambient_occlusion"], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_laspy_reads_scans(tmp_path, suffix):
    laspy = pytest.importorskip("laspy")
    if suffix == "laz":
        pytest.importorskip("lazrs")
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [500_000, 4_000_000, 100]
    header.add_extra_dim(laspy.ExtraBytesParams(name="Amplitude", type=np.uint16, scales=np.array([0.01]), offsets=np.array([5.0])))
    header.add_extra_dim(laspy.ExtraBytesParams(name="Direction", type="3f4"))
    # Records before the points, and behind them one that is longer than those before can be.
    header.vlrs.append(laspy.VLR("surveyor", 7, "before", b"who and when"))
    behind = [laspy.VLR("surveyor", 8, "behind", bytes(range(256)) * 300), laspy.VLR("LASF_Projection", 2112, "", b"PROJCS[]\0")]
    scan = laspy.LasData(header)
    x, y = np.meshgrid(np.arange(60) * 0.5, np.arange(60) * 0.5)
    scan.x, scan.y = x.ravel() + 500_000, y.ravel() + 4_000_000
    scan.z = 100 + 3 * (x.ravel() > 15)
    rng = np.random.default_rng(8)
    count = x.size
    scan.intensity = rng.integers(0, 2**16, count)
    scan.gps_time = rng.uniform(1e8, 2e8, count)
    scan.classification = np.full(count, 2)
    scan.Amplitude = rng.uniform(5, 600, count)
    scan.Direction = rng.normal(size=(count, 3))
    scan.evlrs = laspy.vlrs.vlrlist.VLRList(behind)
    scan.write(str(tmp_path / f"in.{suffix}"))
    run("bake", tmp_path / f"in.{suffix}", "-o", tmp_path / "scan.pbgi", "-q")
    run(
        "shade", tmp_path / "scan.pbgi", "--receivers", tmp_path / f"in.{suffix}", "--env-color", "1,1,1",
        "-o", tmp_path / f"out.{suffix}", "-q",
    )
    found = laspy.read(str(tmp_path / f"out.{suffix}"))
    own = set(scan.point_format.dimension_names)
    for name in own:
        assert np.array_equal(found[name], scan[name]), name
    for axis in "xyz":
        assert np.array_equal(found[axis], scan[axis])
    assert ("surveyor", 7, b"who and when") in [(r.user_id, r.record_id, r.record_data_bytes()) for r in found.vlrs]
    records = [[(r.user_id, r.record_id, r.description, r.record_data_bytes()) for r in of] for of in (found.evlrs, scan.evlrs)]
    assert len(records[1]) == 2 and records[0] == records[1]
    added = ["pbgi_irradiance"] + [f"pbgi_irradiance_{c}" for c in "rgb"] + ["pbgi_ao", "pbgi_sky_visibility"]
    assert [name for name in found.point_format.dimension_names if name not in own] == added
    rgb = np.stack([found[f"pbgi_irradiance_{c}"] for c in "rgb"], axis=1)
    assert np.allclose(found["pbgi_irradiance"], rgb @ [0.2126, 0.7152, 0.0722], rtol=1e-4)
    # A white sky alone: irradiance is π times what is seen of it; upward ground far from the step sees all.
    assert found["pbgi_ao"][x.ravel() > 20] == pytest.approx(1, abs=0.05)
    assert np.allclose(rgb[:, 0] / np.pi, found["pbgi_ao"], atol=0.03)


def test_plyfile_reads_exported_surfels(octree, tmp_path):
    plyfile = pytest.importorskip("plyfile")
    info = pbgi.Octree(octree).info()
    for name in ["s.ply", "s.ptc"]:
        run("info", octree, "--points", tmp_path / name, "-q")
    surfels = plyfile.PlyData.read(str(tmp_path / "s.ply"))["vertex"]
    assert surfels.count == info["surfels"]
    assert surfels["area"].astype(float).sum() == pytest.approx(info["area_total"], rel=1e-3)
    normals = np.stack([surfels[name] for name in ("nx", "ny", "nz")], axis=1)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-3)
    # No library of PyPI reads RenderMan's point clouds: the engine reads its own back.
    pbgi.bake(tmp_path / "s.ptc", tmp_path / "again.pbgi")
    again = pbgi.Octree(tmp_path / "again.pbgi").info()
    assert again["surfels"] == info["surfels"]
    assert again["area_total"] == pytest.approx(info["area_total"], rel=1e-3)
    assert again["flux_total"] == pytest.approx(info["flux_total"], rel=1e-2)


def test_surfels_as_an_array_are_what_python_shades(octree, tmp_path):
    run("shade", octree, "--surfels", *LIGHT, "-o", tmp_path / "s.npy", "-q")
    table = np.load(tmp_path / "s.npy")
    places, normals = (np.stack([table[n] for n in names], axis=1) for names in (("x", "y", "z"), ("nx", "ny", "nz")))
    light = pbgi.shade_points(octree, places, normals, env=(1, 0.5, 0.25))
    found = np.stack([table[f"irradiance_{c}"] for c in "rgb"], axis=1)
    assert np.allclose(found, light["irradiance"], rtol=1e-3, atol=1e-4)
    bent = np.stack([table[f"bent_n{k}"] for k in "xyz"], axis=1)
    assert np.allclose(bent, light["bent_normal"], atol=1e-3)


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_meshes_of_trimesh_keep_their_area(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.torus(1, 0.3)
    mesh.export(str(tmp_path / f"torus.{suffix}"))
    pbgi.bake(tmp_path / f"torus.{suffix}", tmp_path / "torus.pbgi", surfels="20k")
    info = pbgi.Octree(tmp_path / "torus.pbgi").info()
    assert info["area_total"] == pytest.approx(mesh.area, rel=1e-3)
    assert info["bounds_max"] == pytest.approx(mesh.bounds[1], abs=0.1)


def test_trimesh_reads_a_shaded_mesh(tmp_path, octree):
    trimesh = pytest.importorskip("trimesh")
    corners = [(0, 3, 0), (1, 3, 0), (1, 3, 1), (0, 3, 1)]
    write_mesh(tmp_path / "in.ply", corners, [(0, 2, 1), (0, 3, 2)])
    mesh = trimesh.load(str(tmp_path / "in.ply"), process=False)
    mesh.vertex_normals
    mesh.export(str(tmp_path / "normals.ply"), vertex_normal=True)
    run("shade", octree, "--receivers", tmp_path / "normals.ply", *LIGHT, "-o", tmp_path / "lit.ply", "-q")
    lit = trimesh.load(str(tmp_path / "lit.ply"), process=False)
    assert np.array_equal(lit.faces, mesh.faces) and np.allclose(lit.vertices, mesh.vertices)
