# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The demonstration, as far as it needs no ROS: its command line, and its lines."""

from __future__ import annotations

import io
import os
import sys
from collections import Counter
from functools import partial

import pytest
from clocks import in_thread, join

from dyknow_demo.main import main
from dyknow_demo.processes import tell


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ("--help", 0),
        ("--seconds 0", 2),
        ("--max-silence x", 2),
        ("--frames .", 2),
        ("--rewiring", 2),
    ],
)
def test_help_and_wrong_options_end_it(arguments, code, capsys):
    with pytest.raises(SystemExit) as end:
        main(arguments.split())
    assert end.value.code == code
    assert "--max-silence" in capsys.readouterr().out or code


def test_lines_of_several_threads_stay_whole(monkeypatch):
    """Where Python does not buffer what it writes, and its reader is slow."""
    reading, writing = os.pipe()
    output = io.TextIOWrapper(io.FileIO(writing, "w"), write_through=True)
    monkeypatch.setattr(sys, "stdout", output)
    lines = [f"{number}" * 2000 for number in range(4)]

    def talk(line):
        for _ in range(100):
            tell(line)

    threads = [in_thread(partial(talk, line)) for line in lines]
    with open(reading, encoding="ascii") as reader:
        found = Counter(next(reader) for _ in range(400))
    join(*threads)
    output.close()
    assert found == {f"{line}\n": 100 for line in lines}
