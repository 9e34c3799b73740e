"""Imported by the fork server alone, the process whose copies label: a new worker is there at once.

Loading computes nothing and starts no thread, so the copies are as good as new. What cannot be loaded is
missed by the worker that wants to use it, and its opening says so.
"""

import signal
from contextlib import suppress

# Service managers signal the whole group; this process ends with the service's, when its pipe closes.
for _number in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(_number, signal.SIG_IGN)

with suppress(Exception):
    import torch as torch
with suppress(Exception):
    import open3d as open3d
with suppress(Exception):
    pass
