"""The tabs of the control panel, a module for each."""
