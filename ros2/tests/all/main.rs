//! Tests without topics: joint states, wrenches, commands, targets and settings. Those with topics are in `judge.py`.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

mod arm;
mod clutch;
mod commands;
mod common;
mod config;
mod faults;
mod following;
mod frames;
mod inputs;
mod pace;
mod states;
mod wrenches;
