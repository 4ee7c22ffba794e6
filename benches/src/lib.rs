//! Programs that measure the result format and the cost of blocks; each program in `src/bin/` answers one
//! question.
