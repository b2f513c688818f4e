//! The whole of opspace: experiments, the command line, logs, robots and suites.

mod acceptance;
mod allocation;
mod cli;
mod cli_common;
mod common;
#[path = "../../crates/opspace-log/tests/all/counting/mod.rs"]
mod counting;
mod dropout;
mod exactness;
mod experiments;
mod files;
mod identification;
mod identified;
mod model_samples;
mod replay;
mod report_browser;
mod robots;
mod safety;
