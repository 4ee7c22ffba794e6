//! sightline.v1.
