//! Commands that run and maintain a farm.

pub mod coordinator;
pub mod health;
pub mod invalidate;
pub mod replica;
pub mod store;
pub mod store_location;
pub mod store_migrate;
pub mod token;
pub mod worker;
pub mod workers;
