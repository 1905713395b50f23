"""The tabs of the control panel, one a module."""
