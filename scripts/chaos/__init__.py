"""The chaos harness: injects faults, drawn from a seed, into a farm of real processes, and checks the
results.

`scripts/chaos.sh --help` explains the options. docs/chaos.md describes the faults and the checks.
"""
