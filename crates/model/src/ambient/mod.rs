//! Ambient occlusion: the receivers that a job asks about, and the openness that is the answer.

pub mod openness;
pub mod receivers;
