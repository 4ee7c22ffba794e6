"""Checks that compose.yaml isolates every service as README.md describes.

    python compose.py compose.yaml [OVERRIDE.yaml…]

An override must not change the isolation of a service.
"""

import pathlib
import re
import sys

import yaml

PROFILES = {"default", "postgres", "monitoring", "gpu"}
# The settings of the isolation, which an override must not contain.
WALLS = {"user", "read_only", "cap_drop", "security_opt", "pids_limit", "mem_limit", "networks", "profiles"}


class Wrong(Exception):
    """The error of a check that fails."""


def must(holds, what):
    """Raises Wrong with a message if a condition is false."""
    if not holds:
        raise Wrong(what)


def check_service(name, service, secrets):
    """Checks the isolation of a service, and that its secrets are defined."""
    must(service.get("read_only") is True, f"{name}: set read_only: true")
    must(service.get("cap_drop") == ["ALL"] and "cap_add" not in service,
         f"{name}: set cap_drop: [ALL], without cap_add")
    must(service.get("security_opt") == ["no-new-privileges:true"],
         f"{name}: set security_opt: [no-new-privileges:true]")
    must(not service.get("privileged"), f"{name}: remove privileged")
    must(re.fullmatch(r"[1-9]\d*:\d+", service.get("user", "")),
         f"{name}: user must be the number of a user other than root, and the number of a group")
    must(service.get("mem_limit") and service.get("pids_limit"), f"{name}: set mem_limit and pids_limit")
    must(service.get("healthcheck"), f"{name}: add a healthcheck")
    must(service.get("profiles") and set(service["profiles"]) <= PROFILES,
         f"{name}: set profiles, from {sorted(PROFILES)}")
    for port in service.get("ports", []):
        must(port.startswith("127.0.0.1:"), f"{name}: publish the port {port} only on 127.0.0.1")
        must("edge" in service["networks"], f"{name}: the published port needs the network edge")
    for variable, value in (service.get("environment") or {}).items():
        secret = re.search(r"PASSWORD|TOKEN|SECRET", variable) and not variable.endswith("FILE")
        must(not secret, f"{name}: the environment contains the secret {variable}={value}")
    for volume in service.get("volumes", []):
        must(not volume.startswith(".") or volume.endswith(":ro"), f"{name}: mount {volume} with :ro")
    must(set(service.get("secrets", [])) <= secrets, f"{name} uses a secret that the file does not define")


def main(path, *overrides):
    path = pathlib.Path(path)
    compose = yaml.safe_load(path.read_text())
    secrets = set(compose["secrets"])
    for name, service in compose["services"].items():
        check_service(name, service, secrets)
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            there = (path.parent / source).exists() if source.startswith(".") else source in compose["volumes"]
            must(there, f"{name}: {source} is neither an existing file nor a volume of the file")
    used = {profile for service in compose["services"].values() for profile in service["profiles"]}
    must(used == PROFILES, f"the services use the profiles {sorted(used)}, expected {sorted(PROFILES)}")
    must(compose["networks"]["cluster"] == {"internal": True}, "the network cluster must be internal")
    for override in overrides:
        changed = yaml.safe_load(pathlib.Path(override).read_text())
        known = secrets | set(changed.get("secrets", {}))
        for name, service in changed["services"].items():
            must(name in compose["services"], f"{override}: compose.yaml does not contain the service {name}")
            must(not WALLS & set(service), f"{override}: {name} must not change {WALLS & set(service)}")
            merged = {**compose["services"][name], **service}
            check_service(f"{override}: {name}", merged, known)
    print(f"compose: {len(compose['services'])} services in {len(PROFILES)} profiles are isolated")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except Wrong as wrong:
        sys.exit(f"compose: {wrong}")
