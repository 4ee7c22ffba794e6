"""The numbers of a farm's nodes. The number of a node is also the last byte of its address."""

from __future__ import annotations

COORDINATOR = 1
# The number of the first worker. In a farm with a liar, the first worker is the liar.
FIRST_WORKER = 2
CLIENT = 100
# The nodes of a farm with a database: the second coordinator, the database, and the balancer of both
# coordinators.
SECOND = 101
DATABASE = 102
BALANCER = 103
# The object store of a farm with a bucket.
BUCKET = 104
