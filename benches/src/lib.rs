//! Programs that measure the result format and the cost of blocks. Each program in `src/bin/` answers one
//! question.
