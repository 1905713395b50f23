# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of the demonstrations, as far as it needs no ROS."""

from __future__ import annotations

import pytest

from dyknow_demo.main import main


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
