"""What nodelet_core gives C++, for Python and without ROS: bus, scheduler, handles, loader."""

from dyknow.nodelet.nodelet import Nodelet

__all__ = ["Nodelet"]
