from __future__ import annotations

import re
from pathlib import Path

TESTS = Path(__file__).parents[1]
TABLE = (TESTS.parent / "docs" / "security.md").read_text(encoding="utf-8")
PROOF = re.compile(r"`([\w/]+)::(test_\w+)`")


def test_every_threat_has_a_test_that_exists() -> None:
    rows = [row.split("|") for row in TABLE.splitlines() if row.startswith("|")]
    threats = [row for row in rows[2:] if row[2].strip()]
    assert len(threats) > 30
    for _, threat, _, proof, _ in threats:
        assert PROOF.search(proof), f"no test proves: {threat}"
    for module, test in PROOF.findall(TABLE):
        of_service = "/" not in module or module.startswith("review/")
        path = TESTS / (f"service/{module}" if of_service else module)
        text = path.with_suffix(".py").read_text(encoding="utf-8")
        assert f"def {test}(" in text, f"there is no {module}::{test}"
