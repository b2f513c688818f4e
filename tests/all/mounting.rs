//! Arms on walls, ceilings and slopes: `[mount]` of robot.toml.

use crate::common::{Run, experiment, osc, run, torque};
use nalgebra::Vector3;
use opspace_experiment::{
    Experiment, Extensions, Files, RobotDefinition, RunOptions, Source, TaskDefinition,
};
use opspace_loop::RunOutcome;
use opspace_model::Placement;
use std::path::Path;

/// Mounting of a test.
#[derive(Clone, Copy, Debug)]
struct Mount {
    xyz_m: [f64; 3],
    rpy_rad: [f64; 3],
}

/// Settings of the asimo arm with this mounting.
fn mounted(mount: &Mount, settings: &[&str]) -> RobotDefinition {
    let mount = format!("robot.mount={{ xyz_m = {:?}, rpy_rad = {:?} }}", mount.xyz_m, mount.rpy_rad);
    crate::common::robot(&[&[mount.as_str()], settings].concat())
}

#[test]
fn list() {
    let task = crate::common::task("press-wall", &["duration_s=1.0", "settle_s=0.1"]);
    let e = experiment(crate::common::robot(&[]), task, osc("a-med"));
    let r = run(&e);
    for c in &r.recording.channels {
        for s in &c.layout.signals {
            println!("{} {} {:?} {:?}", c.layout.channel, s.name, s.elements, s.units);
        }
    }
    let _ = mounted(&Mount { xyz_m: [0.0; 3], rpy_rad: [0.0; 3] }, &[]);
}
