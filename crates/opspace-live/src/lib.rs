//! Live view: running robots in a browser, pushed by hand.
//!
//! A [`LiveView`] serves a page on one port. It gets the messages that the log of a run has for viewers, and sends them by Foxglove's
//! protocol, so that Foxglove can connect too. A [`LiveRun`] is the [`Companion`](opspace_experiment::Companion) of a run: it paces the
//! cycles, and applies what the page asks for as inputs of the run, which its log records.
//!
//! Layers, each of which knows only those before it: [`frames`] and [`http`] (bytes), [`protocol`], [`requests`] and [`session`]
//! (messages), [`hub`] (channels), [`server`] (sockets and threads), [`view`] and [`live_run`] (runs). The first five touch no socket.

#![forbid(unsafe_code)]

mod feed;
pub mod frames;
mod held;
pub mod http;
pub mod hub;
pub mod live_run;
pub mod log_player;
mod meshes;
pub mod protocol;
mod queue;
pub mod requests;
pub mod server;
pub mod session;
mod signals;
pub mod tunable;
pub mod view;

pub use live_run::{LiveRun, viewed};
pub use log_player::Pictures;
pub use view::{LiveView, ViewKind, ViewedRobot};
