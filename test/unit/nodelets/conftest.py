from dyknow.testing.fixtures import nodelet_harness

__all__ = ["nodelet_harness"]
