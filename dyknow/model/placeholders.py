# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Placeholders: `${?x}` in the text of a parameter stands for the name that `?x` is bound to.

Directly before `{?` each pair of dollars stands for one dollar, so `$${?x}` is the text `${?x}`
itself, and `$$${?x}` a dollar before a name.
"""

from __future__ import annotations

import re
from typing import Iterable, List, Mapping, NamedTuple, Tuple, Union

_DOLLARS = re.compile(r"(?<!\$)\$+(?=\{\?)")
_REST = re.compile(r"\{(\?[^{}]*)\}")
_LAST_DOLLARS = re.compile(r"(?<!\$)\$+\Z")


class Placeholder(NamedTuple):
    """Stands for the name that a variable, such as `?x`, is bound to."""

    variable: str


Pieces = Tuple[Union[str, Placeholder], ...]


def cut(text: str) -> Pieces:
    """Cut a text at its placeholders; the pieces between them are plain.

    Raises ValueError if a placeholder does not end.
    """
    pieces: List[Union[str, Placeholder]] = []
    plain, start = "", 0
    for dollars in _DOLLARS.finditer(text):
        pairs, is_placeholder = divmod(len(dollars.group()), 2)
        plain += text[start : dollars.start()] + "$" * pairs
        start = dollars.end()
        if is_placeholder:
            rest = _REST.match(text, start)
            if rest is None:
                raise ValueError("'${?' without '}'")
            pieces += [plain, Placeholder(rest.group(1).strip())]
            plain, start = "", rest.end()
    pieces.append(plain + text[start:])
    return tuple(piece for piece in pieces if piece)


def join(pieces: Iterable[Union[str, Placeholder]]) -> str:
    """Write the text that `cut` cuts so."""
    text, plain = "", ""
    for piece in pieces:
        if isinstance(piece, Placeholder):
            text += _LAST_DOLLARS.sub(_doubled, _escaped(plain)) + f"${{{piece.variable}}}"
            plain = ""
        else:
            plain += piece
    return text + _escaped(plain)


def variables_of(text: str) -> Tuple[str, ...]:
    """Return the variables of a text's placeholders, each once, in the order written."""
    if "${?" not in text:
        return ()
    found = [piece.variable for piece in cut(text) if isinstance(piece, Placeholder)]
    return tuple(dict.fromkeys(found))


def fill(text: str, names: Mapping[str, str]) -> str:
    """Put names for the placeholders of a text; KeyError if a variable has none."""
    if "${?" not in text:
        return text
    return "".join(
        [names[piece.variable] if isinstance(piece, Placeholder) else piece for piece in cut(text)]
    )


def _escaped(plain: str) -> str:
    return _DOLLARS.sub(_doubled, plain)


def _doubled(dollars: re.Match[str]) -> str:
    return 2 * dollars.group()
