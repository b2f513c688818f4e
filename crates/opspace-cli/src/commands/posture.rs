//! Posture of a robot in `opspace model`: choice of the posture, tables and JSON.

use crate::cli::ModelArgs;
use crate::console::{Exit, Failure, render};
use opspace_control::reach;
use opspace_experiment::evaluate::posture::{Conditioning, PostureReport};
use opspace_experiment::evaluate::table::{Cell, Table};
use opspace_experiment::postures::own_body::OwnBody;
use opspace_experiment::postures::posture_at::{PostureAt, posture_at};
use opspace_experiment::postures::tip::tip;
use opspace_experiment::suggest::nearest;
use opspace_experiment::{Files, RobotDefinition, Source, TaskDefinition};
use opspace_model::{FrameId, JointKind, Model, neutral};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// File beside robot.toml whose start is the default posture.
const FIRST_TASK: &str = "first-task.toml";

/// Distances from the pose of --at up to which it counts as reached; positions have four decimals.
const MISSED_M: f64 = 1e-3;
const MISSED_RAD: f64 = 5e-3;

/// Names of the axes of the effective masses.
const AXES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

/// Robot in one posture.
pub struct Posture {
    /// Positions (nq; rad or m).
    q: Vec<f64>,
    /// Source of the positions, in words.
    source: String,
    /// Start positions for a task file, if they were searched for.
    start_rad: Option<String>,
    /// Links that are nearer than the margin in all postures that were found, if one was searched for.
    contact: Option<[String; 2]>,
    /// Distance that the robot keeps between its links, m; 0 if it keeps none.
    margin_m: f64,
    report: PostureReport,
    /// Torque limits (n; Nm or N); infinite where there are none.
    limits: Vec<f64>,
    /// Joints that are outside their position limits.
    outside: Vec<String>,
}

impl Posture {
    /// Computes the posture that the arguments ask for; `robot` is `None` for a URDF alone. `None` if no frame moves.
    pub fn new(
        args: &ModelArgs,
        model: &Model,
        robot: Option<&RobotDefinition>,
    ) -> Result<Option<Self>, Failure> {
        let Some(frame) = frame(args.frame.as_deref(), model, robot)? else { return Ok(None) };
        let mut margin_m = 0.0;
        let (q, source, start_rad, contact) = match args.at.as_slice() {
            [] => {
                let (q, source) = positions(&args.q, model, robot)?;
                (q, source, None, None)
            }
            pose => {
                let mut own_body = own_body(args, frame, model, robot)?;
                margin_m = own_body.as_ref().map_or(0.0, OwnBody::margin_m);
                let found = found_at(pose, frame, model, robot, own_body.as_mut())?;
                (found.q, "found for --at".to_owned(), Some(found.start_rad), found.contact)
            }
        };
        if model.bodies().iter().any(|body| body.inertia.mass <= 0.0) {
            // A posture is described by its dynamics, which a URDF without masses does not have.
            return Ok(None);
        }
        let Some(report) = PostureReport::new(model, &q, frame) else {
            return Err(bad("the mass matrix is not positive definite in this posture".to_owned()));
        };
        let limits = robot.map_or_else(
            || model.joints().iter().map(|joint| joint.limits.effort).collect(),
            RobotDefinition::torque_limits,
        );
        let outside = outside(model, &q);
        Ok(Some(Self { q, source, start_rad, contact, margin_m, report, limits, outside }))
    }

    /// Text of the posture.
    pub fn text(&self, model: &Model) -> String {
        let mut text = format!("\nposture: {}\n", self.source);
        if let Some(start_rad) = &self.start_rad {
            let _ = writeln!(text, "{start_rad}");
        }
        if let Some([first, second]) = &self.contact {
            let (near, other) = if self.margin_m > 0.0 {
                let near = format!("are nearer to each other than margin_m = {}", self.margin_m);
                (near, "in which all links keep it")
            } else {
                ("touch".to_owned(), "without contact")
            };
            let _ = writeln!(
                text,
                "  links '{first}' and '{second}' {near}, as far as their capsules show: no posture was found {other}"
            );
        }
        for joint in &self.outside {
            let _ = writeln!(text, "  {joint}");
        }
        let _ = write!(text, "\n{}\n{}\n", render(&self.joints(model)), render(&self.frames()));
        let PostureReport { frame, length_m, linear, angular, pose, .. } = &self.report;
        let _ = writeln!(
            text,
            "frame '{frame}': condition of the Jacobian {} linear, {} angular, {} of both with rotations scaled by {length_m:.3} m",
            condition_text(linear),
            condition_text(angular),
            condition_text(pose),
        );
        let _ = write!(text, "\n{}", render(&self.masses()));
        text
    }

    fn joints(&self, model: &Model) -> Table {
        let mut table =
            Table::new(&[("joint", ""), ("position", "rad, m"), ("weight", "Nm, N"), ("of limit", "%")]);
        for (i, joint) in
            model.joints().iter().enumerate().filter(|(_, joint)| joint.kind != JointKind::Floating)
        {
            let gravity = self.report.gravity[i];
            let mut row: Vec<Cell> = vec![joint.name.clone().into(), self.q[position_index(model, i)].into()];
            row.push(gravity.into());
            row.push(
                fraction(gravity, self.limits[i]).map_or(Cell::Empty, |fraction| (100.0 * fraction).into()),
            );
            table.push(row);
        }
        table
    }

    fn frames(&self) -> Table {
        let mut table = Table::new(&[
            ("frame", ""),
            ("x", "m"),
            ("y", "m"),
            ("z", "m"),
            ("roll", "rad"),
            ("pitch", "rad"),
            ("yaw", "rad"),
        ]);
        for frame in &self.report.frames {
            let mut row: Vec<Cell> = vec![frame.name.clone().into()];
            row.extend(
                frame.position_m.iter().chain(&frame.rpy_rad).map(|value| Cell::from(rounded(*value))),
            );
            table.push(row);
        }
        table
    }

    fn masses(&self) -> Table {
        let mut table = Table::new(&[
            ("axis of the world", ""),
            ("effective mass", "kg"),
            ("effective inertia", "kg m²"),
        ]);
        for (i, mass) in self.report.effective_mass.iter().enumerate() {
            let value = mass.map_or_else(|| "cannot move".into(), Cell::from);
            let mut row: Vec<Cell> = vec![AXES[i].into(), Cell::Empty, Cell::Empty];
            row[1 + i / 3] = value;
            table.push(row);
        }
        table
    }

    pub fn json(&self, model: &Model) -> Value {
        let joints = model.joints().iter().enumerate().filter(|(_, joint)| joint.kind != JointKind::Floating);
        let joints = joints.map(|(i, joint)| {
            let gravity = self.report.gravity[i];
            json!({
                "name": joint.name,
                "position": self.q[position_index(model, i)],
                "gravity_torque": gravity,
                "of_limit": fraction(gravity, self.limits[i]),
            })
        });
        let frames = self.report.frames.iter().map(|frame| {
            json!({
                "name": frame.name,
                "position_m": frame.position_m,
                "rpy_rad": frame.rpy_rad,
                "quaternion_xyzw": frame.quaternion,
            })
        });
        let masses: BTreeMap<&str, Option<f64>> = AXES.into_iter().zip(self.report.effective_mass).collect();
        json!({
            "source": self.source,
            "contact": self.contact,
            "q": self.q,
            "joints": joints.collect::<Vec<Value>>(),
            "frames": frames.collect::<Vec<Value>>(),
            "frame": self.report.frame,
            "jacobian": {
                "linear": conditioning_json(&self.report.linear),
                "angular": conditioning_json(&self.report.angular),
                "pose": conditioning_json(&self.report.pose),
                "length_m": self.report.length_m,
            },
            "effective_mass": masses,
        })
    }
}

/// Value without the rounding errors of zero.
fn rounded(value: f64) -> f64 {
    if value.abs() < 1e-9 { 0.0 } else { value }
}

fn condition_text(rows: &Conditioning) -> String {
    rows.condition().map_or_else(|| "infinite (singular)".to_owned(), |condition| format!("{condition:.1}"))
}

/// JSON has no infinity: the condition is null if the frame cannot move in some direction.
fn conditioning_json(rows: &Conditioning) -> Value {
    json!({ "condition": rows.condition(), "largest": rows.largest, "smallest": rows.smallest })
}

fn fraction(torque: f64, limit: f64) -> Option<f64> {
    (limit.is_finite() && limit > 0.0).then(|| torque.abs() / limit)
}

fn bad(text: String) -> Failure {
    Failure::Other(text, Exit::Bad)
}

/// Index of a joint's position: a floating base has one position more than coordinates.
fn position_index(model: &Model, joint: usize) -> usize {
    if model.is_floating() { joint + 1 } else { joint }
}

/// Frame that was named, or the tip: the end of the chain that robot.toml uses, or that of the longest one.
fn frame(
    name: Option<&str>,
    model: &Model,
    robot: Option<&RobotDefinition>,
) -> Result<Option<FrameId>, Failure> {
    if let Some(name) = name {
        let found = model.frame_id(name).map_err(|unknown| {
            let near = nearest(name, &unknown.known)
                .map_or(String::new(), |near| format!("; did you mean '{near}'?"));
            bad(format!("--frame {name}: {unknown}{near}"))
        });
        return found.map(Some);
    }
    let used =
        robot.and_then(|robot| robot.file.used.as_ref()).and_then(|used| model.frame_id(&used.to).ok());
    Ok(used.or_else(|| tip(model)))
}

/// Capsules of the robot's own links: those of robot.toml, or those of the URDF. `None` for a floating base.
fn own_body(
    args: &ModelArgs,
    frame: FrameId,
    model: &Model,
    robot: Option<&RobotDefinition>,
) -> Result<Option<OwnBody>, Failure> {
    if model.is_floating() {
        return Ok(None);
    }
    let reach_m = reach(model, frame);
    Ok(match robot {
        Some(robot) => OwnBody::of_robot(robot, reach_m),
        None => OwnBody::new(model, &Source::read(&args.robot)?, None, reach_m, 0.0),
    })
}

/// Posture in which the frame is at a pose of the world.
fn found_at(
    pose: &[f64],
    frame: FrameId,
    model: &Model,
    robot: Option<&RobotDefinition>,
    own_body: Option<&mut OwnBody>,
) -> Result<PostureAt, Failure> {
    let (position, rpy) = match *pose {
        [x, y, z] => ([x, y, z], None),
        [x, y, z, roll, pitch, yaw] => ([x, y, z], Some([roll, pitch, yaw])),
        _ => {
            let text = format!("--at has {} values: expected x,y,z or x,y,z,roll,pitch,yaw", pose.len());
            return Err(bad(text));
        }
    };
    let start = default_positions(model, robot).0;
    let name = &model.frame(frame).name;
    let found = posture_at(model, name, position, rpy, &start, own_body)
        .map_err(|error| bad(format!("--at: {error}")))?;
    let [metres, radians] = found.missed;
    if metres > MISSED_M || radians > MISSED_RAD {
        let turn = if rpy.is_some() { format!(" and {radians:.2} rad") } else { String::new() };
        return Err(bad(format!(
            "--at: no posture within the joint limits was found in which '{name}' is there: the nearest of {} searches is \
             {metres:.3} m{turn} away",
            found.tries
        )));
    }
    Ok(found)
}

/// Positions (nq), and where they come from.
fn positions(
    given: &[String],
    model: &Model,
    robot: Option<&RobotDefinition>,
) -> Result<(Vec<f64>, String), Failure> {
    if given.is_empty() {
        return Ok(default_positions(model, robot));
    }
    let number = |text: &str| {
        let value = text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
        value.ok_or_else(|| bad(format!("--q: '{text}' is not a finite number")))
    };
    let names = || {
        let joints = model.joints().iter().filter(|joint| joint.kind != JointKind::Floating);
        joints.map(|joint| joint.name.as_str()).collect::<Vec<_>>().join(", ")
    };
    let named: Vec<(&str, &str)> = given.iter().filter_map(|entry| entry.split_once('=')).collect();
    if named.is_empty() {
        let q = given.iter().map(|text| number(text)).collect::<Result<Vec<f64>, Failure>>()?;
        let needed = neutral(model).len();
        if q.len() != needed {
            let base = if model.is_floating() { "position and quaternion of the base, " } else { "" };
            let text = format!("--q has {} values; the robot needs {needed}: {base}{}", q.len(), names());
            return Err(bad(text));
        }
        return Ok((q, "--q".to_owned()));
    }
    if named.len() != given.len() {
        return Err(
            bad("--q: give either all positions, or joints by name (elbow=1.2), not both".to_owned()),
        );
    }
    let (mut q, source) = default_positions(model, robot);
    for (name, value) in &named {
        let name = name.trim();
        let joint = model.joint(name).ok().filter(|&joint| model.joints()[joint].kind != JointKind::Floating);
        let joint = joint.ok_or_else(|| {
            let known = model.joints().iter().map(|joint| joint.name.as_str());
            let near = nearest(name, known).map_or(String::new(), |near| format!("did you mean '{near}'? "));
            bad(format!("--q: there is no joint '{name}'; {near}The joints are: {}", names()))
        })?;
        q[position_index(model, joint)] = number(value)?;
    }
    let list: Vec<&str> = named.iter().map(|(name, _)| name.trim()).collect();
    let all = list.len() == model.joints().iter().filter(|joint| joint.kind != JointKind::Floating).count();
    let others = if all { String::new() } else { format!("; other joints: {source}") };
    Ok((q, format!("{} from --q{others}", list.join(", "))))
}

/// Start of the first task, or the middle of each range.
fn default_positions(model: &Model, robot: Option<&RobotDefinition>) -> (Vec<f64>, String) {
    let mut q = neutral(model);
    let first_task = robot.and_then(first_task);
    if let Some(FirstTaskStart { task, start_rad: Some(start_rad) }) = &first_task {
        for (name, &value) in start_rad {
            if let Ok(joint) = model.joint(name) {
                q[position_index(model, joint)] = value;
            }
        }
        return (q, format!("start of {}", task.display()));
    }
    for (i, joint) in model.joints().iter().enumerate().filter(|(_, joint)| joint.kind != JointKind::Floating)
    {
        let (lower, upper) = joint.limits.range(joint.kind);
        q[position_index(model, i)] = 0.5 * (lower + upper);
    }
    let why = first_task.map_or_else(String::new, |first| format!("; {} does not fit", first.task.display()));
    (q, format!("middle of each range{why}"))
}

/// First task beside a robot's file.
pub struct FirstTaskStart {
    /// Path of the task.
    pub task: PathBuf,
    /// Its start positions by joint, rad (m); `None` if the task cannot be read, or is for other joints.
    pub start_rad: Option<BTreeMap<String, f64>>,
}

/// Returns the first task beside a robot's file, if there is one.
pub fn first_task(robot: &RobotDefinition) -> Option<FirstTaskStart> {
    let task = Path::new(robot.source.name()).with_file_name(FIRST_TASK);
    if !task.is_file() {
        return None;
    }
    let definition = TaskDefinition::load(Files::Disk, &task, &[]).ok();
    let known = |name: &String| robot.model.joint(name).is_ok();
    let start_rad = definition
        .filter(|definition| definition.file.start_rad.keys().all(known))
        .map(|definition| definition.file.start_rad.clone());
    Some(FirstTaskStart { task, start_rad })
}

/// Describes the joints that are outside their position limits.
fn outside(model: &Model, q: &[f64]) -> Vec<String> {
    let limited = model.joints().iter().enumerate().filter(|(_, joint)| joint.kind != JointKind::Floating);
    let outside = limited.filter_map(|(i, joint)| {
        let (at, lower, upper) = (q[position_index(model, i)], joint.limits.lower, joint.limits.upper);
        (at < lower || at > upper)
            .then(|| format!("joint '{}' at {at} is outside its limits, {lower} to {upper}", joint.name))
    });
    outside.collect()
}
