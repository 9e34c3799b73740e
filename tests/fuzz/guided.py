"""Fuzzes one decoder, led by the lines that inputs reach (atheris): see benchmarks/fuzz_decoders.py.

    python -m fuzz.guided DECODER INPUTS SEED RESULT FOUND CORPUS

RESULT is written as JSON, findings into the folder FOUND; CORPUS is a folder for the inputs that led to
new lines. An input that crashes or hangs the process is in FOUND too, and the exit status is not 0.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import resource
import sys
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

atheris: Any = import_module("atheris")  # a C extension without types

# Python code alone; NumPy's and Pillow's C code is not led, but its crashes are seen.
_LED_BY = [
    *("boxlift", "boxlift_service", "python_multipart.multipart", "zipfile", "tomllib"),
    *("PIL.PngImagePlugin", "PIL.JpegImagePlugin", "PIL.ImageFile"),
]

with atheris.instrument_imports(include=_LED_BY):
    from fuzz.decoders import decoders
    from fuzz.mutator import LONGEST
    from fuzz.trial import FindingError, Trial

_MOST_MEMORY_BYTES = 4 * 2**30
_MOST_FINDINGS = 20


class _Run:
    def __init__(self, name: str, inputs: int, result: Path, found: Path) -> None:
        self._name = name
        self._inputs = inputs
        self._result = result
        self._found = found
        self.decoder = decoders()[name]
        self._trial = Trial(self.decoder.decode)
        self._given = 0
        self._findings: dict[str, str] = {}

    def give(self, data: bytes) -> None:
        """Called with each input."""
        try:
            self._trial.examine(data)
        except FindingError as error:
            self._keep(str(error), data)
        self._given += 1
        if self._given >= self._inputs or len(self._findings) >= _MOST_FINDINGS:
            tally = asdict(self._trial.tally)
            self._result.write_text(json.dumps({**tally, "findings": list(self._findings.values())}))
            os._exit(0)  # libFuzzer would begin a report of its own

    def mutated(self, data: bytes, longest: int, seed: int) -> bytes:
        """libFuzzer's own way, which knows what the code compares with; from whole files; from `data`."""
        way, rest = seed % 5, seed // 5
        if way == 0:
            mutated: bytes = atheris.Mutate(data, longest)
            return mutated
        start = self.decoder.seeds[rest % len(self.decoder.seeds)] if way <= 2 else data
        return self.decoder.damaged(start, seed)[:longest]

    def _keep(self, text: str, data: bytes) -> None:
        """One input of each kind of finding."""
        kind = re.sub(r"\d+", "#", text)[:80]
        if kind not in self._findings:
            path = self._found / f"{self._name}--{hashlib.sha256(data).hexdigest()[:12]}"
            path.write_bytes(data)
            self._findings[kind] = f"{path}: {text}"


def _main() -> None:
    name, inputs, seed, result, found, corpus = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY_BYTES, _MOST_MEMORY_BYTES))
    run = _Run(name, int(inputs), Path(result), Path(found))
    for index, data in enumerate(run.decoder.seeds):
        (Path(corpus) / f"seed{index}").write_bytes(data)
    flags = [f"-seed={seed}", f"-max_len={LONGEST}", "-len_control=0", "-timeout=2", "-rss_limit_mb=2048"]
    atheris.Setup(
        [sys.argv[0], *flags, f"-artifact_prefix={found}/{name}--", corpus],
        run.give,
        custom_mutator=run.mutated,
    )
    atheris.Fuzz()


if __name__ == "__main__":
    _main()
