"""Checks that every service of compose.yaml is closed in as README.md says.

    python compose.py compose.yaml [OVERRIDE.yaml…]

An override may change what a service does, not how it is closed in.
"""

import pathlib
import re
import sys

import yaml

PROFILES = {"default", "postgres", "monitoring", "gpu"}
# What an override may not say again.
WALLS = {"user", "read_only", "cap_drop", "security_opt", "pids_limit", "mem_limit", "networks", "profiles"}


class Wrong(Exception):
    """What does not hold."""


def must(holds, what):
    if not holds:
        raise Wrong(what)


def check_service(name, service, secrets):
    must(service.get("read_only") is True, f"{name} can write its root file system")
    must(service.get("cap_drop") == ["ALL"] and "cap_add" not in service, f"{name} has capabilities")
    must(service.get("security_opt") == ["no-new-privileges:true"], f"{name} may gain privileges")
    must(not service.get("privileged"), f"{name} is privileged")
    must(re.fullmatch(r"[1-9]\d*:\d+", service.get("user", "")), f"{name}: its user is no number")
    must(service.get("mem_limit") and service.get("pids_limit"), f"{name} has no limit of memory or of processes")
    must(service.get("healthcheck"), f"{name} has no health check")
    must(service.get("profiles") and set(service["profiles"]) <= PROFILES, f"{name} is in no profile")
    for port in service.get("ports", []):
        must(port.startswith("127.0.0.1:"), f"{name} publishes {port} beyond this machine")
        must("edge" in service["networks"], f"{name} publishes a port from a network without a way out")
    for variable, value in (service.get("environment") or {}).items():
        secret = re.search(r"PASSWORD|TOKEN|SECRET", variable) and not variable.endswith("FILE")
        must(not secret, f"{name} has {variable}={value} in its environment")
    for volume in service.get("volumes", []):
        must(not volume.startswith(".") or volume.endswith(":ro"), f"{name} can write {volume}")
    must(set(service.get("secrets", [])) <= secrets, f"{name} has a secret that is nowhere")


def main(path, *overrides):
    path = pathlib.Path(path)
    compose = yaml.safe_load(path.read_text())
    secrets = set(compose["secrets"])
    for name, service in compose["services"].items():
        check_service(name, service, secrets)
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            there = (path.parent / source).exists() if source.startswith(".") else source in compose["volumes"]
            must(there, f"{name}: {source} is neither a file nor a volume")
    used = {profile for service in compose["services"].values() for profile in service["profiles"]}
    must(used == PROFILES, f"the profiles are {used}")
    must(compose["networks"]["cluster"] == {"internal": True}, "the workers' network has a way out")
    for override in overrides:
        changed = yaml.safe_load(pathlib.Path(override).read_text())
        known = secrets | set(changed.get("secrets", {}))
        for name, service in changed["services"].items():
            must(name in compose["services"], f"{override}: there is no service {name}")
            must(not WALLS & set(service), f"{override}: {name} changes {WALLS & set(service)}")
            merged = {**compose["services"][name], **service}
            check_service(f"{override}: {name}", merged, known)
    print(f"compose: {len(compose['services'])} services in {len(PROFILES)} profiles are closed in")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except Wrong as wrong:
        sys.exit(f"compose: {wrong}")
