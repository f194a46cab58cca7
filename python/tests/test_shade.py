"""Light in closed form: open sky, half of it, a closed room."""

import warnings

import numpy as np
import pytest

import pbgi

UP = np.array([[0, 1, 0]], dtype=np.float32)


def test_open_sky_gives_pi_times_its_radiance(wall):
    found = pbgi.shade_points(wall, [[50.0, 0, 0]], [[1.0, 0, 0]], env=(1, 2, 3))
    assert found["irradiance"] == pytest.approx(np.pi * np.array([[1, 2, 3]]), rel=1e-3)
    assert found["ambient_occlusion"] == pytest.approx([1], abs=1e-3)
    # The sky is what is above: half of what a vertical surface faces.
    assert found["sky_visibility"] == pytest.approx([0.5], abs=1e-3)
    assert found["bent_normal"] == pytest.approx(np.array([[1, 0, 0]]), abs=1e-2)


def test_a_wall_hides_half_the_sky(wall):
    # The wall ends at an angle of 0.5 / 100 above the horizon of what it leaves open: far below the tolerance,
    # which is that of a cube of 16 x 16 texels.
    places = np.array([[0.5, 0, 0], [-0.5, 0, 0]], dtype=np.float32)
    found = pbgi.shade_points(wall, places, UP.repeat(2, axis=0), env=1.0)
    assert found["ambient_occlusion"] == pytest.approx([0.5, 0.5], abs=0.01)
    assert found["irradiance"] == pytest.approx(np.full((2, 3), np.pi / 2), rel=0.02)
    # The mean open direction leans away from the wall.
    assert found["bent_normal"][0, 0] > 0.3 > -0.3 > found["bent_normal"][1, 0]


def test_a_closed_room_gives_pi_times_its_radiance(room):
    normals = np.eye(3)
    found = pbgi.shade_points(
        room, np.zeros((3, 3)), normals, env=5.0, results=["surface_irradiance", "sky_irradiance"]
    )
    assert list(found) == ["surface_irradiance", "sky_irradiance"]
    expected = np.pi * np.array([[1, 2, 3]]).repeat(3, axis=0)
    assert found["surface_irradiance"] == pytest.approx(expected, rel=0.02)
    assert found["sky_irradiance"] == pytest.approx(np.zeros((3, 3)), abs=0.02 * 5 * np.pi)


def test_types_strides_and_lengths_of_normals_change_nothing(wall):
    rng = np.random.default_rng(7)
    places = rng.uniform(1, 20, (100, 3)).astype(np.float32)
    normals = rng.normal(size=(100, 3)).astype(np.float32)
    first = pbgi.shade_points(wall, places, normals, env=1.0)
    others = [
        (places.astype(np.float64), normals),
        (np.asfortranarray(places), np.asfortranarray(normals)),
        (np.repeat(places, 2, axis=0)[::2], 2 * normals),
    ]
    for positions, directions in others:
        again = pbgi.shade_points(wall, positions, directions, env=1.0, threads=1)
        for name, values in first.items():
            assert np.array_equal(values, again[name]), name
    for values in first.values():
        assert values.dtype == np.float32 and values.flags.c_contiguous


def test_a_gbuffer_is_shaded_pixel_by_pixel(wall):
    position = np.zeros((4, 6, 3), dtype=np.float32)
    position[..., 0] = 1 + np.arange(24).reshape(4, 6)
    normal = np.broadcast_to(UP[0], (4, 6, 3)).copy()
    normal[1, 2] = 0
    normal[3, 5] = np.nan
    position[0, 0, 1] = np.inf
    report = {}
    # Without interpolation none depends on its neighbors.
    found = pbgi.shade_gbuffer(wall, position, normal, env=1.0, interpolation=0, report=report)
    assert found["irradiance"].shape == (4, 6, 3)
    assert found["ambient_occlusion"].shape == (4, 6)
    empty = found["ambient_occlusion"] == 0
    assert np.argwhere(empty).tolist() == [[0, 0], [1, 2], [3, 5]]
    assert report["empty_pixels"] == 3 and report["receivers"] == 21
    alone = pbgi.shade_points(wall, position[2, 3:4], normal[2, 3:4], env=1.0, interpolation=0)
    assert np.array_equal(found["irradiance"][2, 3:4], alone["irradiance"])


def test_a_mirror_shows_the_sky(wall):
    # In the default base color, 0.8.
    found = pbgi.shade_points(
        wall, [[50.0, 0, 0]], [[1.0, 0, 0]], env=(1, 2, 3), eye=(60, 3, 0), roughness=0.1, metalness=1
    )
    assert found["specular_indirect"] == pytest.approx(0.8 * np.array([[1, 2, 3]]), rel=0.01)


def test_the_error_is_measured(wall):
    rng = np.random.default_rng(3)
    report = {}
    places, normals = rng.uniform(1, 20, (200, 3)), rng.normal(size=(200, 3))
    pbgi.shade_points(wall, places, normals, env=1.0, check=50, report=report)
    assert report["check"]["receivers"] == 50
    assert 0 <= report["check"]["rrmse"] < 0.05


def test_no_light_is_warned_of(wall):
    with pytest.warns(UserWarning, match="no environment"):
        pbgi.shade_points(wall, [[0.5, 0, 0]], UP, results=["ambient_occlusion"])


def test_points_of_other_axes_and_units_are_warned_of(wall, tmp_path):
    # On the wall, x = 0, as a program that has Z up and counts in centimeters would name them.
    rng = np.random.default_rng(4)
    y, z = rng.uniform(-90, 90, (2, 100))
    places = 100 * np.stack([np.zeros(100), -z, y], axis=1)
    normals = np.broadcast_to([1, 0, 0], (100, 3))
    report = {}
    with pytest.warns(UserWarning, match="is up in it|its unit is 0.01 of"):
        pbgi.shade_points(wall, places, normals, env=1.0, report=report)
    assert any("0.01 times" in text for text in report["warnings"])
    # Points in the air are no mistake.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pbgi.shade_points(wall, places / 100 + [60, 0, 0], normals, env=1.0)


def test_no_points_give_no_rows(wall):
    found = pbgi.shade_points(wall, np.zeros((0, 3)), np.zeros((0, 3)), env=1.0)
    assert found["irradiance"].shape == (0, 3)
    assert found["ambient_occlusion"].shape == (0,)


def write_half_lit_sky(path):
    """An environment whose middle half shines, and whose rest is black."""
    OpenEXR = pytest.importorskip("OpenEXR")
    image = np.zeros((32, 64, 3), dtype=np.float32)
    image[:, 16:48] = 1
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": image}).write(str(path))


def test_environments_are_placed_as_named(tmp_path, wall):
    write_half_lit_sky(tmp_path / "sky.exr")
    directions = np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1]])
    for placement, bright in [("openexr", 0), ("mitsuba", 0), ("blender", 1), ("three", 1)]:
        found = pbgi.shade_points(
            wall, np.full((3, 3), 1000.0), directions, env=tmp_path / "sky.exr", env_placement=placement
        )
        light = found["irradiance"][:, 0]
        assert light[bright] == pytest.approx(np.pi, rel=0.01), placement
        assert light[1 - bright] == pytest.approx(np.pi / 2, rel=0.05), placement
    with pytest.raises(pbgi.UsageError, match="expected openexr"):
        pbgi.shade_points(wall, [[1, 0, 0]], UP, env=1.0, env_placement="maya")
