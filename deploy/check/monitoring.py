"""Checks the dashboard, the alert rules and the chart against the table of metrics.

    python monitoring.py MONITORING_FOLDER TABLE.md

The table must contain a row for each metric of the dashboard, the rules and the chart. The first cell of a
row contains the name of a metric. Panels of the dashboard must not overlap, and promtool must accept their
queries.
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
# The variables of Grafana in queries, with a value.
VARIABLES = {"$__rate_interval": "1m"}


class Wrong(Exception):
    """The error of a check that fails."""


def metrics(text):
    """Returns the metrics that a text names."""
    return {HISTOGRAM.sub("", name) for name in re.findall(r"\bsightline_[a-z_]+\b", text)}


def queries(dashboard):
    """Yields the title of the panel and the text of each query of the dashboard."""
    for panel in dashboard["panels"]:
        for target in panel.get("targets", []):
            yield panel["title"], target["expr"]


def check_panels(dashboard):
    """Checks that panels have different ids and do not overlap."""
    ids = [p["id"] for p in dashboard["panels"]]
    if len(ids) != len(set(ids)):
        raise Wrong("two panels of the dashboard have the same id")
    for a, b in itertools.combinations(dashboard["panels"], 2):
        p, q = a["gridPos"], b["gridPos"]
        apart = any(p[x] + p[w] <= q[x] or q[x] + q[w] <= p[x] for x, w in (("x", "w"), ("y", "h")))
        if not apart or p["x"] + p["w"] > 24:
            raise Wrong(f"the panels '{a['title']}' and '{b['title']}' overlap, or one is too wide")


def check_queries(dashboard):
    """Checks each query with promtool, as the expression of a rule. Returns the number of queries."""
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
            raise Wrong(f"promtool rejects a query of the dashboard: {done.stdout}{done.stderr}")
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
        raise Wrong(f"add rows to {table} for the metrics {sorted(unknown)}")
    print(f"monitoring: {count} queries with {len(shown)} metrics in the dashboard, and {len(rules)} metrics "
          f"in the rules")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except Wrong as wrong:
        sys.exit(f"monitoring: {wrong}")
