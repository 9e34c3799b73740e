"""docker/kubernetes: valid by Kubernetes' own schemas, and of one piece."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import kubernetes_validate
import pytest

from boxlift.errors import OptionsError
from boxlift_service.guards.api_keys import parse_keys
from docker.files import KUBERNETES, last_stage, manifest, settings_in, yaml_documents

# Kinds that Kubernetes itself does not know.
_OTHERS = {"Kustomization", "ServiceMonitor"}
# The oldest with pod-security labels and autoscaling/v2, and the newest whose schemas are at hand.
_VERSIONS = ("1.25", "1.37")


def _objects() -> Iterator[Any]:
    for path in sorted(KUBERNETES.glob("*.yaml")):
        for number, document in enumerate(yaml_documents(path)):
            if "kind" in document and document["kind"] not in _OTHERS:
                yield pytest.param(document, id=f"{path.stem}-{number}")


def _pod() -> dict[str, Any]:
    pod = manifest("Deployment")["spec"]["template"]["spec"]
    assert isinstance(pod, dict)
    return pod


def _container() -> dict[str, Any]:
    (container,) = _pod()["containers"]
    assert isinstance(container, dict)
    return container


def _environment() -> dict[str, str]:
    return {variable["name"]: variable["value"] for variable in _container()["env"]}


def _pod_labels() -> Mapping[str, str]:
    labels = manifest("Deployment")["spec"]["template"]["metadata"]["labels"]
    assert isinstance(labels, dict)
    return labels


@pytest.mark.parametrize("version", _VERSIONS)
@pytest.mark.parametrize("document", list(_objects()))
def test_valid_by_the_strict_schema(document: dict[str, Any], version: str) -> None:
    assert kubernetes_validate.validate(document, version, strict=True) == version


def test_schema_would_notice_a_wrong_field() -> None:
    deployment = manifest("Deployment")
    deployment["spec"]["template"]["spec"]["containers"][0]["readynessProbe"] = {}
    with pytest.raises(kubernetes_validate.ValidationError, match="readynessProbe"):
        kubernetes_validate.validate(deployment, _VERSIONS[-1], strict=True)


def test_kustomization_names_every_file_that_a_bare_cluster_takes() -> None:
    apart = {"kustomization", "secret.example", "service-monitor", "prometheus-adapter.values"}
    files = {path.name for path in KUBERNETES.glob("*.yaml") if path.stem not in apart}
    assert set(manifest("Kustomization")["resources"]) == files


@pytest.mark.parametrize(
    "selector",
    [
        manifest("Deployment")["spec"]["selector"]["matchLabels"],
        manifest("Service")["spec"]["selector"],
        manifest("PodDisruptionBudget")["spec"]["selector"]["matchLabels"],
        manifest("NetworkPolicy")["spec"]["podSelector"]["matchLabels"],
        _pod()["topologySpreadConstraints"][0]["labelSelector"]["matchLabels"],
    ],
)
def test_selectors_find_the_pods(selector: dict[str, str]) -> None:
    assert selector
    assert selector.items() <= _pod_labels().items()


def test_ports_are_named_alike() -> None:
    (port,) = _container()["ports"]
    assert port["containerPort"] == settings_in(_environment()).port
    (service_port,) = manifest("Service")["spec"]["ports"]
    (allowed,) = manifest("NetworkPolicy")["spec"]["ingress"][0]["ports"]
    probes = [_container()[f"{probe}Probe"]["httpGet"] for probe in ("startup", "readiness", "liveness")]
    named = [service_port["targetPort"], allowed["port"], *(probe["port"] for probe in probes)]
    assert set(named) == {port["name"]}


def test_lives_while_the_process_does_and_serves_while_ready() -> None:
    paths = {probe: _container()[f"{probe}Probe"]["httpGet"]["path"] for probe in ("readiness", "liveness")}
    assert paths == {"readiness": "/readyz", "liveness": "/healthz"}


def test_pod_is_what_a_restricted_namespace_takes() -> None:
    pod, rights = _pod()["securityContext"], _container()["securityContext"]
    (user,) = [line.split()[1] for line in last_stage() if line.startswith("USER ")]
    assert (pod["runAsNonRoot"], f"{pod['runAsUser']}:{pod['runAsGroup']}") == (True, user)
    assert pod["seccompProfile"] == {"type": "RuntimeDefault"}
    assert rights["allowPrivilegeEscalation"] is False
    assert rights["readOnlyRootFilesystem"] is True
    assert rights["capabilities"] == {"drop": ["ALL"]}
    assert _pod()["automountServiceAccountToken"] is False
    labels = manifest("Namespace")["metadata"]["labels"]
    assert labels["pod-security.kubernetes.io/enforce"] == "restricted"


def test_variables_of_services_do_not_become_settings() -> None:
    # Kubernetes would set BOXLIFT_PORT=tcp://... for the Service boxlift.
    assert manifest("Service")["metadata"]["name"] == "boxlift"
    assert _pod()["enableServiceLinks"] is False


def test_has_time_to_drain_and_finish() -> None:
    settings = settings_in(_environment())
    grace_s = _pod()["terminationGracePeriodSeconds"]
    assert grace_s >= settings.drain_s + settings.frame_limit_s + 5
    readiness = _container()["readinessProbe"]
    # A pod that is not ready any more is known to be so before its port closes.
    assert settings.drain_s > readiness["periodSeconds"] * readiness["failureThreshold"]


def test_has_a_core_for_each_worker_thread_and_room_for_bodies() -> None:
    settings = settings_in(_environment())
    resources = _container()["resources"]
    threads = (
        settings.label_workers * settings.label_threads + settings.detect_workers * settings.detect_threads
    )
    assert int(resources["requests"]["cpu"]) >= threads
    assert int(resources["limits"]["memory"].removesuffix("Gi")) * 2**30 >= 2 * settings.max_held_bytes


def test_keys_come_from_a_folder_that_changes_with_the_secret() -> None:
    keys = settings_in(_environment()).api_keys
    assert keys is not None
    (mount,) = [mount for mount in _container()["volumeMounts"] if mount["name"] == "keys"]
    assert str(keys.parent) == mount["mountPath"]
    assert "subPath" not in mount
    (volume,) = [volume for volume in _pod()["volumes"] if volume["name"] == "keys"]
    secret, _ = yaml_documents(KUBERNETES / "secret.example.yaml")
    assert volume["secret"]["secretName"] == secret["metadata"]["name"]
    assert keys.name in secret["stringData"]


def test_example_of_keys_lets_nobody_in() -> None:
    secret, _ = yaml_documents(KUBERNETES / "secret.example.yaml")
    with pytest.raises(OptionsError, match="64 hexadecimal digits"):
        parse_keys(secret["stringData"]["api-keys"], "api-keys")


def test_autoscaler_scales_the_deployment_alone() -> None:
    target = manifest("HorizontalPodAutoscaler")["spec"]["scaleTargetRef"]
    deployment = manifest("Deployment")
    assert target == {
        "apiVersion": deployment["apiVersion"],
        "kind": "Deployment",
        "name": deployment["metadata"]["name"],
    }
    assert "replicas" not in deployment["spec"]


def test_autoscaler_reads_the_queue_through_the_adapter() -> None:
    (metric,) = manifest("HorizontalPodAutoscaler")["spec"]["metrics"]
    (adapter,) = yaml_documents(KUBERNETES / "prometheus-adapter.values.yaml")
    (rule,) = adapter["rules"]["custom"]
    assert metric["pods"]["metric"]["name"] == rule["name"]["as"]
    assert rule["seriesQuery"].startswith("boxlift_queue_requests{")


def test_prometheus_operator_finds_the_service_and_its_key() -> None:
    monitor, service = manifest("ServiceMonitor"), manifest("Service")
    labels = service["metadata"]["labels"]
    assert monitor["spec"]["selector"]["matchLabels"].items() <= labels.items()
    # The alerts and the dashboard know the job by this name.
    assert labels[monitor["spec"]["jobLabel"]] == "boxlift"
    (endpoint,) = monitor["spec"]["endpoints"]
    (port,) = service["spec"]["ports"]
    assert endpoint["port"] == port["name"]
    _, secret = yaml_documents(KUBERNETES / "secret.example.yaml")
    credentials = endpoint["authorization"]["credentials"]
    assert credentials["name"] == secret["metadata"]["name"]
    assert credentials["key"] in secret["stringData"]
