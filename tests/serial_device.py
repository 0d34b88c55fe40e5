"""A device that prints lines to a serial port: the far end of a pseudo-terminal."""

import os
import tty
from pathlib import Path
from typing import Self


class SerialDevice:
    """A device whose port has the path `port` while it is plugged in."""

    def __init__(self, port: Path) -> None:
        self.port = port

    def __enter__(self) -> Self:
        self.plug_in()
        return self

    def __exit__(self, *_: object) -> None:
        if self.port.is_symlink():
            self.unplug()

    def plug_in(self) -> None:
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.port.symlink_to(os.ttyname(self._theirs))

    def unplug(self) -> None:
        self.port.unlink()
        os.close(self._ours)
        os.close(self._theirs)

    def print(self, text: str) -> None:
        os.write(self._ours, text.encode())
