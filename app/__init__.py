"""The command line, the server, its workers and what they keep."""

from importlib.metadata import version

__version__ = version("graspwatch")
