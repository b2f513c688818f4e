//! Drivers of devices with limits and force sensors of their own: limits are compared with robot.toml, and readings are in the log.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::signal_names::{self, RAW};
use opspace_backend::{
    Backend, Capabilities, Command, DeviceFault, DeviceLimits, Driver, DriverError, Sample, Settings,
};
use opspace_experiment::{ControllerKind, Experiment, Extensions, Files, Progress, RunOptions};
use opspace_log::Recording;
use std::io::Cursor;
use std::path::Path;

/// Wrench that the sensor reads, N and Nm.
const WRENCH: [f64; 6] = [1.0, -2.0, 3.0, 0.1, -0.2, 0.3];

/// Arm that is at its setpoints at once.
struct Arm {
    capabilities: Capabilities,
    q: Vec<f64>,
    cycles: f64,
}

impl Backend for Arm {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.cycles += 1.0;
        sample.time_s = self.cycles * self.capabilities.period_s;
        sample.q.copy_from_slice(&self.q);
        sample.wrenches.fill(WRENCH);
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        if let Command::Position(q) = command {
            self.q.copy_from_slice(q);
        }
        Ok(())
    }

    fn stop(&mut self) {}
}

/// Driver of the arm, with the limits of its device, at a start position.
struct ArmDriver {
    limits: Vec<DeviceLimits>,
    start: Vec<f64>,
}

impl Driver for ArmDriver {
    fn name(&self) -> &str {
        "limited"
    }

    fn with(&self, settings: &Settings, run: &mut dyn FnMut(&mut dyn Backend)) -> Result<(), DriverError> {
        let capabilities = Capabilities::new(settings.joints.clone(), settings.command, settings.period_s)
            .with_force_sensors(settings.force_sensors.clone())
            .with_joint_limits(self.limits.clone());
        run(&mut Arm { capabilities, q: self.start.clone(), cycles: 0.0 });
        Ok(())
    }
}

fn experiment(settings: &[&str]) -> Experiment {
    let options =
        RunOptions { controller: ControllerKind::Ik, duration_s: Some(1.0), ..RunOptions::default() };
    let own = [
        "robot.driver.name=limited",
        "robot.driver.real_time=off",
        "robot.interface.measured=[\"position\"]",
        "settle_s=0.2",
    ];
    let settings: Vec<String> = own.iter().chain(settings).map(|&setting| setting.to_owned()).collect();
    let task = Path::new("tasks/joint-tracking.toml");
    Experiment::load(Files::Embedded, task, None, options, &settings).unwrap()
}

/// Runs an experiment on the arm with these limits of each joint.
fn run(experiment: &Experiment, limits: Option<DeviceLimits>) -> Result<Recording, String> {
    let start = experiment.arm_config().unwrap().start;
    let limits = limits.map_or(Vec::new(), |limits| vec![limits; start.len()]);
    let extensions = Extensions::default().with_driver(ArmDriver { limits, start });
    let result = experiment.run_on_driver(&extensions, Cursor::new(Vec::new()), &Progress::default());
    let result = result.map_err(|error| match error {
        opspace_experiment::RunError::File(error) => format!("{error}; {}", error.help().unwrap_or_default()),
        other => other.to_string(),
    })?;
    assert_eq!(result.record.fault, None);
    Ok(Recording::from_bytes(&result.sink.into_inner()).unwrap())
}

/// Compared: the limits of a device, and those of robot.toml, above and below.
#[test]
fn limits_above_those_of_the_device_are_refused() {
    let plain = experiment(&[]);
    let of = |change: fn(&mut DeviceLimits)| {
        let mut limits = DeviceLimits::default();
        change(&mut limits);
        run(&plain, Some(limits)).map(|_| ())
    };
    assert_eq!(of(|_| {}), Ok(()));
    assert_eq!(of(|limits| (limits.torque_nm, limits.velocity_rad_per_s) = (Some(1e4), Some(1e3))), Ok(()));
    for (refused, words) in [
        (
            of(|limits| limits.torque_nm = Some(30.0)),
            [
                "torque limit of joint 'shoulder_pitch': robot.toml has 40, the robot itself keeps to 30",
                "write torque_limit_nm = 30.0 in [joint.shoulder_pitch]",
            ],
        ),
        (
            of(|limits| limits.velocity_rad_per_s = Some(0.5)),
            [
                "speed limit of joint 'shoulder_pitch': the URDF has ",
                "write velocity_limit_rad_per_s = 0.5 in [joint.shoulder_pitch]",
            ],
        ),
        (
            of(|limits| limits.setpoint_acceleration_rad_per_s2 = Some(100.0)),
            [
                "robot.toml has none, the robot itself keeps to 100",
                "write acceleration_rad_per_s2 = 100.0 in [profile.",
            ],
        ),
        (of(|limits| limits.torque_nm = Some(f64::NAN)), ["keeps to NaN", "correct the driver"]),
    ] {
        let message = refused.unwrap_err();
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    }
    let limits = DeviceLimits { velocity_rad_per_s: Some(0.5), ..DeviceLimits::default() };
    let joints = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"];
    let written = joints.map(|joint| format!("robot.joint.{joint}.velocity_limit_rad_per_s=0.5"));
    let corrected = experiment(&written.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(run(&corrected, Some(limits)).is_ok());
}

/// Compared: the readings of the sensor that robot.toml declares, in the log of a run to its end, and those of the device.
#[test]
fn readings_of_a_force_sensor_are_in_the_log() {
    let recording = run(&experiment(&[]), None).unwrap();
    let wrench = recording.tick().unwrap().signal(&signal_names::of("wrist", RAW)).unwrap();
    assert!(wrench.len() > 900, "{}", wrench.len());
    assert!(wrench.rows().all(|row| row == WRENCH));
}
