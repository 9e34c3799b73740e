"""The command line: `boxlift COMMAND`. One file per command; what is heavy loads when a command runs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, NoReturn

from boxlift import __version__
from boxlift.errors import BoxliftError, MissingExtraError

try:
    import typer
except ModuleNotFoundError:
    sys.exit(f"error: {MissingExtraError('typer', 'client')}")

from boxlift_client.cli.convert import convert
from boxlift_client.cli.corrections import corrections
from boxlift_client.cli.demo import demo
from boxlift_client.cli.detect import detect
from boxlift_client.cli.evaluate import evaluate
from boxlift_client.cli.export import export
from boxlift_client.cli.keys import keys
from boxlift_client.cli.label import label
from boxlift_client.cli.report import report
from boxlift_client.cli.serve import serve
from boxlift_client.cli.show import show
from boxlift_client.cli.track import track
from boxlift_client.cli.train import train

_USER_ERROR = 2

app = typer.Typer(
    name="boxlift",
    help="3D boxes from 2D boxes and LiDAR, without a drawn 3D label.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_COMMANDS = (
    demo,
    serve,
    label,
    track,
    detect,
    corrections,
    convert,
    evaluate,
    report,
    show,
    train,
    export,
)
for command in _COMMANDS:
    app.command()(command)
app.add_typer(keys, name="keys")


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"boxlift {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """3D boxes from 2D boxes and LiDAR, without a drawn 3D label."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run a command and exit: 0 when all is well, 1 when frames failed, 2 when the input is wrong."""
    try:
        app(args=arguments, prog_name="boxlift")
    # ImportError: a library of the system that Open3D needs; its message says which.
    except (BoxliftError, ImportError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(_USER_ERROR)
    except OSError as error:
        print(f"error: {error.filename or 'a file'}: {error.strerror or error}", file=sys.stderr)
        sys.exit(_USER_ERROR)
    sys.exit(0)
