//! Runs that a client pulls by hand: their logs are replayed and simulated again, bit for bit.

use crate::client::Client;
use opspace_backend::{Backend, CommandKind};
use opspace_experiment::run::replay::replay;
use opspace_experiment::{Experiment, Files, Progress, RunOptions, Scenario};
use opspace_live::{LiveRun, LiveView, ViewKind};
use opspace_log::{LogFile, Recording, compare_logs};
use opspace_sim::{SimulatedArm, external};
use serde_json::{Value, json};
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

/// Time for which the hand may act after its page is lost, s: 50 ms, and a step of 50 Hz.
const RELEASED_S: f64 = 0.07;

fn experiment(backend: CommandKind, duration_s: f64) -> Experiment {
    let options = RunOptions { backend, duration_s: Some(duration_s), ..RunOptions::default() };
    let task = Path::new("tasks/compliant-x.toml");
    let settings = ["settle_s=0.1".to_owned(), "environment={}".to_owned()];
    Experiment::load(Files::Embedded, task, None, options, &settings).unwrap()
}

fn view() -> LiveView {
    LiveView::start("127.0.0.1:0".parse().unwrap(), "test", ViewKind::Run).unwrap()
}

/// Runs an experiment in a view, while `act` is the client, and returns its log.
fn run_in(view: &LiveView, experiment: &Experiment, act: impl FnOnce(Client) + Send) -> Vec<u8> {
    let scenario = Scenario::from(experiment.clone());
    let progress = Progress::default();
    let mut arms: Vec<SimulatedArm> = scenario.pushable_arms().unwrap();
    let mut live = LiveRun::new(view, &scenario, Some(&arms), Arc::clone(&progress.interrupt));
    let address = view.address().socket;
    thread::scope(|scope| {
        let acting = scope.spawn(move || act(Client::connect(address)));
        let mut robots: Vec<&mut dyn Backend> = arms.iter_mut().map(|arm| arm as &mut dyn Backend).collect();
        let driven = scenario.drive_robots_with(
            &mut robots,
            &progress,
            &mut live,
            |_, capabilities, truth, receivers| {
                experiment.open_with(capabilities, truth, Cursor::new(Vec::new()), &progress, receivers)
            },
        );
        let (log, outcome) = driven.unwrap().remove(0);
        acting.join().unwrap();
        log.close(experiment, outcome).unwrap().sink.into_inner()
    })
}

fn hold(target_m: [f64; 3]) -> Value {
    json!({ "frame": "hand", "point_m": [0.0, 0.01, 0.02], "target_m": target_m, "stiffness_n_per_m": 300 })
}

/// Forces of the rows of a log, with their times.
fn forces(experiment: &Experiment, log: &Recording) -> Vec<(f64, bool)> {
    let rows = log.channel("external").unwrap();
    let model = &experiment.robot().model;
    (0..rows.len()).map(|k| (rows.time_s[k], external::decode(rows.row(k), model).is_some())).collect()
}

/// Pulls the hand for `count` messages.
fn pull(client: &mut Client, count: u32, amplitude_m: f64) {
    client.read_until(|client| {
        client.view()["robots"][0]["can_push"] == true && client.last.contains_key("/tf")
    });
    for step in 0..count {
        let x = 0.365 + amplitude_m * (0.2 * f64::from(step)).sin();
        client.hand(&hold([x, -0.04, -0.157]));
        client.read();
        thread::sleep(Duration::from_millis(4));
    }
}

/// Compared: every signal of ten pushed runs, and of their replays; every message, and those of simulations of their logs.
#[test]
fn pushed_runs_are_replayed_and_simulated_again() {
    let view = view();
    view.play();
    for number in 0..10 {
        let backend = if number % 2 == 0 { CommandKind::Torque } else { CommandKind::Position };
        let experiment = experiment(backend, 0.6);
        let bytes = run_in(&view, &experiment, |mut client| {
            client.control(&json!({ "op": "speed", "value": 0.8 }));
            pull(&mut client, 60, 0.05 + 0.01 * f64::from(number));
            client.hand(&json!({ "release": true }));
            thread::sleep(Duration::from_millis(10));
        });
        let log = Recording::from_bytes(&bytes).unwrap();
        assert!(forces(&experiment, &log).iter().filter(|(_, is_held)| *is_held).count() > 20);
        let of_log = Experiment::of_log(&log).unwrap();
        let report = replay(&of_log, &log).unwrap();
        assert_eq!((report.differing, report.compared), (0, report.logged));
        let again = of_log.repeat(&log, Cursor::new(Vec::new()), &Progress::default()).unwrap();
        let logs = [bytes, again.sink.into_inner()].map(|bytes| LogFile::from_bytes(bytes).unwrap());
        let comparison = compare_logs(&logs[0], &logs[1]).unwrap();
        assert!(!comparison.differs(), "{:?}", comparison.parts);
    }
}

/// A page that is lost, and one that falls silent, let go.
#[test]
fn lost_page_releases_the_hand() {
    for is_lost in [true, false] {
        let view = view();
        let experiment = experiment(CommandKind::Torque, 1.5);
        let (sender, receiver) = std::sync::mpsc::channel();
        let bytes = run_in(&view, &experiment, |mut client| {
            pull(&mut client, 40, 0.05);
            // The page knows the time of its last picture.
            sender.send(client.view()["time_s"].as_f64().unwrap()).unwrap();
            if is_lost {
                drop(client);
            } else {
                thread::sleep(Duration::from_millis(300));
            }
        });
        let log = Recording::from_bytes(&bytes).unwrap();
        let rows = forces(&experiment, &log);
        let last_s =
            rows.iter().filter(|(_, is_held)| *is_held).map(|(time_s, _)| *time_s).fold(0.0, f64::max);
        let (seen_s, end_s) = (receiver.recv().unwrap(), rows.last().unwrap().0);
        assert!(last_s > 0.05 && last_s < end_s - 0.2, "{last_s} of {end_s}");
        // The state is published 20 times in a second.
        assert!(last_s < seen_s + RELEASED_S + 0.6, "{last_s} after {seen_s}");
    }
}

/// Pause, steps and a restart of a run, and what the page is told of them.
#[test]
fn page_controls_the_run() {
    let view = view();
    let experiment = experiment(CommandKind::Position, 100.0);
    let bytes = run_in(&view, &experiment, |mut client| {
        client.read_until(|client| client.view()["time_s"].as_f64().is_some_and(|time_s| time_s > 0.1));
        let state = client.view();
        assert_eq!(
            (&state["kind"], &state["state"], &state["title"]),
            (&json!("run"), &json!("playing"), &json!("test"))
        );
        assert_eq!(state["robots"][0]["tasks"][0]["gains"], Value::Null);
        assert_eq!(state["robots"][0]["units"]["hand.position.x"], "m");
        client.control(&json!({ "op": "pause" }));
        client.read_until(|client| client.view()["state"] == "paused");
        thread::sleep(Duration::from_millis(100));
        for _ in 0..50 {
            client.read();
        }
        let at_s = client.view()["time_s"].as_f64().unwrap();
        client.control(&json!({ "op": "step" }));
        client.read_until(|client| client.view()["time_s"].as_f64() != Some(at_s));
        assert!(client.view()["time_s"].as_f64().unwrap() < at_s + 0.01);
        client.control(&json!({ "op": "seek", "time_s": 0 }));
        client.control(&json!({ "op": "gains", "task": "hand", "axis": "x", "natural_frequency_rad_per_s": 5, "damping_ratio": 1 }));
        client.read_until(|client| client.warnings.len() == 2);
        client.control(&json!({ "op": "restart" }));
        // Read by the view before the connection ends.
        client.send(0x81, b"no request");
        client.read_until(|client| client.warnings.len() == 3);
    });
    assert!(view.wants_restart());
    let log = Recording::from_bytes(&bytes).unwrap();
    let of_log = Experiment::of_log(&log).unwrap();
    assert_eq!(replay(&of_log, &log).unwrap().differing, 0);
}

/// A robot without a handle, as a real one, is only watched.
#[test]
fn run_without_handles_is_only_watched() {
    let view = view();
    let experiment = experiment(CommandKind::Torque, 0.5);
    let scenario = Scenario::from(experiment.clone());
    let mut arms = scenario.simulated_arms().unwrap();
    let progress = Progress::default();
    let mut live = LiveRun::new(&view, &scenario, None, Arc::clone(&progress.interrupt));
    let mut client = Client::connect(view.address().socket);
    client.read_until(|client| client.view()["robots"][0]["can_push"] == false);
    client.hand(&hold([1.0, 0.0, 0.0]));
    client.control(&json!({ "op": "pause" }));
    client.read_until(|client| client.warnings.len() == 2);
    let mut robots: Vec<&mut dyn Backend> = arms.iter_mut().map(|arm| arm as &mut dyn Backend).collect();
    let driven =
        scenario.drive_robots_with(&mut robots, &progress, &mut live, |_, capabilities, truth, receivers| {
            experiment.open_with(capabilities, truth, Cursor::new(Vec::new()), &progress, receivers)
        });
    let (log, outcome) = driven.unwrap().remove(0);
    let log = Recording::from_bytes(log.close(&experiment, outcome).unwrap().sink.get_ref()).unwrap();
    assert!(log.channel("external").is_none());
}
