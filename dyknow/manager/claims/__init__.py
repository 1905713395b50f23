"""Streams on request: made, kept, mended and collected."""
