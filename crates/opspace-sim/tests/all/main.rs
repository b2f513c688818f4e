//! Tests of simulated arms: drives, bus, environment, energy.

mod arm;
mod bus;
mod common;
mod drives;
mod energy;
mod environment;
mod external;
mod ideal;
mod simulation;
mod velocity;
