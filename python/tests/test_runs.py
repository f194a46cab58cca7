"""What runs do besides light: reports, progress, interruption, exceptions."""

import os
import signal
import threading
import time
import warnings

import numpy as np
import pytest

import pbgi


def test_info_is_a_dictionary(wall):
    info = wall.info()
    assert 15_000 < info["surfels"] < 25_000
    assert info["up"] == "+y" and info["channels"] in ("rgb", "none")
    assert info["bounds_max"][1] == pytest.approx(100, abs=2)
    assert info["area_total"] == pytest.approx(200**2, rel=0.01)


def test_bakes_report_and_go_on_the_same_for_any_threads(tmp_path):
    told = []
    report = pbgi.bake(
        "demo:cornell",
        tmp_path / "a.pbgi",
        surfels=5000,
        bounces=1,
        memory_limit="128MiB",
        progress=lambda phase, done: told.append((phase, done)),
    )
    assert report["surfels"] == pbgi.Octree(tmp_path / "a.pbgi").info()["surfels"]
    assert all(0 <= done <= 1 for _, done in told)
    assert told[-1][1] == 1 and len({phase for phase, _ in told}) > 1
    pbgi.bake("demo:cornell", tmp_path / "b.pbgi", surfels=5000, bounces=1, threads=1)
    assert (tmp_path / "a.pbgi").read_bytes() == (tmp_path / "b.pbgi").read_bytes()


def long_shading(street):
    """Takes minutes, all surfels for each of many points."""
    rng = np.random.default_rng(1)
    places, normals = rng.uniform(-20, 20, (200_000, 3)), rng.normal(size=(200_000, 3))
    pbgi.shade_points(street, places, normals, env=1.0, solid_angle=0)


def long_bake(street):
    output = os.path.join(os.path.dirname(street), "long.pbgi")
    pbgi.bake("demo:street", output, surfels="20M", env=1.0, bounces=3)


@pytest.mark.parametrize("work", [long_shading, long_bake])
@pytest.mark.parametrize("after", [0.3, 1.5])
def test_ctrl_c_ends_work_within_a_second(street, work, after):
    sent = []

    def interrupt():
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    # That this thread comes to run shows that the lock is released, too.
    timer = threading.Timer(after, interrupt)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        work(street)
    late = time.monotonic() - sent[0]
    assert late < 1, f"{late:.2f} s"
    assert sorted(os.listdir(os.path.dirname(street))) == ["street.pbgi"]


def test_a_callback_can_stop_the_work(street):
    with pytest.raises(pbgi.Interrupted) as caught:
        rng = np.random.default_rng(1)
        places, normals = rng.uniform(-20, 20, (200_000, 3)), rng.normal(size=(200_000, 3))
        pbgi.shade_points(
            street, places, normals, env=1.0, solid_angle=0, progress=lambda phase, done: False
        )
    assert caught.value.exit_code == 130


def test_exceptions_of_a_callback_come_through(street):
    def fail(phase, done):
        raise KeyError(phase)

    with pytest.raises(KeyError):
        pbgi.bake("demo:street", street.with_name("x.pbgi"), surfels="5M", progress=fail)
    assert not street.with_name("x.pbgi").exists()


def test_exceptions_say_who_has_to_act(tmp_path, wall):
    cases = [
        (pbgi.InputError, 3, "none.ply", lambda: pbgi.bake(tmp_path / "none.ply", tmp_path / "x.pbgi")),
        (pbgi.InputError, 3, "none.pbgi", lambda: pbgi.Octree(tmp_path / "none.pbgi")),
        (pbgi.InputError, 3, "point 1", lambda: pbgi.shade_points(wall, np.zeros((2, 3)), [[0, 1, 0], [0, 0, 0]])),
        (pbgi.UsageError, 2, "force", lambda: pbgi.bake("demo:cornell", wall)),
        (pbgi.UsageError, 2, "raster", lambda: pbgi.shade_points(wall, np.ones((1, 3)), np.ones((1, 3)), raster=0)),
        (pbgi.UsageError, 2, "(N, 3)", lambda: pbgi.shade_points(wall, np.ones(3), np.ones(3))),
        (pbgi.UsageError, 2, "same", lambda: pbgi.shade_points(wall, np.ones((2, 3)), np.ones((1, 3)))),
        (pbgi.UsageError, 2, "irradiance", lambda: pbgi.shade_points(wall, np.ones((1, 3)), np.ones((1, 3)), results=["light"])),
        (pbgi.UsageError, 2, "64MiB", lambda: pbgi.bake("demo:cornell", tmp_path / "x.pbgi", memory_limit="1MiB")),
        (pbgi.Error, 1, "mkdir -p", lambda: pbgi.bake("demo:cornell", tmp_path / "none" / "x.pbgi")),
        (pbgi.BudgetError, 4, "temporary files", lambda: pbgi.bake("demo:street", tmp_path / "x.pbgi", surfels="100G")),
        (pbgi.UsageError, 2, "size", lambda: pbgi.bake("demo:cornell", tmp_path / "x.pbgi", memory_limit="much")),
    ]
    for kind, code, words, call in cases:
        with pytest.raises(kind) as caught:
            call()
        assert words in str(caught.value), caught.value
        assert caught.type is kind and caught.value.exit_code == code
        assert isinstance(caught.value, pbgi.Error)
    assert list(tmp_path.iterdir()) == []


def test_a_limit_that_an_input_exceeds_is_a_budget_error(tmp_path, wall):
    OpenEXR = pytest.importorskip("OpenEXR")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    sky = np.zeros((4096, 8192, 3), dtype=np.float16)
    OpenEXR.File(header, {"RGB": sky}).write(str(tmp_path / "sky.exr"))
    with pytest.raises(pbgi.BudgetError, match="memory") as caught:
        pbgi.shade_points(wall, np.ones((1, 3)), np.ones((1, 3)), env=tmp_path / "sky.exr", memory_limit="64MiB")
    assert caught.value.exit_code == 4


def test_what_the_caller_once_held_is_not_held_against_a_bake(tmp_path):
    held = np.ones(300 << 20, dtype=np.uint8)
    del held
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pbgi.bake("demo:cornell", tmp_path / "a.pbgi", surfels=5000, memory_limit="64MiB")


def test_damage_is_an_input_error(tmp_path):
    path = tmp_path / "a.pbgi"
    pbgi.bake("demo:cornell", path, surfels=5000)
    data = bytearray(path.read_bytes())
    for place in range(8192, len(data), 4096):
        data[place] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(pbgi.InputError, match="damaged"):
        pbgi.shade_points(path, [[0.3, 0.3, -0.3]], [[0, 1, 0]], solid_angle=0, env=1.0)
