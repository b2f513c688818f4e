//! Logs in a view.

use crate::client::Client;
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_live::{LiveView, Pictures, ViewKind, viewed};
use opspace_log::LogFile;
use serde_json::json;
use std::io::Cursor;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

/// A log is played, paused, and shown from any time on; its messages are those of the log.
#[test]
fn log_is_played_and_sought() {
    let options = RunOptions { duration_s: Some(1.5), ..RunOptions::default() };
    let task = Path::new("tasks/compliant-x.toml");
    let experiment =
        Experiment::load(Files::Embedded, task, None, options, &["settle_s=0.1".to_owned()]).unwrap();
    let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let log = LogFile::from_bytes(result.sink.into_inner()).unwrap();
    let view = LiveView::start("127.0.0.1:0".parse().unwrap(), "a log", ViewKind::Log).unwrap();
    view.show(vec![viewed(&experiment, String::new(), "arm", false)], 1.5, true);
    let pictures = Pictures::read(&view, &[log]).unwrap();
    assert!((pictures.end_s() - 1.5).abs() < 0.05);
    let interrupt = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| pictures.play(&view, "completed", &interrupt));
        let mut client = Client::connect(view.address().socket);
        client.read_until(|client| client.view()["state"] == "ended");
        let state = client.view();
        assert_eq!((&state["kind"], &state["outcome"]), (&json!("log"), &json!("completed")));
        let last = client.last["/tf"].clone();
        client.control(&json!({ "op": "seek", "time_s": 0.5 }));
        client.read_until(|client| client.last["/tf"] != last && client.view()["state"] == "paused");
        client.read_until(|client| {
            client.view()["time_s"].as_f64().is_some_and(|time_s| (time_s - 0.5).abs() < 0.03)
        });
        let signals: serde_json::Value = serde_json::from_slice(&client.last["/signals"]).unwrap();
        assert!((signals["time_s"].as_f64().unwrap() - 0.5).abs() < 0.03);
        client.control(&json!({ "op": "speed", "value": 4 }));
        client.control(&json!({ "op": "play" }));
        client.read_until(|client| client.view()["state"] == "ended");
        assert_eq!(client.last["/tf"], last);
        client.control(&json!({ "op": "restart" }));
        client.read_until(|client| client.view()["state"] == "playing");
        interrupt.store(true, Ordering::Relaxed);
    });
}
