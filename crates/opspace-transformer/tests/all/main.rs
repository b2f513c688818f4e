//! Servo laws and transformers on joints of known numbers.

mod emulation;
mod identified;
mod servos;
mod transformer;
mod velocity_stability;
