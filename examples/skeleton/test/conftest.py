from dyknow.testing.fixtures import nodelet_harness, ros_harness  # noqa: F401
