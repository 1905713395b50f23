# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Writes files atomically: a reader sees the old contents or the new."""

from __future__ import annotations

import contextlib
import os
import tempfile

from dyknow.errors import DyKnowError


class CannotWrite(DyKnowError):
    """A file cannot be written."""


def write_file(path: str, data: bytes) -> None:
    """Write a file; an existing one is replaced once the new one is complete.

    Raises:
        CannotWrite: with the reason.
    """
    try:
        if os.path.exists(path) and not os.path.isfile(path):  # /dev/stdout, a pipe
            with open(path, "wb") as special:
                special.write(data)
            return
        _replace(os.path.realpath(path), data)
    except OSError as error:
        raise CannotWrite(f"{path}: cannot be written: {error.strerror}") from error


def _replace(path: str, data: bytes) -> None:
    handle, draft = tempfile.mkstemp(dir=os.path.dirname(path), prefix=".dyknow-")
    try:
        with open(handle, "wb") as file:
            file.write(data)
        os.chmod(draft, _mode_of(path))
        os.replace(draft, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(draft)
        raise


def _mode_of(path: str) -> int:
    try:
        return os.stat(path).st_mode & 0o777
    except FileNotFoundError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask
