"""The command line, the server and the supervision of the workers."""

from importlib.metadata import version

__version__ = version("graspwatch")
