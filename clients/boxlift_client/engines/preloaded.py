"""What every worker needs, imported once in the server that they are forked from: they share its memory.

Nothing is computed here: threads do not survive a fork.
"""

from contextlib import suppress
from importlib import import_module

from boxlift.errors import MissingExtraError
from boxlift.extras import open3d

with suppress(MissingExtraError):  # each worker will say so
    open3d()
with suppress(ImportError):
    import_module("boxlift.labeller")
