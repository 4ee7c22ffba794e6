"""Renders the chart with Helm's own library and checks what comes out, without a cluster.

Every set of values in ci/ is rendered. What is rendered must be valid by the schemas of the oldest and the newest
Kubernetes, meet the Pod Security Standard `restricted`, and fit together: selectors, ports, volumes, policies.

    python charts.py CHART
"""

import json
import pathlib
import re
import sys

import helm_python as helm
import jsonschema
import kubernetes_validate
import yaml

# The chart's kubeVersion, and the newest one that kubernetes-validate has schemas of.
VERSIONS = ("1.27", "1.37")
HERE = pathlib.Path(__file__).parent
# Values that must be refused, and what the refusal must name.
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
    """What does not hold."""


def must(holds, what):
    if not holds:
        raise Wrong(what)


def closed(schema):
    """The schema of a resource of others, refusing fields that it does not name."""
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
    """The schemas of crds/, by group and kind."""
    for path in sorted((HERE / "crds").glob("*.json")):
        kind, group, version = path.stem.split("-")
        schema = json.loads(path.read_text())
        schema["properties"]["metadata"] = {"type": "object", "x-kubernetes-preserve-unknown-fields": True}
        yield (kind, group, version), closed(schema)


OTHERS = dict(of_others())


def check_schema(document):
    group, _, version = document["apiVersion"].rpartition("/")
    schema = OTHERS.get((document["kind"].lower(), group.split(".")[0], version))
    if schema is not None:
        jsonschema.Draft202012Validator(schema).validate(document)
        return
    for version in VERSIONS:
        kubernetes_validate.validate(document, version, strict=True)


def check_pod(name, spec, labels):
    """The Pod Security Standard `restricted`, and that volumes and ports which are named exist."""
    pod = spec["securityContext"]
    must(pod["runAsNonRoot"] is True and pod["runAsUser"] > 0, f"{name} may run as root")
    must(pod["seccompProfile"]["type"] == "RuntimeDefault", f"{name} has no seccomp profile")
    must(spec["automountServiceAccountToken"] is False, f"{name} has a token of the cluster")
    for field in ("hostNetwork", "hostPID", "hostIPC"):
        must(not spec.get(field), f"{name} uses {field}")
    volumes = {v["name"]: v for v in spec.get("volumes", [])}
    for volume in volumes.values():
        must(set(volume) - {"name"} <= {"emptyDir", "secret", "configMap"}, f"{name}: volume {volume}")
    for container in spec["containers"]:
        security = container["securityContext"]
        must(security["allowPrivilegeEscalation"] is False, f"{name} may gain privileges")
        must(security["readOnlyRootFilesystem"] is True, f"{name} can write its root file system")
        must(security["capabilities"] == {"drop": ["ALL"]}, f"{name} has capabilities")
        must(container["resources"]["limits"].get("memory"), f"{name} has no limit of memory")
        mounts = {m["name"] for m in container.get("volumeMounts", [])}
        must(mounts <= set(volumes) | claims(labels), f"{name}: {mounts} are not all volumes")
        must(set(volumes) <= mounts, f"{name}: {set(volumes)} are not all mounted")
        ports = {p["name"]: p["containerPort"] for p in container["ports"]}
        for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
            asked = container[probe]
            port = asked["httpGet"]["port"] if "httpGet" in asked else asked["grpc"]["port"]
            must(port in ports or port in ports.values(), f"{name}: {probe} asks port {port}")
        known = {e["name"] for e in container.get("env", [])}
        for text in container["args"]:
            must(set(re.findall(r"\$\((\w+)\)", text)) <= known, f"{name}: {text} names no variable")


def claims(workload):
    return {c["metadata"]["name"] for c in workload["spec"].get("volumeClaimTemplates", [])}


def matches(selector, labels):
    return selector.items() <= labels.items()


def check_together(documents):
    kinds = {}
    for document in documents:
        kinds.setdefault(document["kind"], []).append(document)
    workloads = kinds.get("Deployment", []) + kinds.get("StatefulSet", [])
    must(workloads, "there are no pods")

    def selected(selector):
        return [w for w in workloads if matches(selector, w["spec"]["template"]["metadata"]["labels"])]

    for workload in workloads:
        name, template = workload["metadata"]["name"], workload["spec"]["template"]
        check_pod(name, template["spec"], workload)
        own = selected(workload["spec"]["selector"]["matchLabels"])
        must(own == [workload], f"{name} selects other pods than its own")
        service = workload["spec"].get("serviceName")
        must(not service or service in [s["metadata"]["name"] for s in kinds["Service"]], f"{name}: {service}")
    for service in kinds["Service"]:
        name, found = service["metadata"]["name"], selected(service["spec"]["selector"])
        must(found, f"service {name} selects no pod")
        for port, workload in ((p, w) for p in service["spec"]["ports"] for w in found):
            offered = [p["name"] for p in workload["spec"]["template"]["spec"]["containers"][0]["ports"]]
            must(port["targetPort"] in offered, f"service {name}: no port {port['targetPort']} at a pod")
    for budget in kinds.get("PodDisruptionBudget", []):
        found = selected(budget["spec"]["selector"]["matchLabels"])
        must(len(found) == 1, f"budget {budget['metadata']['name']} is for {len(found)} workloads")
    policies = kinds.get("NetworkPolicy", [])
    for policy in policies:
        must(selected(policy["spec"]["podSelector"]["matchLabels"]), f"policy {policy['metadata']['name']}: no pod")
    if policies:
        for workload in workloads:
            labels = workload["spec"]["template"]["metadata"]["labels"]
            at = [p for p in policies if matches(p["spec"]["podSelector"]["matchLabels"], labels)]
            must(len(at) == 1, f"{workload['metadata']['name']} has {len(at)} network policies")
    for scaled in kinds.get("ScaledObject", []):
        target = scaled["spec"]["scaleTargetRef"]["name"]
        found = [w for w in kinds["Deployment"] if w["metadata"]["name"] == target]
        must(len(found) == 1, f"{target} is scaled and is not there")
        must("replicas" not in found[0]["spec"], f"{target} is scaled and has a fixed number as well")
    for monitor in kinds.get("ServiceMonitor", []):
        wanted = monitor["spec"]["selector"]["matchLabels"]
        found = [s for s in kinds["Service"] if matches(wanted, s["metadata"]["labels"])]
        must(len(found) == 1, "the ServiceMonitor is for one service")
        ports = [p["name"] for p in found[0]["spec"]["ports"]]
        must(all(e["port"] in ports for e in monitor["spec"]["endpoints"]), "a port of the ServiceMonitor")


def leaves(values, path=()):
    """The paths of all values; entries of `workers` are one."""
    for key, value in values.items():
        here = path + (("NAME",) if path == ("workers",) else (key,))
        plain = not isinstance(value, dict) or not value or here[-1] in ("requests", "limits", "resources", "monitoring")
        if plain:
            yield ".".join(here)
        else:
            yield from leaves(value, here)


def check_table(chart, readme):
    """README.md explains every value, and no other."""
    told = set(re.findall(r"^\| `([A-Za-z.]+)` \|", readme, re.MULTILINE))
    there = set(leaves(chart.values))
    must(told == there, f"the table of README.md lacks {there - told}, and has {told - there}, which are no values")


def check_version(chart):
    """The chart is of the program beside it."""
    cargo = (HERE / "../../Cargo.toml").read_text()
    version = re.search(r'^version = "(.+)"', cargo, re.MULTILINE).group(1)
    of_chart = chart.metadata["appVersion"]
    must(of_chart == version, f"appVersion is {of_chart}, and the program {version}")


def render(chart, values):
    rendered = chart.render(values, name="farm", namespace="studio", is_install=True)
    documents = []
    for path, text in rendered.items():
        if path.endswith("NOTES.txt"):
            must("answers at" in text, "NOTES.txt says nothing")
            continue
        documents += [d for d in yaml.safe_load_all(text) if d]
    names = [(d["kind"], d["metadata"]["name"]) for d in documents]
    must(len(names) == len(set(names)), f"two of one name: {names}")
    for document in documents:
        must(document["metadata"]["namespace"] == "studio", f"{document['metadata']['name']} is in no namespace")
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
                must(not bad, f"lint: {bad}")
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
                must(name in str(e), f"{values} is refused for another reason: {e}")
            else:
                raise Wrong(f"{values} is not refused")
    print(f"chart: {count} resources are valid for Kubernetes {VERSIONS[0]} and {VERSIONS[1]}; {len(REFUSED)} bad values are refused")


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except Wrong as wrong:
        sys.exit(f"chart: {wrong}")
