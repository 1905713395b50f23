"""Frames of two cameras through a chain that is re-wired by hand; none is lost or doubled."""
