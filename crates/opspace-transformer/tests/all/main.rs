//! Servo laws and transformers on joints of known numbers.

mod closed_loop;
mod emulation;

mod servos;
mod transformer;
mod velocity_stability;
