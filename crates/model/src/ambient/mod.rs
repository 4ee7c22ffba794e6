//! Ambient occlusion: the receivers of a job, and their openness, which is the job's answer.

pub mod openness;
pub mod receivers;
