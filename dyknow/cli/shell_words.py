"""An unfinished command line of bash, taken apart for completion and put together again."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import List, Tuple

#: Characters at which readline begins a new word, though for us the word goes on.
_BREAKS = ":="
_PLAIN = re.compile(r"[^A-Za-z0-9_@%+=:,./~^-]")


@dataclass(frozen=True)
class Line:
    """A command line up to the cursor.

    Attributes:
        words: the complete words, unquoted.
        last: the word at the cursor, unquoted; empty if none is begun.
        quote: the quotation mark that is still open in it, or nothing.
        kept: characters of `last` that readline keeps: it replaces those behind only.
    """

    words: Tuple[str, ...]
    last: str
    quote: str = ""
    kept: int = 0

    def written(self, candidate: str) -> str:
        """Write a candidate for the last word as readline is to insert it."""
        rest = candidate[self.kept :]
        if self.quote == "'":
            return rest
        if self.quote == '"':
            return re.sub(r'(["$`\\])', r"\\\1", rest)
        return _PLAIN.sub(lambda found: "\\" + found.group(), rest)


def split(text: str) -> Line:
    """Take a command line apart as bash does, its quotes and backslashes included."""
    words: List[str] = []
    word: List[str] = []
    begun = False
    quote = ""
    kept = 0
    position = 0
    while position < len(text):
        character = text[position]
        position += 1
        if quote == "'" and character != "'":
            word.append(character)
        elif character == quote:
            quote = ""
        elif character == "\\" and position < len(text):
            following = text[position]
            position += 1
            if quote and following not in '"$`\\':
                word.append(character)
            word.append(following)
            begun = True
        elif quote:
            word.append(character)
        elif character in "'\"":
            quote, begun = character, True
            kept = len(word)
        elif character.isspace():
            if begun:
                words.append("".join(word))
            word, begun, kept = [], False, 0
        else:
            word.append(character)
            begun = True
            if character in _BREAKS:
                kept = len(word)
    return Line(tuple(words), "".join(word), quote, kept)
