//! Nothing here: what needs several processes or containers is in `tests/`, one file a subject.
