//! Tests of servo laws and transformers on joints with known parameters.

mod closed_loop;
mod current;
mod emulation;
mod extrapolation;
mod impedance;
mod momentum_observer;

mod servo_structures;
mod servos;
mod setpoint_governor;
mod setpoint_limits;
mod torque_observer;
mod transformer;
mod velocity_stability;
