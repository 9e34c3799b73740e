"""Runs benchmarks and keeps what they print, with machine, date and commit, for docs/benchmarks.md.

    python benchmarks/record.py [NAME ...]      # none: all of RECORDED; then `make docs`

Results lie in benchmarks/results/NAME.json, each of its own commit.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from serving.report import circumstances

_HERE = Path(__file__).resolve().parent
RESULTS = _HERE / "results"

# What the pages quote: name -> (heading, arguments).
RECORDED = {
    "presets": ("Presets, and boxes against masks", ["presets.py"]),
    "accurate": ("The default preset by drive", ["accurate.py"]),
    "prompts": ("Worse 2D boxes, fixed sizes, masks", ["prompts.py"]),
    "scaled_world": ("A smaller and a larger world", ["scaled_world.py"]),
    "ablation": ("Every repair of `accurate` switched off alone", ["ablation.py", "--part", "accurate"]),
    "rig_check": ("Calibration mistakes that are noticed", ["rig_check.py"]),
    "tracking": ("Drives, before and after tracking", ["tracking.py", "real"]),
    "fit": ("The fit against brute force and against Adam", ["fit.py"]),
    "label": ("Time of a frame", ["label.py"]),
    "label_http": ("Time of POST /label", ["label_http.py"]),
    "detect_http": ("Time of POST /detect", ["detect_http.py"]),
    "review_page": ("The review page with 300 objects", ["review_page.py"]),
}


def main() -> None:
    """Run and write; a benchmark that fails leaves its old result."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(RECORDED))
    names = parser.parse_args().names or list(RECORDED)
    failed = [name for name in names if not _recorded(name)]
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


def _recorded(name: str) -> bool:
    title, arguments = RECORDED[name]
    told = circumstances({})
    began = time.perf_counter()
    command = [sys.executable, str(_HERE / arguments[0]), *arguments[1:]]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    if ran.returncode != 0:
        print(ran.stderr, file=sys.stderr)
        return False
    result = {
        "title": title,
        "command": " ".join(["python", f"benchmarks/{arguments[0]}", *arguments[1:]]),
        **{each: told[each] for each in ("machine", "python", "commit", "began")},
        "seconds": round(time.perf_counter() - began),
        # Where the data lie is this machine's own business.
        "output": ran.stdout.replace(str(_HERE.parents[1]), ".."),
    }
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(f"{name}: {result['seconds']} s")
    return True


if __name__ == "__main__":
    main()
