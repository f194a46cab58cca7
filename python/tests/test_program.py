"""The program `pbgi` that comes with the module."""

import json
import os
import shutil
import signal
import subprocess
import sys

import pytest

import pbgi


def program():
    """The command of the program that was installed with this interpreter."""
    found = shutil.which("pbgi", path=os.path.dirname(sys.executable))
    assert found, "no pbgi beside this interpreter"
    return [found]


def run(command, *arguments, code=0):
    done = subprocess.run([*command, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done


@pytest.mark.parametrize("as_module", [False, True])
def test_the_program_comes_with_the_module(tmp_path, as_module):
    command = [sys.executable, "-m", "pbgi"] if as_module else program()
    assert run(command, "--version").stdout.split() == ["pbgi", pbgi.__version__]
    assert "Usage: pbgi shade" in run(command, "shade", "-h").stdout
    octree = tmp_path / "box.pbgi"
    run(command, "bake", "demo:cornell", "-o", octree, "--surfels", "2000", "-q")
    told = json.loads(run(command, "info", octree, "--json").stdout)
    info = pbgi.Octree(octree).info()
    assert set(told["header"]) == set(info) and told["header"]["surfels"] == info["surfels"] > 1000


def test_the_program_ends_with_its_exit_codes(tmp_path):
    assert "required" in run(program(), "bake", code=2).stderr
    assert "none.ply" in run(program(), "bake", tmp_path / "none.ply", "-o", tmp_path / "x.pbgi", code=3).stderr
    assert not (tmp_path / "x.pbgi").exists()


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_the_program_with_nothing_left_behind(tmp_path, stop):
    bake = ["bake", "demo:street", "-o", tmp_path / "long.pbgi", "--surfels", "20M", "--env-color", "1,1,1", "--progress", "plain"]
    running = subprocess.Popen([*program(), *map(str, bake)], stderr=subprocess.PIPE, text=True)
    try:
        # It has begun once it tells of a phase.
        assert running.stderr.readline()
        running.send_signal(stop)
        running.communicate(timeout=60)
    finally:
        running.kill()
    assert running.returncode == 130
    assert os.listdir(tmp_path) == []
