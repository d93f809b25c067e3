"""(4.5) at the data of 5.3: it diverges, says so before and after; where the aperture is wide it is right."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from _launch import without_ranks

from fracflow.errors import SolveError

ROOT = Path(__file__).parents[2]
FIXED = "method.coupling=fixed-point"
WIDE = ("fracture.fault.aperture=1 ft", "stage.failure.steps=20")


def test_diverges_with_the_predicted_factor(ran):
    with pytest.raises(SolveError, match="diverges") as caught:
        ran("report_5_3", FIXED, "stage.failure.steps=3")
    message = str(caught.value)
    found = re.search(r"multiplied by ([\d.e+]+) a cycle \(predicted; ([\d.e+]+) measured", message)
    assert found and float(found[1]) > 1.0 and "\n" not in message
    assert "monolithic" in message


@pytest.mark.serial
def test_exit_code_3(tmp_path):
    scene = str(ROOT / "meshes/report_5_3/scene.toml")
    command = [sys.executable, "-m", "fracflow", "run", scene, "-o", str(tmp_path / "out")]
    environment = without_ranks()
    done = subprocess.run(
        [*command, "--set", FIXED, "--set", "output.pictures=false"],
        cwd=ROOT, env={**environment, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("fracflow: ")]
    assert len(lines) == 1 and "diverges" in lines[0]
    assert "Traceback" not in done.stderr


def test_agrees_with_monolithic_where_it_converges(ran):
    by_turns, at_once = ran("report_5_3", FIXED, *WIDE).history, ran("report_5_3", *WIDE).history
    assert by_turns["step/coupling"].max() > 1 == at_once["step/coupling"].max()
    assert by_turns["time"] == pytest.approx(at_once["time"], abs=1e-9)  # an event is as exact as the solution it is in
    tractions = ("normal_traction", "shear_traction")
    for name in ("pressure", "opening", "slip", *tractions, "displacement", "flow_rate"):
        keys = [f"probe/node{n}/{name}" for n in range(1, 6)]
        size = max(np.abs(at_once[key]).max() for key in keys)
        assert size > 0.0
        assert max(np.abs(by_turns[key] - at_once[key]).max() for key in keys) <= 1e-8 * size, name
