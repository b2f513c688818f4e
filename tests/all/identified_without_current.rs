//! Control by torques without motor current, with servo gains that were identified without it.

use crate::cli_common::{opspace, project, scratch};
use serde_json::Value;

/// Largest torque error of interval means: that of gravity compensation, to which the damping that identified gains leave adds five
/// hundredths.
const LARGEST: f64 = 0.12;

/// Checks the torque errors of three tasks on an arm without motor current, whose kp is not the nominal one, after an
/// identification without contact: no run is stopped.
#[test]
#[ignore = "takes minutes: .ci/run acceptance"]
fn wrong_kp_is_identified_and_controlled_without_current() {
    let without_current = "robot.interface.measured=[\"position\"]";
    for wrong in ["0.9", "1.1"] {
        let scratch = scratch();
        let kp = format!("robot.simulated.true_over_nominal.kp={wrong}");
        let robot = project("robots/asimo-arm");
        let how = ["identify", &robot, "--set", without_current, "--set", &kp, "--out", "identified"];
        opspace(scratch.path(), &how).exits(0);
        for task in ["cartesian-tracking", "gravity-compensation", "compliant-x"] {
            for transformer in ["extrapolation", "emulation"] {
                let task = project(&format!("tasks/{task}.toml"));
                let how =
                    ["run", &task, "--robot", "identified", "--transformer", transformer, "--json", "-"];
                let out = format!("{transformer}-out");
                let summary = opspace(scratch.path(), &[&how[..], &["--out", &out, "--force"]].concat())
                    .exits(0)
                    .json();
                assert_eq!(summary["faulted"], Value::Null);
                let error = summary["metrics"]["torque_error_interval"].as_f64().expect("a number");
                assert!(error <= LARGEST, "kp {wrong}, {task}, {transformer}: {error}");
            }
        }
    }
}
