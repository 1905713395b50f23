"""Whole wirings: saved as XML, read, compared with what runs, and loaded; plain Python."""
