# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Errors of bags."""

from __future__ import annotations

import contextlib
from typing import Iterator

import rosbag

from dyknow.errors import DyKnowError


@contextlib.contextmanager
def bag_errors(path: str) -> Iterator[None]:
    """Raise DyKnowError for a bag that cannot be read in the block."""
    try:
        yield
    except (OSError, rosbag.ROSBagException) as error:
        raise DyKnowError(f"bag '{path}' cannot be read: {error}") from error
    except Exception as error:  # the boundary: rosbag does not check what it reads
        problem = f"{type(error).__name__}: {error}"
        raise DyKnowError(f"bag '{path}' is damaged, or is no bag ({problem})") from error
