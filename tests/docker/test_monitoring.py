"""Dashboard and alerts ask for series that the running service has, by labels that these have."""

from __future__ import annotations

import itertools
import re
import shutil
import subprocess
from collections import defaultdict
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from docker.files import DOCKER, KUBERNETES, ROOT, dashboard, yaml_documents
from service.frames import detect_parts, grey_png, small_frame
from service.running import running_service

# What Prometheus adds to each series.
_ADDED = {"job", "instance"}
# Series of Prometheus itself.
_ITS_OWN = {"up": {"job", "instance"}, "ALERTS": {"alertname", "alertstate"}}


def _targets() -> list[tuple[str, str]]:
    return [
        (panel["title"], target["expr"])
        for panel in dashboard()["panels"]
        for target in panel.get("targets", [])
    ]


def _rules() -> list[dict[str, Any]]:
    (document,) = yaml_documents(DOCKER / "prometheus" / "alerts.yml")
    (group,) = document["groups"]
    return list(group["rules"])


def _variables() -> list[tuple[str, str]]:
    queries = [
        (variable["name"], variable["query"]["query"])
        for variable in dashboard()["templating"]["list"]
        if variable["type"] == "query"
    ]
    # label_values(boxlift_requests_total{...}, route): the second is a label.
    return [
        (f"variable {name}", re.sub(r"label_values\((.+), (\w+)\)", r"count by (\2) (\1)", query))
        for name, query in queries
    ]


def _adapter() -> list[tuple[str, str]]:
    (document,) = yaml_documents(KUBERNETES / "prometheus-adapter.values.yaml")
    return [
        (rule["name"]["as"], rule["seriesQuery"].replace('namespace!="", pod!=""', ""))
        for rule in document["rules"]["custom"]
    ]


EXPRESSIONS = [*_targets(), *((rule["alert"], rule["expr"]) for rule in _rules()), *_variables(), *_adapter()]


def series_in(expression: str) -> list[tuple[str, set[str]]]:
    """Names of the series in a PromQL expression, each with the labels that it is selected by."""
    return [
        (name, set(re.findall(r"(\w+)\s*(?:=~|!~|!=|=)", selector or "")))
        for name, selector in re.findall(
            r"\b(up|ALERTS|(?:boxlift|process)_[a-z_]+)\b(?:\{([^}]*)\})?", expression
        )
    ]


def labels_grouped_by(expression: str) -> set[str]:
    """Labels in the `by (...)` of a PromQL expression."""
    found = re.findall(r"\bby \(([^)]*)\)", expression)
    return {label.strip() for labels in found for label in labels.split(",")}


@pytest.fixture(scope="module")
def labels_of() -> dict[str, set[str]]:
    """Labels by name of the series, as a service tells that labelled a frame and looked at an image."""
    with running_service() as service:
        assert service.label(small_frame().fields()).status_code == 200
        assert service.detect(detect_parts(grey_png())).status_code == 200
        text = service.client.get("/metrics").text
    labels: dict[str, set[str]] = defaultdict(set)
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            labels[sample.name] |= set(sample.labels)
    return {name: found | _ADDED for name, found in labels.items()} | _ITS_OWN


@pytest.mark.parametrize(("title", "expression"), EXPRESSIONS, ids=[title for title, _ in EXPRESSIONS])
def test_asks_for_series_that_there_are(title: str, expression: str, labels_of: dict[str, set[str]]) -> None:
    asked = series_in(expression)
    assert asked, f"{title} asks for nothing"
    for name, labels in asked:
        assert name in labels_of, f"{title} asks for {name}, which the service does not have"
        assert labels <= labels_of[name], f"{title} selects {name} by {labels - labels_of[name]}"
    available = {label for name, _ in asked for label in labels_of[name]}
    assert labels_grouped_by(expression) <= available


def test_every_metric_of_ours_is_on_the_dashboard(labels_of: dict[str, set[str]]) -> None:
    shown = {name for _, expression in _targets() for name, _ in series_in(expression)}
    shown = {re.sub("_(bucket|sum|count)$", "", name) for name in shown}
    ours = {re.sub("_(bucket|sum|count)$", "", name) for name in labels_of if name.startswith("boxlift_")}
    assert ours == {name for name in shown if name.startswith("boxlift_")}


def test_panels_are_numbered_and_do_not_overlap() -> None:
    panels = dashboard()["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    for one, other in itertools.combinations([panel["gridPos"] for panel in panels], 2):
        apart_x = one["x"] + one["w"] <= other["x"] or other["x"] + other["w"] <= one["x"]
        apart_y = one["y"] + one["h"] <= other["y"] or other["y"] + other["h"] <= one["y"]
        assert apart_x or apart_y
    assert all(panel["gridPos"]["x"] + panel["gridPos"]["w"] <= 24 for panel in panels)


def test_panels_use_only_variables_that_there_are() -> None:
    variables = {variable["name"] for variable in dashboard()["templating"]["list"]}
    used = {name for _, expression in _targets() for name in re.findall(r"\$(\w+)", expression)}
    assert used == variables - {"datasource"} | {"__rate_interval"}
    sources = {panel["datasource"]["uid"] for panel in dashboard()["panels"] if panel["type"] != "row"}
    assert sources == {"${datasource}"}


def test_every_alert_says_what_to_do() -> None:
    for rule in _rules():
        assert rule["labels"]["severity"] in ("warning", "critical")
        assert set(rule["annotations"]) == {"summary", "action"}


@pytest.mark.skipif(shutil.which("promtool") is None, reason="no promtool (Debian package prometheus)")
@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "rules", "docker/prometheus/alerts.yml"),
        ("check", "config", "--syntax-only", "docker/prometheus/prometheus.yml"),
        ("test", "rules", "tests/docker/alerts_test.yml"),
    ],
)
def test_prometheus_own_tool_agrees(arguments: tuple[str, ...]) -> None:
    result = subprocess.run(
        ["promtool", *arguments], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60
    )
    assert result.returncode == 0, result.stdout + result.stderr
