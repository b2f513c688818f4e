//! Runs in which transformer, servo and gears oscillate, and the time after which the watchdog stops the arm.

use crate::coupled_common::project;
use opspace_backend::CommandKind;
use opspace_backend::signal_names::{MOTOR_TORQUE, TORQUE_DESIRED};
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_log::Recording;
use opspace_loop::Fault;
use opspace_loop::run::RunOutcome;
use std::io::Cursor;

const ASIMO_GEARS: &str = "robot.simulated.gear={ \
    shoulder_pitch = { stiffness_nm_per_rad = 20000.0, damping_nms_per_rad = 5.0 }, \
    shoulder_roll = { stiffness_nm_per_rad = 12000.0, damping_nms_per_rad = 3.0 }, \
    shoulder_yaw = { stiffness_nm_per_rad = 8000.0, damping_nms_per_rad = 2.0 }, \
    elbow = { stiffness_nm_per_rad = 5000.0, damping_nms_per_rad = 1.2 } }";

const UR5E_GEARS: &str = "robot.simulated.gear={ \
    base = { stiffness_nm_per_rad = 20000.0, damping_nms_per_rad = 5.0 }, \
    shoulder = { stiffness_nm_per_rad = 15000.0, damping_nms_per_rad = 3.8 }, \
    elbow = { stiffness_nm_per_rad = 12000.0, damping_nms_per_rad = 3.0 }, \
    wrist_1 = { stiffness_nm_per_rad = 8000.0, damping_nms_per_rad = 2.0 }, \
    wrist_2 = { stiffness_nm_per_rad = 6000.0, damping_nms_per_rad = 1.5 }, \
    wrist_3 = { stiffness_nm_per_rad = 5000.0, damping_nms_per_rad = 1.2 } }";

/// Interface with a delay of a whole cycle, on elastic gears.
struct Interface {
    task: &'static str,
    profile: &'static str,
    gears: &'static str,
    servo_ticks_per_cycle: u32,
}

/// Interfaces of 125, 250 and 125 Hz.
const INTERFACES: [Interface; 3] = [
    Interface { task: "compliant-x", profile: "a-med", gears: ASIMO_GEARS, servo_ticks_per_cycle: 40 },
    Interface { task: "ur5e-compliant", profile: "rtde-500hz", gears: UR5E_GEARS, servo_ticks_per_cycle: 10 },
    Interface { task: "ur5e-tracking", profile: "rtde-500hz", gears: UR5E_GEARS, servo_ticks_per_cycle: 20 },
];

/// Bound on the rms as a fraction of the torque limit, by default.
const SHARE: f64 = 0.15;
/// Time within which an oscillation must stop the arm, s.
const MOST_S: f64 = 0.5;
/// Duration of the windows in which an oscillation begins, s: a period at 15 Hz.
const WINDOW_S: f64 = 1.0 / 15.0;

impl Interface {
    fn experiment(&self, share: f64) -> Experiment {
        let (profile, ticks) = (self.profile, self.servo_ticks_per_cycle);
        let settings = [
            "expect={}".to_owned(),
            "robot.interface.gears=\"elastic\"".to_owned(),
            self.gears.to_owned(),
            format!("robot.profile.{profile}.servo_ticks_per_cycle={ticks}"),
            format!("robot.profile.{profile}.delay_servo_ticks={ticks}"),
            format!("robot.safety.watchdog.torque_oscillation_share={share}"),
        ];
        let options = RunOptions {
            backend: CommandKind::Position,
            profile: Some(profile.to_owned()),
            ..RunOptions::default()
        };
        let path = project(&format!("tasks/{}.toml", self.task));
        Experiment::load(Files::Disk, &path, None, options, &settings)
            .unwrap_or_else(|error| panic!("{error}"))
    }
}

fn run(experiment: &Experiment) -> (RunOutcome, Recording) {
    let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a run");
    (finished.outcome, Recording::from_bytes(finished.sink.get_ref()).expect("a log"))
}

/// Time at which a joint begins to oscillate, s: the end of the first window in which the standard deviation of its torque deviation
/// exceeds the bound, if it does so in the following windows, too.
fn begins_s(experiment: &Experiment, log: &Recording) -> f64 {
    let tick = log.tick().expect("rows");
    let motor = tick.signal(MOTOR_TORQUE).expect("measured");
    let desired = tick.signal(TORQUE_DESIRED).expect("desired torques");
    let period_s = tick.time_s[1] - tick.time_s[0];
    let window = (WINDOW_S / period_s).round() as usize;
    let begins =
        experiment.robot().torque_limits().into_iter().enumerate().filter_map(|(i, torque_limit)| {
            let limit = SHARE * torque_limit;
            let deviations: Vec<f64> =
                (1..tick.len()).map(|k| motor.row(k)[i] - desired.row(k - 1)[i]).collect();
            let exceeds: Vec<bool> = deviations
                .chunks_exact(window)
                .map(|e| {
                    let mean = e.iter().sum::<f64>() / window as f64;
                    let variance = e.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / window as f64;
                    variance.sqrt() > limit
                })
                .collect();
            let first = exceeds.windows(4).position(|four| four.iter().all(|is| *is))?;
            Some(tick.time_s[(first + 1) * window])
        });
    begins.reduce(f64::min).expect("a joint that oscillates")
}

/// Compared: the time of the stop, and that at which the oscillation begins in the same run without the watchdog, which ends as
/// planned.
#[test]
fn oscillation_is_stopped_within_half_a_second() {
    for interface in INTERFACES {
        let unwatched = interface.experiment(100.0);
        let (outcome, log) = run(&unwatched);
        assert_eq!(outcome, RunOutcome::Completed, "{}", interface.task);
        let begins_s = begins_s(&unwatched, &log);
        let (outcome, _) = run(&interface.experiment(SHARE));
        let RunOutcome::Faulted { fault: Fault::TorqueOscillation { rms, limit, .. }, time_s } = outcome
        else {
            panic!("{}: {outcome:?}", interface.task)
        };
        assert!(rms > limit, "{}: {rms} of {limit} Nm", interface.task);
        assert!(time_s - begins_s <= MOST_S, "{}: from {begins_s} to {time_s} s", interface.task);
    }
}
