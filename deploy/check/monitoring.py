"""Checks the dashboard and the rules against the table of metrics, as far as promtool does not.

    python monitoring.py MONITORING_FOLDER TABLE.md

Every metric that the dashboard, the rules and the chart name must have a row in the table, which begins with the name. Panels
must not lie on each other, and their queries must be what Prometheus can read.
"""

import itertools
import json
import pathlib
import re
import subprocess
import sys
import tempfile

import yaml

HISTOGRAM = re.compile(r"_(bucket|sum|count)$")
# Variables of Grafana, as it puts them in.
VARIABLES = {"$__rate_interval": "1m"}


class Wrong(Exception):
    """What does not hold."""


def metrics(text):
    return {HISTOGRAM.sub("", name) for name in re.findall(r"\bsightline_[a-z_]+\b", text)}


def queries(dashboard):
    for panel in dashboard["panels"]:
        for target in panel.get("targets", []):
            yield panel["title"], target["expr"]


def check_panels(dashboard):
    ids = [p["id"] for p in dashboard["panels"]]
    if len(ids) != len(set(ids)):
        raise Wrong("two panels of the dashboard have one id")
    for a, b in itertools.combinations(dashboard["panels"], 2):
        p, q = a["gridPos"], b["gridPos"]
        apart = any(p[x] + p[w] <= q[x] or q[x] + q[w] <= p[x] for x, w in (("x", "w"), ("y", "h")))
        if not apart or p["x"] + p["w"] > 24:
            raise Wrong(f"the panels '{a['title']}' and '{b['title']}' lie on each other")


def check_queries(dashboard):
    """Lets promtool read each query, as the expression of a rule."""
    rules = []
    for number, (_, query) in enumerate(queries(dashboard)):
        for variable, value in VARIABLES.items():
            query = query.replace(variable, value)
        rules.append({"record": f"query:{number}", "expr": query})
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        yaml.safe_dump({"groups": [{"name": "dashboard", "rules": rules}]}, file)
        file.flush()
        done = subprocess.run(["promtool", "check", "rules", file.name], capture_output=True, text=True)
        if done.returncode != 0:
            raise Wrong(f"a query of the dashboard cannot be read: {done.stdout}{done.stderr}")
    return len(rules)


def main(folder, table):
    folder = pathlib.Path(folder)
    dashboard = json.loads((folder / "dashboard.json").read_text())
    check_panels(dashboard)
    count = check_queries(dashboard)
    told = set(re.findall(r"^\| `(sightline_[a-z_]+)[`{]", pathlib.Path(table).read_text(), re.MULTILINE))
    shown = metrics(" ".join(query for _, query in queries(dashboard)))
    rules = metrics((folder / "rules.yaml").read_text())
    chart = metrics((folder.parent / "helm/sightline/templates/workers.yaml").read_text())
    if unknown := (shown | rules | chart) - told:
        raise Wrong(f"{table} has no row for {sorted(unknown)}")
    print(f"monitoring: {count} queries of the dashboard, {len(shown)} metrics of it and {len(rules)} of the rules")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except Wrong as wrong:
        sys.exit(f"monitoring: {wrong}")
