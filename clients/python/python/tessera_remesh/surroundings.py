"""The environment variables that drivers read, as far as one has to be set.

On Linux, Mesa's layer that sorts GPUs asks the desktop which one it uses. Without a desktop, libwayland then prints
`error: XDG_RUNTIME_DIR is invalid or not set` for every look at the GPUs. Mesa has a variable that leaves the layer out. The command
`tessera` does the same (`src/cli/surroundings.rs`).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, MutableMapping


def _layer_is_useless(variables: Mapping[str, str]) -> bool:
    """Without a desktop to ask, and without a GPU that somebody chose by way of the layer."""
    desktop = any(os.path.isabs(variables.get(name, "")) for name in ("XDG_RUNTIME_DIR", "WAYLAND_DISPLAY"))
    desktop = desktop or "WAYLAND_SOCKET" in variables
    chosen = any(name in variables for name in ("NODEVICE_SELECT", "MESA_VK_DEVICE_SELECT", "DRI_PRIME"))
    return sys.platform == "linux" and not desktop and not chosen


def prepare(variables: MutableMapping[str, str] = os.environ) -> None:
    """Sets the variable where it helps. Called once, before the engine looks for a GPU."""
    if _layer_is_useless(variables):
        variables["NODEVICE_SELECT"] = "1"
