"""Who takes part in a farm, by numbers, which are also the last bytes of their addresses."""

from __future__ import annotations

COORDINATOR = 1
# Workers are numbered from here; in a farm with a liar it is the first of them.
FIRST_WORKER = 2
CLIENT = 100
# The other coordinator of a farm with a database, the database, and the balancer before both coordinators.
SECOND = 101
DATABASE = 102
BALANCER = 103
# The object store of a farm whose blobs are in a bucket.
BUCKET = 104
