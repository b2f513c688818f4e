//! Commands with one arm, and their outcome.

use nalgebra::{DMatrix, DVector, Matrix6xX};
use opspace_experiment::{Files, RobotDefinition};
use opspace_model::{Data, crba, forward_kinematics, frame_jacobian};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Largest distance from the goal at the end, m.
const FINAL_M: f64 = 0.01;

/// Largest distance of the ends of both runs with a payload, m.
const APART_M: f64 = 0.002;

/// Payload over the mass that moves between base and tip.
const PAYLOAD_SHARE: f64 = 0.1;

/// Largest distance from the goal with a payload over weight/stiffness.
const YIELD: f64 = 1.5;

/// Square of the frequency of the first task, (rad/s)².
const FREQUENCY_SQUARED: f64 = 225.0;

/// Longest duration of a command, s.
const MOST_S: &str = "120";

/// Exit code of `timeout` for a program that it has stopped.
const TIMED_OUT: i32 = 124;

/// Program that is judged, and the plant of its runs.
pub struct Judge {
    pub program: PathBuf,
    pub plant: Option<String>,
}

/// Outcome of the commands with an arm.
pub struct Outcome {
    /// Step that failed first, with its words.
    failed: Option<(&'static str, String)>,
    /// Distances from the goal at the end as a position and as a torque robot, m.
    final_m: [f64; 2],
    /// Payload, kg, and the distance by which the task yields to it, m.
    payload: [f64; 2],
    loaded_m: [f64; 2],
}

impl Outcome {
    pub const STEPS: [&'static str; 9] = [
        "new",
        "check",
        "position run",
        "torque run",
        "goal",
        "loaded position run",
        "loaded torque run",
        "loaded runs apart",
        "loaded goal",
    ];

    pub fn failed_at(&self, step: &str) -> bool {
        self.failed.as_ref().is_some_and(|(failed, _)| *failed == step)
    }

    pub fn passed_loaded(&self) -> bool {
        self.failed.is_none()
    }

    /// True if all runs without a payload pass.
    pub fn passed(&self) -> bool {
        self.failed.as_ref().is_none_or(|(step, _)| step.starts_with("loaded"))
    }

    pub fn line(&self, name: &str) -> String {
        let mm = |[position, torque]: [f64; 2]| format!("{:6.2} {:6.2} mm", 1e3 * position, 1e3 * torque);
        let [kg, yields_m] = self.payload;
        let loaded = format!("{} with {kg:.2} kg (yields {:.2} mm)", mm(self.loaded_m), 1e3 * yields_m);
        let failed = self
            .failed
            .as_ref()
            .map_or_else(String::new, |(step, words)| format!("  FAILED {step}: {words}"));
        format!("{name:36} {}  {loaded}{failed}", mm(self.final_m))
    }
}

impl Judge {
    /// Tries an arm in a folder, which is removed before.
    pub fn try_arm(&self, urdf: &Path, folder: &Path) -> Outcome {
        let mut outcome =
            Outcome { failed: None, final_m: [f64::NAN; 2], payload: [f64::NAN; 2], loaded_m: [f64::NAN; 2] };
        outcome.failed = self.steps(urdf, folder, &mut outcome).err();
        outcome
    }

    fn steps(&self, urdf: &Path, folder: &Path, outcome: &mut Outcome) -> Result<(), (&'static str, String)> {
        // What is left from an earlier try must not count.
        drop(fs::remove_dir_all(folder));
        let at = |step: &'static str| move |words: String| (step, words);
        let robot = folder.join("robot");
        let task = robot.join("first-task.toml");
        let text = |path: &Path| path.display().to_string();
        self.run("new", &[&text(&robot), "--urdf", &text(urdf), "--assume"]).map_err(at("new"))?;
        self.run("check", &[&text(&robot), &text(&task)]).map_err(at("check"))?;
        for (i, (backend, step)) in
            [("position", "position run"), ("torque", "torque run")].into_iter().enumerate()
        {
            outcome.final_m[i] =
                self.run_task(&task, &folder.join(backend), backend, &[]).map_err(at(step))?;
        }
        if let Some(far) = outcome.final_m.into_iter().find(|far| *far > FINAL_M) {
            return Err(("goal", format!("{:.1} mm away", 1e3 * far)));
        }
        let (frame, payload) = payload(&robot, &task).map_err(at("loaded position run"))?;
        outcome.payload = payload;
        let [mass_kg, yields_m] = payload;
        let load = format!("robot.simulated.payload.unknown={{ frame = {frame:?}, mass_kg = {mass_kg:?} }}");
        for (i, (backend, step)) in
            [("position", "loaded position run"), ("torque", "loaded torque run")].into_iter().enumerate()
        {
            let out = folder.join(format!("loaded-{backend}"));
            outcome.loaded_m[i] = self.run_task(&task, &out, backend, &["--set", &load]).map_err(at(step))?;
        }
        let [position, torque] = outcome.loaded_m;
        if (position - torque).abs() > APART_M {
            return Err(("loaded runs apart", format!("{:.1} mm", 1e3 * (position - torque).abs())));
        }
        if position.max(torque) > YIELD * yields_m {
            return Err((
                "loaded goal",
                format!("{:.2} times weight/stiffness", position.max(torque) / yields_m),
            ));
        }
        Ok(())
    }

    /// Runs the task, and returns the distance from the goal at the end, m.
    fn run_task(&self, task: &Path, out: &Path, backend: &str, more: &[&str]) -> Result<f64, String> {
        let (task, out_text) = (task.display().to_string(), out.display().to_string());
        let mut arguments = vec![task.as_str(), "--backend", backend, "--out", &out_text, "--quiet"];
        arguments.extend(more);
        if let Some(plant) = &self.plant {
            arguments.extend(["--plant", plant]);
        }
        self.run("run", &arguments)?;
        let summary = fs::read_to_string(out.join("summary.json")).map_err(|error| error.to_string())?;
        let summary: Value = serde_json::from_str(&summary).map_err(|error| error.to_string())?;
        if let Some(fault) = summary["faulted"].as_str() {
            return Err(format!("stopped: {fault}"));
        }
        // A robot whose tip can only be held has no task with a goal.
        Ok(summary["metrics"]["position_final_m"].as_f64().unwrap_or(0.0))
    }

    /// Runs a command of the program. Returns its last words if it fails.
    pub fn run(&self, command: &str, arguments: &[&str]) -> Result<(), String> {
        // What does not end is stopped.
        let mut timed = Command::new("timeout");
        let output = timed.arg(MOST_S).arg(&self.program).arg(command).args(arguments).output();
        let output = output.map_err(|error| format!("{}: {error}", self.program.display()))?;
        if output.status.code() == Some(TIMED_OUT) {
            return Err(format!("does not end in {MOST_S} s"));
        }
        if output.status.success() {
            return Ok(());
        }
        let said =
            String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
        let is_cause =
            |line: &&str| ["error", "STOPPED", "FAILED", "MISSED"].iter().any(|word| line.contains(word));
        let line = said.lines().find(is_cause).or_else(|| said.lines().next()).unwrap_or_default();
        let code = output.status.code().map_or_else(|| "a signal".to_owned(), |code| code.to_string());
        Err(format!("{}, exit code {code}", line.chars().take(150).collect::<String>()))
    }
}

/// Frame of the tip; payload, kg, and the distance by which the first task yields to its weight, m.
fn payload(robot: &Path, task: &Path) -> Result<(String, [f64; 2]), String> {
    let robot = RobotDefinition::load(Files::Disk, robot, &[]).map_err(|error| error.to_string())?;
    let text = fs::read_to_string(task).map_err(|error| error.to_string())?;
    let task: toml::Table = text.parse().map_err(|error: toml::de::Error| error.to_string())?;
    let cartesian = &task.get("task").and_then(|tasks| tasks.get("tip")?.get("cartesian"));
    let Some(cartesian) = cartesian else { return Err("the first task has no tip".to_owned()) };
    let name = cartesian.get("frame").and_then(toml::Value::as_str).ok_or("the tip has no frame")?;
    let axes = cartesian.get("axes").and_then(toml::Value::as_table).ok_or("the tip has no axes")?;
    let model = &robot.model;
    let frame = model.frame_id(name).map_err(|error| error.to_string())?;
    let start = task.get("start_rad").and_then(toml::Value::as_table).ok_or("the task has no start")?;
    let at = |joint: &opspace_model::Joint| start.get(&joint.name).and_then(toml::Value::as_float);
    let q: Vec<f64> = model.joints().iter().map(|joint| at(joint).unwrap_or(0.0)).collect();
    let mut data = Data::new(model);
    forward_kinematics(model, &mut data, &q);
    crba(model, &mut data);
    let mut jacobian = Matrix6xX::zeros(model.n());
    frame_jacobian(model, &data, frame, &mut jacobian);
    let rows: Vec<usize> = ["x", "y", "z", "rx", "ry", "rz"]
        .iter()
        .enumerate()
        .filter_map(|(row, axis)| axes.contains_key(*axis).then_some(row))
        .collect();
    let rows = DMatrix::from(jacobian.select_rows(&rows));
    let mass_matrix = data.mass_matrix.clone().cholesky().ok_or("the mass matrix is singular")?;
    let moving_kg: f64 = model.ancestors(frame).map(|body| model.bodies()[body].inertia.mass).sum();
    let mass_kg = PAYLOAD_SHARE * moving_kg;
    // Static: x = J M⁻¹ Jᵀ F / ω² for the controlled axes, with F projected on them.
    let weight = model.gravity() * mass_kg;
    let mut force = DVector::zeros(6);
    force.rows_mut(0, 3).copy_from(&weight);
    let torque = jacobian.transpose() * force;
    let motion = &rows * mass_matrix.solve(&torque) / FREQUENCY_SQUARED;
    let linear = motion.rows(0, motion.len().min(3)).norm();
    Ok((name.to_owned(), [mass_kg, linear]))
}
