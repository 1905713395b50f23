# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of the demonstrations, as far as it needs no ROS."""

from __future__ import annotations

import signal

import pytest

from dyknow_demo.main import FAILED, main


@pytest.fixture(autouse=True)
def keep_sigterm():
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize(
    ("arguments", "option"),
    [(["--help"], "--rewiring"), (["--rewiring", "--help"], "--frames DIR")],
)
def test_the_help_names_the_options(arguments, option, capsys):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 0
    assert option in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments",
    [
        ["--seconds", "0"],
        ["--max-silence", "x"],
        ["--frames", "."],
        ["--rewiring", "--frames", "/nowhere"],
        ["--rewiring", "--seconds", "0"],
        ["--rewiring", "--rate", "x"],
    ],
)
def test_a_wrong_option_is_refused(arguments):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2


def test_a_folder_without_frames_is_named(tmp_path, capsys):
    assert main(["--rewiring", "--frames", str(tmp_path)]) == FAILED
    assert f"no JPEG or PNG files in '{tmp_path}'" in capsys.readouterr().err
