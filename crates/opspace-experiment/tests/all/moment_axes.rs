//! A moment axis on an arm with friction, servos and sensor noise.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_log::Recording;
use std::io::Cursor;
use std::path::Path;

/// Target moment, Nm.
const TARGET_NM: f64 = -2.0;

/// The Panda turns about x until a lever of 0.1 m presses on the table with the target moment.
#[test]
fn moment_axis_settles_on_stiff_tables() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/panda-press.toml");
    for (backend, stiffness) in [(CommandKind::Position, 50_000.0), (CommandKind::Torque, 10_000.0)] {
        let settings = [
            "task.flange.cartesian.axes.z=motion".to_owned(),
            "task.flange.cartesian.axes.rx=force".to_owned(),
            format!("task.flange.cartesian.force={{ sensor = \"wrist\", target_nm = {{ rx = {TARGET_NM:?} }} }}"),
            "task.flange.cartesian.reference=hold".to_owned(),
            format!("environment.table.wall.stiffness_n_per_m={stiffness:?}"),
            "environment.table.wall.frame=lever".to_owned(),
            "robot.tool.lever={ on=\"flange\", xyz_m=[0.0, 0.1, 0.0], mass_kg=0.1, com_m=[0.0, 0.05, 0.0] }"
                .to_owned(),
            "robot.force_sensor.wrist.frame=flange".to_owned(),
            "robot.simulated.force_sensor.wrist={ bandwidth_hz=500.0, noise_n=0.05, noise_nm=0.005, bias_n=2.0, bias_nm=0.1 }"
                .to_owned(),
        ];
        let options = RunOptions { backend, duration_s: Some(6.0), ..RunOptions::default() };
        let experiment = Experiment::load(Files::Disk, &path, None, options, &settings).unwrap();
        let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
        let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
        let tick = recording.channel("tick").unwrap();
        let sensed = tick.signal("flange.sensed_force").unwrap();
        let from_s = tick.time_s[0] + 4.0;
        let errors: Vec<f64> = (0..tick.len())
            .filter(|&k| tick.time_s[k] >= from_s)
            .map(|k| (sensed.row(k)[3] - TARGET_NM).powi(2))
            .collect();
        let rms = (errors.iter().sum::<f64>() / errors.len() as f64).sqrt();
        assert!(rms < 0.1, "{rms} Nm");
    }
}
