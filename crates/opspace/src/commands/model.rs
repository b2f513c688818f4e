//! `opspace model`: a robot as a table, or its kinematics and dynamics at given states.

use crate::cli::ModelArgs;
use crate::console::{Console, Exit, Failure, Outcome, print, render};
use crate::output::pretty;
use opspace_experiment::robot::load_urdf;
use opspace_experiment::table::{Cell, Table};
use opspace_experiment::{FileError, Files, Robot, Source};
use opspace_model::samples::{Sample, evaluate};
use opspace_model::{JointKind, Model, UrdfWarning};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::Path;

pub fn model(args: &ModelArgs, console: Console) -> Outcome {
    let (name, model, warnings) = load(&args.robot)?;
    match (&args.tip, &args.samples) {
        (Some(tip), Some(samples)) => evaluate_samples(&model, tip, samples, args.json.json.as_deref()),
        _ => {
            args.json.print(|| pretty(&as_json(&model)), || describe(&model))?;
            warnings.iter().for_each(|w| console.note(&format!("{name}: {w}")));
            Ok(Exit::Done)
        }
    }
}

fn load(path: &Path) -> Result<(String, Model, Vec<UrdfWarning>), FileError> {
    if path.extension().is_some_and(|e| e == "urdf") {
        let source = Source::read(path)?;
        let loaded = load_urdf(&source)?;
        return Ok((source.name().to_owned(), loaded.model, loaded.warnings));
    }
    let robot = Robot::load(Files::Disk, path, &[])?;
    Ok((robot.urdf.name().to_owned(), robot.model, robot.warnings))
}

fn describe(model: &Model) -> String {
    let mut joints = Table::new(&[
        ("joint", ""),
        ("kind", ""),
        ("lower", ""),
        ("upper", ""),
        ("velocity", "/s"),
        ("effort", ""),
        ("mass", "kg"),
        ("rotor", "kg m²"),
    ]);
    for (i, joint) in model.joints().iter().enumerate() {
        let limit = |value: f64| if value.is_finite() { Cell::from(value) } else { Cell::from("none") };
        let kind = match joint.kind {
            JointKind::Revolute => "revolute (rad, Nm)",
            JointKind::Continuous => "continuous (rad, Nm)",
            JointKind::Prismatic => "prismatic (m, N)",
            JointKind::Floating => "floating base",
        };
        joints.push(vec![
            joint.name.clone().into(),
            kind.into(),
            limit(joint.limits.lower),
            limit(joint.limits.upper),
            limit(joint.limits.velocity),
            limit(joint.limits.effort),
            model.bodies()[i].inertia.mass.into(),
            model.rotor_inertia()[i].into(),
        ]);
    }
    let mut frames = Table::new(&[("frame", ""), ("moves with", "")]);
    let carrier = |body: usize| model.joints()[model.bodies()[body].joint].name.as_str();
    for frame in model.frames() {
        let carrier = frame.body.map_or("the base (fixed)", carrier);
        frames.push(vec![frame.name.clone().into(), carrier.into()]);
    }
    format!(
        "{}: {} moving joints, {:.3} kg in motion\n{}\n{}",
        model.name(),
        model.n(),
        model.total_mass(),
        render(&joints),
        render(&frames)
    )
}

fn as_json(model: &Model) -> Value {
    // JSON has no infinity: null is no limit.
    let joints: Vec<Value> = (model.joints().iter().enumerate())
        .map(|(i, joint)| {
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
                "effort": joint.limits.effort,
                "mass_kg": model.bodies()[i].inertia.mass,
                "rotor_inertia": model.rotor_inertia()[i],
            })
        })
        .collect();
    let carrier = |body: usize| model.joints()[model.bodies()[body].joint].name.as_str();
    let frames: Vec<Value> = (model.frames().iter())
        .map(|frame| json!({ "name": frame.name, "moves_with": frame.body.map(carrier) }))
        .collect();
    json!({
        "schema": "opspace.model/1",
        "name": model.name(),
        "moving_mass_kg": model.total_mass(),
        "joints": joints,
        "frames": frames,
    })
}

/// Writes a line for each state, to `out` or stdout.
fn evaluate_samples(model: &Model, tip: &str, samples: &Path, out: Option<&Path>) -> Outcome {
    let mut out = match out.filter(|path| *path != Path::new("-")) {
        Some(path) => Some(File::create(path).map_err(|e| Failure::io("can't be written", path, &e))?),
        None => None,
    };
    let bad = |text: String| Failure::Other(text, Exit::Bad);
    let frame = model.frame(tip).map_err(|unknown| bad(format!("--tip {tip}: {unknown}")))?;
    let name = samples.display();
    let reader: Box<dyn BufRead> = if samples == Path::new("-") {
        Box::new(io::stdin().lock())
    } else {
        let file = File::open(samples).map_err(|e| Failure::io("can't be read", samples, &e))?;
        Box::new(BufReader::new(file))
    };
    for (line, text) in (1..).zip(reader.lines()) {
        let text = text.map_err(|e| Failure::io("can't be read", samples, &e))?;
        if text.trim().is_empty() {
            continue;
        }
        let sample: Sample = serde_json::from_str(&text).map_err(|e| bad(format!("{name}:{line}: {e}")))?;
        let quantities = evaluate(model, frame, &sample).map_err(|e| bad(format!("{name}:{line}: {e}")))?;
        let json = serde_json::to_string(&quantities).map_err(|e| bad(format!("{name}:{line}: {e}")))?;
        match &mut out {
            None => print(&(json + "\n"))?,
            Some(file) => writeln!(file, "{json}")
                .map_err(|e| Failure::Other(format!("the results can't be written: {e}"), Exit::Bad))?,
        }
    }
    Ok(Exit::Done)
}
