//! `opspace model`: tables of a robot and warnings about it, or its kinematics and dynamics at given states.

use crate::cli::ModelArgs;
use crate::commands::check::values_text;
use crate::commands::posture::Posture;
use crate::console::{Console, Exit, Failure, Outcome, print_exactly, render};
use crate::output::{Format, pretty, write_named};
use crate::outputs::check_outputs;
use crate::samples::{Sample, evaluate};
use opspace_experiment::evaluate::table::{Cell, Table};
use opspace_experiment::files::collision::{capsule_warning_texts, capsules_as_toml, generated_capsules};
use opspace_experiment::files::robot::load_urdf;
use opspace_experiment::{Files, RobotDefinition, Source};
use opspace_model::files::open_file;
use opspace_model::{
    Body, Frame, JointKind, Model, ParsedUrdf, UrdfOptions, UrdfWarning, model_warnings, principal_moments,
};
use serde_json::{Value, json};
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

pub fn model(args: &ModelArgs, console: Console) -> Outcome {
    if args.capsules {
        return capsules(args, console);
    }
    let mut shown = load(args)?;
    if let (Some(tip), Some(samples)) = (&args.tip, &args.samples) {
        return evaluate_samples(&shown.model, tip, samples, args.json.json.as_deref());
    }
    check_outputs(&[shown.file.clone().into()], &Vec::from_iter(args.json.path().map(Path::to_owned)))?;
    shown.posture = Posture::new(args, &shown.model, shown.robot.as_ref())?;
    args.json.print(|| pretty(&as_json(&shown)), || describe(&shown))?;
    shown.warnings.iter().for_each(|w| console.note(&format!("{}: {w}", shown.file)));
    Ok(Exit::Done)
}

/// Prints the capsules of a robot, or those of a URDF.
fn capsules(args: &ModelArgs, console: Console) -> Outcome {
    let is_urdf = args.robot.extension().is_some_and(|e| e == "urdf");
    let robot = if is_urdf { None } else { Some(RobotDefinition::load(Files::Disk, &args.robot, &[])?) };
    let (capsules, warnings) = match robot {
        Some(robot) if !robot.capsules().is_empty() => {
            (robot.capsules().to_vec(), robot.capsule_warnings().to_vec())
        }
        robot => {
            let urdf = robot.map_or_else(|| Source::read(&args.robot), |robot| Ok(robot.urdf))?;
            let generated = generated_capsules(&urdf)?;
            (generated.capsules, generated.warnings)
        }
    };
    print_exactly(&capsules_as_toml(&capsules))?;
    let texts = capsule_warning_texts(&warnings);
    texts.iter().for_each(|(text, code)| console.note(&format!("{text} [{code}]")));
    Ok(Exit::Done)
}

/// Model with warnings about it.
struct ModelView {
    /// Name of the URDF.
    file: String,
    model: Model,
    /// Mass of the links that cannot move, kg; they are not part of the model.
    standing_kg: f64,
    /// Values of a robot that are those of the URDF, and those that are assumed.
    values: String,
    /// Robot, unless the model is that of a URDF alone.
    robot: Option<RobotDefinition>,
    /// Posture that is described; `None` if nothing moves.
    posture: Option<Posture>,
    /// Warnings of the URDF parser, then warnings about the whole model.
    warnings: Vec<String>,
}

impl ModelView {
    fn new(urdf: &Source, model: Model, standing_kg: f64, warnings: &[UrdfWarning]) -> Self {
        let warnings = warnings.iter().map(|w| format!("{w} [{}]", w.kind().code()));
        let of_model = model_warnings(&model).into_iter().map(|w| format!("{w} [{}]", w.code()));
        let warnings = warnings.chain(of_model).collect();
        let (file, values) = (urdf.name().to_owned(), String::new());
        Self { file, model, standing_kg, values, robot: None, posture: None, warnings }
    }
}

fn load(args: &ModelArgs) -> Result<ModelView, Failure> {
    let options =
        UrdfOptions { floating_base: args.floating, enforce_mimic: args.enforce_mimic, allow_massless: true };
    if args.robot.extension().is_some_and(|e| e == "urdf") {
        let urdf = Source::read(&args.robot)?;
        let ParsedUrdf { model, standing_kg, warnings, .. } = load_urdf(&urdf, options)?;
        return Ok(ModelView::new(&urdf, model, standing_kg, &warnings));
    }
    let robot = RobotDefinition::load(Files::Disk, &args.robot, &[])?;
    if args.floating || args.enforce_mimic {
        let option = if args.floating { "--floating" } else { "--enforce-mimic" };
        let (file, urdf) = (args.robot.display(), robot.urdf.name());
        let text = format!("{option} is only for a URDF, but {file} is a robot file: give {urdf} instead");
        return Err(Failure::Other(text, Exit::Bad));
    }
    let values = values_text(&robot);
    let view = ModelView::new(&robot.urdf, robot.model.clone(), robot.standing_kg, &robot.warnings);
    Ok(ModelView { values, robot: Some(robot), ..view })
}

fn describe(shown: &ModelView) -> String {
    let model = &shown.model;
    let (joints, base) = match model.is_floating() {
        true => (model.n() - 6, "floating"),
        false => (model.n(), "fixed"),
    };
    format!(
        "{}: {joints} moving joints on a {base} base, {:.3} kg moving, {:.3} kg in total\n{}\n{}\n{}\n{}{}",
        model.name(),
        model.total_mass(),
        model.total_mass() + shown.standing_kg,
        shown.values,
        render(&joint_table(model, &efforts(shown))),
        render(&body_table(model)),
        render(&frame_table(model)),
        shown.posture.as_ref().map_or_else(String::new, |posture| posture.text(model))
    )
}

/// Torque limit of each joint: that of the robot's file, which may be below that of its URDF.
fn efforts(shown: &ModelView) -> Vec<f64> {
    let of_robot = shown.robot.as_ref().map(RobotDefinition::torque_limits);
    let joints = shown.model.joints();
    of_robot
        .filter(|limits| limits.len() == joints.len())
        .unwrap_or_else(|| joints.iter().map(|joint| joint.limits.effort).collect())
}

fn joint_table(model: &Model, efforts: &[f64]) -> Table {
    let mut columns = vec![
        ("joint", ""),
        ("kind", ""),
        ("parent link", ""),
        ("lower", ""),
        ("upper", ""),
        ("velocity", "/s"),
        ("effort", ""),
    ];
    // A URDF alone contains no rotor inertias.
    let rotors = model.rotor_inertia().iter().any(|&rotor| rotor != 0.0);
    if rotors {
        columns.push(("rotor", "kg m²"));
    }
    let mut table = Table::new(&columns);
    let limit = |kind: JointKind, value: f64| match (kind, value.is_finite()) {
        (JointKind::Floating, _) => Cell::Empty,
        (_, true) => value.into(),
        (_, false) => "none".into(),
    };
    for (i, joint) in model.joints().iter().enumerate() {
        let kind = match joint.kind {
            JointKind::Revolute => "revolute (rad, Nm)",
            JointKind::Continuous => "continuous (rad, Nm)",
            JointKind::Prismatic => "prismatic (m, N)",
            JointKind::Floating => "floating base",
        };
        let mut row: Vec<Cell> = vec![joint.name.clone().into(), kind.into()];
        row.push(parent_link(model, i).unwrap_or("world").into());
        let limits = joint.limits;
        let limits = [limits.lower, limits.upper, limits.velocity, efforts[i]];
        row.extend(limits.map(|value| limit(joint.kind, value)));
        row.extend(rotors.then(|| model.rotor_inertia()[i].into()));
        table.push(row);
    }
    table
}

fn body_table(model: &Model) -> Table {
    let mut table = Table::new(&[
        ("body", ""),
        ("moved by", ""),
        ("mass", "kg"),
        ("com x", "m"),
        ("com y", "m"),
        ("com z", "m"),
        ("moment 1", "kg m²"),
        ("moment 2", "kg m²"),
        ("moment 3", "kg m²"),
    ]);
    for (number, body) in bodies(model) {
        let mut row: Vec<Cell> = vec![link(model, Some(number)).into(), mover(model, body).into()];
        row.push(body.inertia.mass.into());
        row.extend(centre(model, number).map(Cell::from));
        row.extend(moments(body).map(Cell::from));
        table.push(row);
    }
    table
}

fn frame_table(model: &Model) -> Table {
    let mut table = Table::new(&[
        ("frame", ""),
        ("moves with", ""),
        ("fixed to", ""),
        ("x", "m"),
        ("y", "m"),
        ("z", "m"),
    ]);
    for frame in model.frames() {
        let mut row: Vec<Cell> = vec![frame.name.clone().into()];
        row.push(match frame.body {
            None => "the base (fixed)".into(),
            Some(body) => mover(model, &model.bodies()[body]).into(),
        });
        let link = link(model, frame.body);
        if link == frame.name {
            row.extend(["–".into(), Cell::Empty, Cell::Empty, Cell::Empty]);
        } else {
            row.push(link.into());
            row.extend(offset(model, frame).map(Cell::from));
        }
        table.push(row);
    }
    table
}

/// Bodies with their indices. Of the six bodies of a floating base, only the last one is included, which is the base.
fn bodies(model: &Model) -> impl Iterator<Item = (usize, &Body)> {
    let first = if model.is_floating() { 5 } else { 0 };
    model.bodies().iter().enumerate().skip(first)
}

/// Frame of the link after which a body is named: the child link of its joint.
fn link_frame(model: &Model, body: Option<usize>) -> Option<&Frame> {
    model.frames().iter().find(|frame| frame.body == body)
}

fn link(model: &Model, body: Option<usize>) -> &str {
    link_frame(model, body).map_or("the base", |frame| &frame.name)
}

/// Parent link of a joint; if several bodies follow the joint, the parent of the joint's own body. `None` for a
/// floating base.
fn parent_link(model: &Model, joint: usize) -> Option<&str> {
    if model.joints()[joint].kind == JointKind::Floating {
        return None;
    }
    let own = model.bodies().iter().find(|body| body.joint == joint && !body.follows);
    own.map(|body| link(model, body.parent))
}

/// Name of a body's joint, with ratio and offset to the joint's position if the body follows it (mimic joint).
fn mover(model: &Model, body: &Body) -> String {
    let name = &model.joints()[body.joint].name;
    match (body.kind, body.ratio, body.offset) {
        (JointKind::Floating, ..) => "the base (floating)".to_owned(),
        (_, 1.0, 0.0) => name.clone(),
        (_, ratio, 0.0) => format!("{ratio} {name}"),
        (_, ratio, offset) => format!("{ratio} {name} {offset:+}"),
    }
}

/// Largest position that counts as zero because of rounding, m; for moments relative to the largest moment.
const ROUNDING: f64 = 1e-9;

fn rounded(value: f64, scale: f64) -> f64 {
    if value.abs() < ROUNDING * scale { 0.0 } else { value }
}

/// Centre of mass of a body in the frame of its link, m.
fn centre(model: &Model, body: usize) -> [f64; 3] {
    let com = model.bodies()[body].inertia.com;
    let in_link = link_frame(model, Some(body)).map_or(com, |link| link.placement.inverse().act_point(&com));
    [in_link.x, in_link.y, in_link.z].map(|x| rounded(x, 1.0))
}

/// Principal moments of inertia of a body, ascending, kg m².
fn moments(body: &Body) -> [f64; 3] {
    let moments = principal_moments(&body.inertia.rotational);
    moments.map(|moment| rounded(moment, moments[2]))
}

/// Origin of a frame in the frame of the link to which it is fixed, m.
fn offset(model: &Model, frame: &Frame) -> [f64; 3] {
    let point = frame.placement.translation;
    let at = link_frame(model, frame.body).map_or(point, |link| link.placement.inverse().act_point(&point));
    [at.x, at.y, at.z].map(|x| rounded(x, 1.0))
}

fn as_json(shown: &ModelView) -> Value {
    let (model, efforts) = (&shown.model, efforts(shown));
    // JSON has no infinity: null means no limit.
    let joints: Vec<Value> = (model.joints().iter().enumerate())
        .map(|(i, joint)| {
            let moved = model.bodies().iter().filter(|body| body.joint == i);
            json!({
                "name": joint.name,
                "kind": match joint.kind {
                    JointKind::Revolute => "revolute",
                    JointKind::Continuous => "continuous",
                    JointKind::Prismatic => "prismatic",
                    JointKind::Floating => "floating",
                },
                "lower": joint.limits.lower,
                "upper": joint.limits.upper,
                "velocity": joint.limits.velocity,
                "effort": efforts[i],
                "mass_kg": moved.map(|body| body.inertia.mass).sum::<f64>(),
                "rotor_inertia": model.rotor_inertia()[i],
                "carried_by": parent_link(model, i),
            })
        })
        .collect();
    let bodies: Vec<Value> = bodies(model)
        .map(|(number, body)| {
            json!({
                "link": link(model, Some(number)),
                "joint": model.joints()[body.joint].name,
                "ratio": body.ratio,
                "offset": body.offset,
                "mass_kg": body.inertia.mass,
                "com_m": centre(model, number),
                "principal_moments_kg_m2": moments(body),
            })
        })
        .collect();
    let joint_name = |body: usize| model.joints()[model.bodies()[body].joint].name.as_str();
    let frames: Vec<Value> = (model.frames().iter())
        .map(|frame| {
            json!({
                "name": frame.name,
                "moves_with": frame.body.map(joint_name),
                "fixed_to": link(model, frame.body),
                "offset_m": offset(model, frame),
            })
        })
        .collect();
    json!({
        "schema": "opspace.model/1",
        "name": model.name(),
        "base": if model.is_floating() { "floating" } else { "fixed" },
        "moving_mass_kg": model.total_mass(),
        "total_mass_kg": model.total_mass() + shown.standing_kg,
        "joints": joints,
        "bodies": bodies,
        "frames": frames,
        "posture": shown.posture.as_ref().map(|posture| posture.json(model)),
        "warnings": shown.warnings,
    })
}

/// Largest length of a line of samples, bytes: some hundred joints take a tenth of it.
const MAX_LINE_BYTES: u64 = 1 << 20;

/// Writes a line for each state, to `out` or stdout. A file is written only if all states are valid.
fn evaluate_samples(model: &Model, tip: &str, samples: &Path, out: Option<&Path>) -> Outcome {
    let bad = |text: String| Failure::Other(text, Exit::Bad);
    let out = out.filter(|path| *path != Path::new("-"));
    let frame = model.frame_id(tip).map_err(|unknown| bad(format!("--tip {tip}: {unknown}")))?;
    let name = samples.display();
    let mut reader: Box<dyn BufRead> = if samples == Path::new("-") {
        Box::new(io::stdin().lock())
    } else {
        let file = open_file(samples).map_err(|e| Failure::io("cannot be read", samples, &e))?;
        Box::new(BufReader::new(file))
    };
    if let Some(out) = out {
        check_outputs(&[samples.to_owned()], &[out.to_owned()])?;
    }
    let mut results = String::new();
    for line in 1.. {
        let mut text = String::new();
        let length = (&mut reader).take(MAX_LINE_BYTES).read_line(&mut text);
        match length.map_err(|e| Failure::io("cannot be read", samples, &e))? {
            0 => break,
            bytes if bytes as u64 == MAX_LINE_BYTES => {
                return Err(bad(format!("{name}:{line}: the line is longer than {MAX_LINE_BYTES} bytes")));
            }
            _ => {}
        }
        if text.trim().is_empty() {
            continue;
        }
        let sample: Sample = serde_json::from_str(&text).map_err(|e| bad(format!("{name}:{line}: {e}")))?;
        let quantities = evaluate(model, frame, &sample).map_err(|e| bad(format!("{name}:{line}: {e}")))?;
        let json = serde_json::to_string(&quantities).map_err(|e| bad(format!("{name}:{line}: {e}")))? + "\n";
        match out {
            None => print_exactly(&json)?,
            Some(_) => results += &json,
        }
    }
    if let Some(out) = out {
        write_named(out, &results, Format::JsonLines)?;
    }
    Ok(Exit::Done)
}
