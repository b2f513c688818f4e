//! Tests with the MuJoCo library. Without it, they say so and pass, unless OPSPACE_MUJOCO names one.

mod common;
mod dynamics;
mod plant;
mod runs;
mod scenes;
