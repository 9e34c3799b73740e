"""`boxlift keys`: the API keys that the service knows."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

NameArgument = Annotated[
    str, typer.Argument(metavar="NAME", help="Whose key it is: A-Z a-z 0-9 . _ -", show_default=False)
]
FileOption = Annotated[
    Path,
    typer.Option("--file", metavar="FILE", envvar="BOXLIFT_API_KEYS", help="The file of hashed keys."),
]

keys = typer.Typer(no_args_is_help=True, help="Make, list and revoke API keys of the service.")


@keys.command()
def new(
    name: NameArgument,
    requests_per_minute: Annotated[
        int | None,
        typer.Option(
            min=0, max=999_999, help="Most requests in a minute; 0: no limit. [default: the service's]"
        ),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            envvar="BOXLIFT_API_KEYS",
            help="File to add the key's hash to; without one, its line is printed to stderr.",
        ),
    ] = None,
) -> None:
    """Make a key and print it, this once: only its hash is kept. A running service takes it up by itself."""
    from boxlift_service.guards.api_keys import add_key, new_key

    secret, key = new_key(name, requests_per_minute)
    if file is None:
        print(f"Add this line to the file that BOXLIFT_API_KEYS names:\n{key.line}", file=sys.stderr)
    else:
        add_key(file, key)
    print(secret)


@keys.command("list")
def list_keys(file: FileOption) -> None:
    """List names of keys, how their hashes begin, and their limits."""
    from boxlift_service.guards.api_keys import read_keys

    for key in read_keys(file):
        rate = key.requests_per_minute
        limit = {None: "the service's limit", 0: "no limit"}.get(rate, f"{rate} a minute")
        print(f"{key.name}\t{key.digest.hex()[:8]}\t{limit}")


@keys.command()
def revoke(name: NameArgument, file: FileOption) -> None:
    """Remove a key; a running service refuses it within a second."""
    from boxlift_service.guards.api_keys import revoke_key

    revoke_key(file, name)
