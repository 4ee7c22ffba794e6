//! What the benchmarks share. The programs are in `src/bin/`, one question each.
