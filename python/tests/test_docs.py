"""The examples of the documentation, run as they stand."""

import os
import pathlib
import re
import subprocess
import sys

import pytest

CLONE = pathlib.Path(__file__).resolve().parents[2]


def test_the_example_of_the_documentation_draws_its_plot(tmp_path):
    pytest.importorskip("matplotlib")
    text = (CLONE / "docs" / "python.md").read_text()
    examples = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert len(examples) == 1
    # What it has computed is looked at, too.
    code = examples[0] + "\nnp.savez('light.npz', **light)\n"
    environment = os.environ | {"MPLBACKEND": "agg"}
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    import matplotlib.image
    import numpy as np

    light = np.load(tmp_path / "light.npz")
    # The box is open to its front only: little sky, more of it near the opening, which is at the first rows.
    open_part = light["ambient_occlusion"]
    assert open_part.shape == (200, 200) and 0.02 < open_part.mean() < 0.5
    assert open_part[:20].mean() > 1.5 * open_part[-20:].mean()
    # Two blocks of 0.165 x 0.165 stand on the floor of 0.54 x 0.54; all the rest is lit. Below them, near their edges, interpolation
    # gives less than a thousandth of the light.
    assert (light["irradiance"] > 1e-3 * light["irradiance"].max()).mean() == pytest.approx(1 - 2 * (0.165 / 0.54) ** 2, abs=0.05)
    plot = matplotlib.image.imread(tmp_path / "floor.png")
    assert plot.shape[:2] == (480, 640) and len(set(plot[..., 0].ravel().tolist())) > 50
