//! Programs that measure the result format; each program in `src/bin/` answers one question.
