"""Checks the files of deploy/ that no tool of their own is at hand for.

Overlays of kustomize are put together by the few rules that they use, and each object is held against the schemas of
Kubernetes. Envoy's configuration is read as Envoy's own messages. Compose files are read for what they refer to.
"""

import copy
import json
import pathlib
import sys

import kubernetes_validate
import yaml

HERE = pathlib.Path(__file__).parent
KUBERNETES = "1.33"


def documents(path):
    return [document for document in yaml.safe_load_all(path.read_text()) if document]


def point(tree, path, make=False):
    """The container of a JSON pointer, and the last step."""
    steps = [step.replace("~1", "/").replace("~0", "~") for step in path.split("/")[1:]]
    for step in steps[:-1]:
        tree = tree[int(step) if isinstance(tree, list) else step]
    return tree, steps[-1]


def patched(tree, operations):
    for operation in operations:
        place, last = point(tree, operation["path"])
        what = operation["op"]
        if isinstance(place, list):
            if last == "-":
                assert what == "add", operation
                place.append(operation["value"])
            elif what == "remove":
                del place[int(last)]
            elif what == "replace":
                place[int(last)] = operation["value"]
            else:
                place.insert(int(last), operation["value"])
        elif what == "remove":
            del place[last]
        else:
            assert what == "add" or last in place, operation
            place[last] = operation["value"]


SELECTORS = {
    "Service": ["spec/selector"],
    "StatefulSet": ["spec/selector/matchLabels", "spec/template/metadata/labels"],
    "PodDisruptionBudget": ["spec/selector/matchLabels"],
    "NetworkPolicy": ["spec/podSelector/matchLabels"],
}


def labelled(tree, labels, selectors):
    tree["metadata"].setdefault("labels", {}).update(labels)
    for path in SELECTORS.get(tree["kind"], []) if selectors else []:
        place = tree
        for step in path.split("/"):
            place = place.setdefault(step, {})
        place.update(labels)


def built(folder):
    """What `kustomize build` gives for a folder."""
    rules = documents(folder / "kustomization.yaml")[0]
    known = {"apiVersion", "kind", "resources", "components", "labels", "images", "patches"}
    assert set(rules) <= known, f"{folder}: {set(rules) - known}"
    trees = []
    for name in rules.get("resources", []):
        path = folder / name
        trees += built(path) if path.is_dir() else copy.deepcopy(documents(path))
    for name in rules.get("components", []):
        trees += built(folder / name)
    for tree in trees:
        for rule in rules.get("labels", []):
            labelled(tree, rule["pairs"], rule.get("includeSelectors"))
        for image in rules.get("images", []):
            for container in tree.get("spec", {}).get("template", {}).get("spec", {}).get("containers", []):
                if container["image"] == image["name"]:
                    container["image"] = f"{image['newName']}:{image['newTag']}"
    for patch in rules.get("patches", []):
        aims = [t for t in trees if t["kind"] == patch["target"]["kind"] and t["metadata"]["name"] == patch["target"]["name"]]
        assert aims, f"{folder}: no {patch['target']}"
        for tree in aims:
            patched(tree, yaml.safe_load(patch["patch"]))
    return trees


def check_kubernetes():
    root = HERE / "kubernetes"
    folders = [root / "base", *sorted((root / "overlays").iterdir())]
    for folder in folders:
        trees = built(folder)
        for tree in trees:
            kubernetes_validate.validate(tree, KUBERNETES, strict=True)
        pods = next(t for t in trees if t["kind"] == "StatefulSet")["spec"]["template"]["spec"]
        container = pods["containers"][0]
        variables = {variable["name"]: variable["value"] for variable in container["env"]}
        assert len(variables) == len(container["env"]), f"{folder}: a variable twice"
        # A drain that lasts longer than the pod may live would lose work.
        grace = float(variables.get("TESSERA_GRACE_S", 30))
        assert grace + 10 <= pods["terminationGracePeriodSeconds"], f"{folder}: grace {grace}"
        volumes = {volume["name"] for volume in pods.get("volumes", [])} | {"data"}
        assert {mount["name"] for mount in container["volumeMounts"]} <= volumes, folder
        guarded = "TESSERA_TLS_CERT" in variables and "TESSERA_REQUIRE_KEYS" in variables
        assert guarded != (variables.get("TESSERA_INSECURE") == "true"), f"{folder}: neither guarded nor insecure, or both"
        print(f"{folder.relative_to(HERE)}: {len(trees)} objects")
    component = built(root / "components" / "keda")
    assert component[0]["spec"]["scaleTargetRef"]["name"] == "tessera"


def check_envoy():
    from envoy.config.bootstrap.v3 import bootstrap_pb2
    from envoy.extensions.filters.http.router.v3 import router_pb2  # noqa: F401
    from envoy.extensions.filters.network.http_connection_manager.v3 import http_connection_manager_pb2  # noqa: F401
    from envoy.extensions.upstreams.http.v3 import http_protocol_options_pb2  # noqa: F401
    from google.protobuf import json_format

    tree = documents(HERE / "envoy" / "envoy.yaml")[0]
    told = json_format.ParseDict(tree, bootstrap_pb2.Bootstrap())
    clusters = {cluster.name for cluster in told.static_resources.clusters}
    routes = json.dumps(tree)
    assert all(f'"cluster": "{name}"' in routes for name in clusters), clusters
    print(f"envoy: {len(clusters)} clusters")


def check_compose():
    services = documents(HERE / "compose.yaml")[0]
    for name, service in services["services"].items():
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            there = (HERE / source).exists() if source.startswith(".") else source in services["volumes"]
            assert there, f"{name}: no {source}"
        for port in service.get("ports", []):
            assert port.startswith("127.0.0.1:"), f"{name}: {port} is open to other machines"
    for path in HERE.glob("compose.*.yaml"):
        for name in documents(path)[0]["services"]:
            assert name in services["services"], f"{path.name}: {name}"
    print(f"compose: {', '.join(services['services'])}")


if __name__ == "__main__":
    check_kubernetes()
    check_envoy()
    check_compose()
    sys.exit(0)
