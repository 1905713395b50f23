"""Streams on request: planned, made, repaired, and collected when they are not needed.

``reconciler`` is where to begin; ``context`` has what its parts share.
"""
