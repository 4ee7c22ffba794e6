"""Breaks a farm of real processes in every way that a seed draws, and checks that nothing came of it.

`scripts/chaos.sh --help` says how to run it, docs/chaos.md what it injects and checks.
"""
