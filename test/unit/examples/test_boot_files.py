# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The recipes of the page on booting."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from string import Template

import pytest

from dyknow.ros.manager.manager_settings import PARAMETERS

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted((ROOT / "examples" / "boot").iterdir())


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is missing")
def test_systemd_accepts_the_unit():
    unit = ROOT / "examples" / "boot" / "dyknow.service"
    command = ["systemd-analyze", "verify", str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_recipe_is_on_the_page_and_names_parameters_of_the_manager(file):
    assert f"../examples/boot/{file.name}" in (ROOT / "doc" / "boot.rst").read_text()
    command = next(
        line for line in file.read_text().splitlines() if line.startswith(("ExecStart", "CMD"))
    )
    given = re.findall(r"\b_?([a-z_]+):=", command)
    assert "wiring" in given and set(given) <= set(PARAMETERS)


def test_the_container_copies_what_is_there():
    text = (ROOT / "examples" / "boot" / "Containerfile").read_text()
    given = [{}, dict(re.findall(r"--build-arg (\w+)=(\S+)", text))]
    defaults = dict(re.findall(r"^ARG (\w+)=(\S+)", text, re.MULTILINE))
    assert set(defaults) == set(given[1])
    for source in re.findall(r"^COPY (\S+)", text, re.MULTILINE):
        for arguments in given:
            path = Template(source).substitute({**defaults, **arguments})
            assert (ROOT / path).exists()
