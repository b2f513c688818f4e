//! Tasks that couple a robot with another one over a channel with delay, jitter, loss and reordering: haptic teleoperation, and
//! an object that two arms carry.
//!
//! A [`CoupledTask`] is a task of [`opspace_control`] like one of a user. It sends by its signals and receives by its inputs:
//! [`CouplingKind::packet_signals`] pairs them.
//!
//! Each robot has a *port*: the axes at which it exchanges energy with what the coupling does not contain, which is the hand
//! of the operator at the leader, and the environment or the controlled arm at the follower. Everything between the two ports,
//! which is the channel and the laws that compute forces and references, is the *network*. In the mathematics
//! `force` is the force that the network exerts at the port on what is outside (N, Nm): the energy that leaves the network
//! in a displacement Δx (m, rad) is `force`·Δx. At a force sensor it is the negative of the sensed force on the robot.
//!
//! Vectors have six rows, at most one per axis; rows that are not used are zero. The mathematics knows nothing of tasks,
//! packets in transit or clocks. Derivations: `docs/reference/couplings.md`.
//!
//! | file | contents |
//! |---|---|
//! | `energy_play` | energy that flows into a port and out of it, without noise |
//! | `port_passivity` | bound on the energy that leaves the network, for any channel |
//! | `steady_latency` | latency of the channel without its jitter |
//! | `wave` | wave variables, passive at a constant delay |
//! | `contact_compliance` | compliance of what the partner touches |
//! | `received`, `packet_fields` | the newest packet from the partner; the fields of a packet |
//! | `law`, `teleoperation`, `carry` | the interface of a law, and the two laws |
//! | `coupled`, `coupled_rows`, `coupled_parameters` | the task, its rows and its parameters |

#![forbid(unsafe_code)]

pub(crate) mod carry;
pub mod contact_compliance;
pub mod coupled;
pub mod coupled_parameters;
pub(crate) mod coupled_rows;
pub mod energy_play;
pub(crate) mod error;
pub(crate) mod law;
pub(crate) mod packet_fields;
pub mod port_passivity;
pub mod received;
pub mod steady_latency;
pub(crate) mod teleoperation;
pub mod wave;

pub use contact_compliance::ContactCompliance;
pub use coupled::{CoupledTask, CouplingKind};
pub use coupled_parameters::{
    CarryParameters, CoupledAxis, CoupledParameters, CouplingScale, CouplingSide, Passivity, Reflected,
    TeleoperationParameters,
};
pub use energy_play::EnergyPlay;
pub use port_passivity::{PortPassivity, PortPassivityParameters};
pub use received::{Packet, ReceivedState};
pub use steady_latency::SteadyLatency;
pub use wave::WaveSide;

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
