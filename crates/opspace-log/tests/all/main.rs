//! Recording, reading and repair of logs.

mod common;
mod counting;
mod damage;
mod recorder;
mod round_trip;
