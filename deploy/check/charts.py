"""Renders the chart with Helm's library and checks the resources, without a cluster.

    python charts.py CHART

The script renders the chart with each file of values in ci/. The schemas of the oldest and the newest version
of Kubernetes must accept the resources, and the pods must meet the Pod Security Standard `restricted`.
Selectors, ports, volumes and policies of different resources must agree.
"""

import json
import pathlib
import re
import sys

import helm_python as helm
import jsonschema
import kubernetes_validate
import yaml

# The chart's kubeVersion, and the newest version with schemas in kubernetes-validate.
VERSIONS = ("1.27", "1.37")
HERE = pathlib.Path(__file__).parent
# Values that the chart must reject, and a text that the error must contain.
REFUSED = [
    ({"store": {"kind": "mysql"}}, "kind"),
    ({"store": {"postgres": {"url": "postgres://me:secret@db/sightline"}}}, "url"),
    ({"store": {"blobs": {"url": "ftp://somewhere"}}}, "url"),
    ({"traces": {"url": "collector:4317"}}, "url"),
    ({"tls": {"workerSecret": "worker-tls"}}, "tokens.workerSecret"),
    ({"tokens": {"workerSecret": ""}}, "tokens.workerSecret"),
    ({"coordinator": {"quota": ["everything"]}}, "quota"),
    ({"coordinator": {"replica": 3}}, "replica"),
    ({"coordinator": {"replicas": 0}}, "replicas"),
    ({"workers": {"cpu": {"backend": "tpu"}}}, "backend"),
    ({"workers": {"cpu": {"scaling": {"enabled": "yes"}}}}, "enabled"),
]


class Wrong(Exception):
    """The error of a check that fails."""


def must(holds, what):
    """Raises Wrong with a message if a condition is false."""
    if not holds:
        raise Wrong(what)


def closed(schema):
    """Returns a copy of a schema that rejects fields without a definition in the schema."""
    if isinstance(schema, list):
        return [closed(s) for s in schema]
    if not isinstance(schema, dict):
        return schema
    schema = {k: closed(v) for k, v in schema.items()}
    if isinstance(schema.get("properties"), dict) and schema.get("type") == "object":
        if not schema.get("x-kubernetes-preserve-unknown-fields"):
            schema.setdefault("additionalProperties", False)
    return schema


def of_others():
    """Yields (kind, group, version) and the schema of each file in crds/."""
    for path in sorted((HERE / "crds").glob("*.json")):
        kind, group, version = path.stem.split("-")
        schema = json.loads(path.read_text())
        schema["properties"]["metadata"] = {"type": "object", "x-kubernetes-preserve-unknown-fields": True}
        yield (kind, group, version), closed(schema)


OTHERS = dict(of_others())


def check_schema(document):
    """Validates a resource with its schemas."""
    group, _, version = document["apiVersion"].rpartition("/")
    schema = OTHERS.get((document["kind"].lower(), group.split(".")[0], version))
    if schema is not None:
        jsonschema.Draft202012Validator(schema).validate(document)
        return
    for version in VERSIONS:
        kubernetes_validate.validate(document, version, strict=True)


def check_pod(name, spec, labels):
    """Checks that a pod meets the Pod Security Standard `restricted` and that its volumes and ports exist."""
    pod = spec["securityContext"]
    must(pod["runAsNonRoot"] is True and pod["runAsUser"] > 0, f"{name}: the pod may run as root")
    must(pod["seccompProfile"]["type"] == "RuntimeDefault", f"{name}: the pod has no seccomp profile")
    must(spec["automountServiceAccountToken"] is False, f"{name}: the pod mounts a token of the cluster")
    for field in ("hostNetwork", "hostPID", "hostIPC"):
        must(not spec.get(field), f"{name}: the pod uses {field}")
    volumes = {v["name"]: v for v in spec.get("volumes", [])}
    for volume in volumes.values():
        must(set(volume) - {"name"} <= {"emptyDir", "secret", "configMap"},
             f"{name}: the pod has a volume of another type: {volume}")
    for container in spec["containers"]:
        security = container["securityContext"]
        must(security["allowPrivilegeEscalation"] is False, f"{name}: the container may gain privileges")
        must(security["readOnlyRootFilesystem"] is True, f"{name}: the root file system is writable")
        must(security["capabilities"] == {"drop": ["ALL"]}, f"{name}: the container has capabilities")
        must(container["resources"]["limits"].get("memory"), f"{name}: the container has no memory limit")
        mounts = {m["name"] for m in container.get("volumeMounts", [])}
        must(mounts <= set(volumes) | claims(labels), f"{name}: the pod has no volumes for some of {mounts}")
        must(set(volumes) <= mounts, f"{name}: the container does not mount all of {set(volumes)}")
        ports = {p["name"]: p["containerPort"] for p in container["ports"]}
        for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
            asked = container[probe]
            port = asked["httpGet"]["port"] if "httpGet" in asked else asked["grpc"]["port"]
            must(port in ports or port in ports.values(), f"{name}: {probe} uses the unknown port {port}")
        known = {e["name"] for e in container.get("env", [])}
        for text in container["args"]:
            must(set(re.findall(r"\$\((\w+)\)", text)) <= known, f"{name}: unknown variable in {text}")


def claims(workload):
    """Returns the names of the volume claims of a workload."""
    return {c["metadata"]["name"] for c in workload["spec"].get("volumeClaimTemplates", [])}


def matches(selector, labels):
    """Returns true if a selector matches labels."""
    return selector.items() <= labels.items()


def check_together(documents):
    """Checks that the references between resources are correct."""
    kinds = {}
    for document in documents:
        kinds.setdefault(document["kind"], []).append(document)
    workloads = kinds.get("Deployment", []) + kinds.get("StatefulSet", [])
    must(workloads, "the chart renders no pods")

    def selected(selector):
        """Returns the workloads whose pods a selector matches."""
        return [w for w in workloads if matches(selector, w["spec"]["template"]["metadata"]["labels"])]

    for workload in workloads:
        name, template = workload["metadata"]["name"], workload["spec"]["template"]
        check_pod(name, template["spec"], workload)
        own = selected(workload["spec"]["selector"]["matchLabels"])
        must(own == [workload], f"{name}: the selector does not match exactly the workload's pods")
        service = workload["spec"].get("serviceName")
        must(not service or service in [s["metadata"]["name"] for s in kinds["Service"]],
             f"{name}: the service {service} does not exist")
    for service in kinds["Service"]:
        name, found = service["metadata"]["name"], selected(service["spec"]["selector"])
        must(found, f"service {name}: the selector matches no pod")
        for port, workload in ((p, w) for p in service["spec"]["ports"] for w in found):
            offered = [p["name"] for p in workload["spec"]["template"]["spec"]["containers"][0]["ports"]]
            must(port["targetPort"] in offered, f"service {name}: a pod has no port {port['targetPort']}")
    for budget in kinds.get("PodDisruptionBudget", []):
        found = selected(budget["spec"]["selector"]["matchLabels"])
        must(len(found) == 1,
             f"budget {budget['metadata']['name']}: the selector matches {len(found)} workloads, expected 1")
    policies = kinds.get("NetworkPolicy", [])
    for policy in policies:
        must(selected(policy["spec"]["podSelector"]["matchLabels"]),
             f"policy {policy['metadata']['name']}: the selector matches no pod")
    if policies:
        for workload in workloads:
            labels = workload["spec"]["template"]["metadata"]["labels"]
            at = [p for p in policies if matches(p["spec"]["podSelector"]["matchLabels"], labels)]
            must(len(at) == 1, f"{workload['metadata']['name']} has {len(at)} network policies, expected 1")
    for scaled in kinds.get("ScaledObject", []):
        target = scaled["spec"]["scaleTargetRef"]["name"]
        found = [w for w in kinds["Deployment"] if w["metadata"]["name"] == target]
        must(len(found) == 1, f"the target {target} of a ScaledObject does not exist")
        must("replicas" not in found[0]["spec"], f"{target} has a ScaledObject, so it must not set replicas")
    for monitor in kinds.get("ServiceMonitor", []):
        wanted = monitor["spec"]["selector"]["matchLabels"]
        found = [s for s in kinds["Service"] if matches(wanted, s["metadata"]["labels"])]
        must(len(found) == 1, f"the ServiceMonitor matches {len(found)} services, expected 1")
        ports = [p["name"] for p in found[0]["spec"]["ports"]]
        must(all(e["port"] in ports for e in monitor["spec"]["endpoints"]),
             "the ServiceMonitor uses a port that the service does not have")


def leaves(values, path=()):
    """Yields the paths of all values. Replaces the names of entries of `workers` by NAME."""
    for key, value in values.items():
        here = path + (("NAME",) if path == ("workers",) else (key,))
        plain = not isinstance(value, dict) or not value or here[-1] in ("requests", "limits", "resources",
                                                                         "monitoring")
        if plain:
            yield ".".join(here)
        else:
            yield from leaves(value, here)


def check_table(chart, readme):
    """Checks that the table of README.md contains exactly the values of the chart."""
    told = set(re.findall(r"^\| `([A-Za-z.]+)` \|", readme, re.MULTILINE))
    there = set(leaves(chart.values))
    must(told == there,
         f"the table of README.md: add rows for {there - told}, and remove the rows of {told - there}")


def check_version(chart):
    """Checks that the chart has the version of the program."""
    cargo = (HERE / "../../Cargo.toml").read_text()
    version = re.search(r'^version = "(.+)"', cargo, re.MULTILINE).group(1)
    of_chart = chart.metadata["appVersion"]
    must(of_chart == version,
         f"the appVersion of the chart is {of_chart}, and the program has version {version}")


def render(chart, values):
    """Returns the resources that the chart renders, and checks the notes, the names and the namespaces."""
    rendered = chart.render(values, name="farm", namespace="studio", is_install=True)
    documents = []
    for path, text in rendered.items():
        if path.endswith("NOTES.txt"):
            must("answers at" in text, "NOTES.txt does not contain the address of the farm")
            continue
        documents += [d for d in yaml.safe_load_all(text) if d]
    names = [(d["kind"], d["metadata"]["name"]) for d in documents]
    must(len(names) == len(set(names)), f"two resources have the same kind and name: {names}")
    for document in documents:
        must(document["metadata"]["namespace"] == "studio",
             f"{document['metadata']['name']} does not have the namespace of the release")
    return documents


def main(folder):
    folder = pathlib.Path(folder)
    count = 0
    with helm.Chart.load(folder) as chart:
        check_version(chart)
        check_table(chart, (folder / "README.md").read_text())
        for path in sorted((folder / "ci").glob("*.yaml")):
            values = yaml.safe_load(path.read_text()) or {}
            try:
                report = helm.lint(folder, values, strict=True, kube_version=f"v{VERSIONS[0]}.0")
                bad = [m for m in report["messages"] if m["severity"] > 1] + report["errors"]
                must(not bad, f"helm lint: {bad}")
                documents = render(chart, values)
                for document in documents:
                    name = f"{document['kind']} {document['metadata']['name']}"
                    try:
                        check_schema(document)
                    except (jsonschema.ValidationError, kubernetes_validate.SchemaNotFoundError) as e:
                        at = "/".join(str(part) for part in getattr(e, "absolute_path", []))
                        raise Wrong(f"{name}: {at}: {e.message}") from e
                check_together(documents)
            except Wrong as e:
                raise Wrong(f"with {path.name}: {e}") from e
            count += len(documents)
            print(f"chart: {path.name}: {len(documents)} resources")
        for values, name in REFUSED:
            try:
                chart.render(values, name="farm", namespace="studio")
            except helm.HelmError as e:
                must(name in str(e),
                     f"the chart rejects {values}, but the error does not contain {name}: {e}")
            else:
                raise Wrong(f"the chart accepts the invalid values {values}")
    print(f"chart: {count} resources are valid for Kubernetes {VERSIONS[0]} and {VERSIONS[1]}; the chart "
          f"rejects {len(REFUSED)} invalid values")


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except Wrong as wrong:
        sys.exit(f"chart: {wrong}")
