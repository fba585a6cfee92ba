"""Checks how the files of deploy/ fit together, and to the sources.

Usage: check_files.py KUBECTL

Overlays are put together by kustomize. Each object is held against the schemas of Kubernetes, and the pods against what their own
numbers mean: a drain that lasts longer than a pod may live would lose work.
"""

import pathlib
import re
import subprocess
import sys

import kubernetes_validate
import yaml
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

HERE = pathlib.Path(__file__).parent
KUBERNETES = "1.33"
# Seconds that a server may take after its grace period: cut, close, join.
AFTER_GRACE = 17
NAME = {"app.kubernetes.io/name": "tessera"}


class Wrong(Exception):
    """Something does not fit."""


def need(holds, words):
    if not holds:
        raise Wrong(words)


def documents(path):
    return [document for document in yaml.safe_load_all(path.read_text()) if document]


def one(objects, kind):
    found = [entry for entry in objects if entry["kind"] == kind]
    need(len(found) == 1, f"{len(found)} objects of kind {kind}")
    return found[0]


def check_pods(objects):
    pods = one(objects, "StatefulSet")["spec"]["template"]
    need(pods["metadata"]["labels"].items() >= NAME.items(), "the pods lack their label")
    spec = pods["spec"]
    containers = spec["containers"] + spec.get("initContainers", [])
    images = {container["image"] for container in containers}
    need(len(images) == 1 and "/" in images.pop(), "containers have several images, or one without a registry")
    # What the profile "restricted" of Kubernetes' pod security standards asks for.
    need(spec["securityContext"]["runAsNonRoot"], "may run as root")
    need(spec["securityContext"]["seccompProfile"]["type"] == "RuntimeDefault", "no seccomp profile")
    for container in containers:
        rules = container["securityContext"]
        need(not rules["allowPrivilegeEscalation"] and rules["readOnlyRootFilesystem"], container["name"])
        need(rules["capabilities"] == {"drop": ["ALL"]}, container["name"])
        known = {volume["name"] for volume in spec.get("volumes", [])} | {"data"}
        need({mount["name"] for mount in container["volumeMounts"]} <= known, "a mount without its volume")
    server = spec["containers"][0]
    variables = {variable["name"]: variable["value"] for variable in server["env"]}
    need(len(variables) == len(server["env"]), "a variable twice")
    rests = server["lifecycle"]["preStop"]["sleep"]["seconds"]
    needed = rests + float(variables["TESSERA_GRACE_S"]) + AFTER_GRACE
    need(needed <= spec["terminationGracePeriodSeconds"], f"a pod needs {needed} s to end")
    guarded = {"TESSERA_TLS_CERT", "TESSERA_TLS_KEY", "TESSERA_REQUIRE_KEYS"} <= set(variables)
    need(guarded != ("TESSERA_INSECURE" in variables), "neither guarded nor insecure, or both")
    for variable in variables:
        option = variable.removeprefix("TESSERA_").lower().replace("_", "-")
        need(f"`--{option}`" in options(), f"{variable} is no option")


def check_selectors(objects):
    need(one(objects, "NetworkPolicy")["spec"]["podSelector"]["matchLabels"] == NAME, "the network policy is for other pods")
    need(one(objects, "PodDisruptionBudget")["spec"]["selector"]["matchLabels"] == NAME, "the budget is for other pods")
    clients = one(objects, "NetworkPolicy")["spec"]["ingress"][0]["from"][0]["podSelector"]["matchLabels"]
    need(clients == {"tessera-client": "true"}, f"clients need other labels: {clients}")
    for entry in objects:
        if entry["kind"] == "Service":
            need(entry["spec"]["selector"] == NAME, f"{entry['metadata']['name']} selects other pods")


def check_kubernetes(kubectl):
    for folder in sorted((HERE / "kubernetes" / "overlays").iterdir()):
        text = subprocess.run([kubectl, "kustomize", folder], check=True, stdout=subprocess.PIPE).stdout
        objects = [entry for entry in yaml.safe_load_all(text) if entry]
        own = [entry for entry in objects if entry["apiVersion"].split("/")[0] in ("v1", "apps", "policy", "networking.k8s.io")]
        for entry in own:
            kubernetes_validate.validate(entry, KUBERNETES, strict=True)
        try:
            check_pods(objects)
            check_selectors(objects)
        except Wrong as wrong:
            raise Wrong(f"{folder.name}: {wrong}") from wrong
        others = sorted({entry["kind"] for entry in objects if entry not in own})
        print(f"{folder.name}: {len(own)} objects" + (f"; of extensions, not checked: {', '.join(others)}" if others else ""))


def options():
    return (HERE.parent / "docs" / "configuration.md").read_text()


def check_compose():
    rules = documents(HERE / "compose.yaml")[0]
    for name, service in rules["services"].items():
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            there = (HERE / source).exists() if source.startswith(".") else source in rules["volumes"]
            need(there, f"compose: {name}: no {source}")
        for port in service.get("ports", []):
            need(port.startswith("127.0.0.1:"), f"compose: {name}: {port} is open to other machines")
        need(service["read_only"] and service["cap_drop"] == ["ALL"], f"compose: {name}")
    server = rules["services"]["tessera"]
    grace = float(server["environment"]["TESSERA_GRACE_S"]) + AFTER_GRACE
    need(grace <= float(server["stop_grace_period"].rstrip("s")), f"compose: the server needs {grace} s to end")
    for path in HERE.glob("compose.*.yaml"):
        for name in documents(path)[0]["services"]:
            need(name in rules["services"], f"{path.name}: {name}")
    targets = documents(HERE / "prometheus" / "targets.yml")[0][0]["targets"]
    need(targets == ["tessera:9090"], f"Prometheus looks at {targets}")
    print(f"compose: {', '.join(rules['services'])}")


def check_versions():
    version = re.search(r'^version = "(.+)"$', (HERE.parent / "Cargo.toml").read_text(), re.M)[1]
    need(f"ARG VERSION={version}\n" in (HERE / "Dockerfile").read_text(), "Dockerfile: VERSION is not Cargo.toml's")
    images = documents(HERE / "kubernetes" / "base" / "kustomization.yaml")[0]["images"]
    need(images[0]["newTag"] == version, "kubernetes/base: newTag is not Cargo.toml's version")


def check_bill():
    notices = [sys.executable, HERE / "release" / "notices.py"]
    bill = subprocess.run([*notices, "sbom"], check=True, stdout=subprocess.PIPE, text=True).stdout
    fault = JsonStrictValidator(SchemaVersion.V1_5).validate_str(bill)
    need(fault is None, f"the bill of materials: {fault}")
    licences = subprocess.run([*notices, "licences"], check=True, stdout=subprocess.PIPE, text=True).stdout
    need("Permission is hereby granted" in licences, "the list of licences has no texts")
    print(f"packages: {bill.count('bom-ref') - 1} in the bill of materials")


if __name__ == "__main__":
    try:
        check_versions()
        check_kubernetes(sys.argv[1])
        check_compose()
        check_bill()
    except Wrong as wrong:
        sys.exit(f"deploy: {wrong}")
