"""docs/benchmarks.md: what the recorded benchmarks printed, from benchmarks/results."""

from __future__ import annotations

import json

from record import RECORDED, RESULTS

_HEAD = """# Benchmarks

What these commands printed, with machine and commit. `python benchmarks/record.py [NAME ...]` runs them
again, `make docs` writes this page; `make bench` runs every benchmark there is. Real frames are KITTI's,
which are not in the repository; recall counts a truth as found by the box of its own prompt. Times were taken
on shared machines: believe ratios within a table.
"""


def made() -> dict[str, str | bytes]:
    """The page by its path below docs/."""
    lines = [_HEAD]
    for name, (title, _) in RECORDED.items():
        path = RESULTS / f"{name}.json"
        if not path.is_file():
            lines += [f"## {title}", "", f"Not recorded yet: `python benchmarks/record.py {name}`.", ""]
            continue
        result = json.loads(path.read_text(encoding="utf-8"))
        where = f"{result['machine']}, Python {result['python']}, commit {result['commit']}"
        when = f"{result['began'][:10]}, {result['seconds']} s"
        lines += [f"## {result['title']}", "", f"`{result['command']}` ({where}; {when})", ""]
        lines += ["```text", result["output"].rstrip(), "```", ""]
    return {"benchmarks.md": "\n".join(lines)}
