//! `opspace new`: creates a folder for a new robot.

use crate::cli::{NewArgs, SchemaKind};
use crate::commands::schema::text as schema_text;
use crate::console::{Console, Exit, Failure, Outcome, print};
use crate::output::write;
use opspace_experiment::Source;
use opspace_experiment::setup::new_robot::{NewFiles, Part, new_files};
use std::fs;

pub fn new(args: &NewArgs, console: Console) -> Outcome {
    let source = Source::read(&args.urdf)?;
    let robot = args.dir.join("robot.toml");
    let urdf = args.urdf.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let part = Part { from: args.from.as_deref(), to: args.to.as_deref() };
    let NewFiles { robot_toml, task_toml, motion, warnings, .. } =
        new_files(&source, &urdf, part, args.assume)?;
    warnings.iter().for_each(|w| console.note(&format!("{}: {w}", source.name())));
    if robot.exists() {
        let text = format!("{}: already exists; choose another folder", robot.display());
        return Err(Failure::Other(text, Exit::Bad));
    }
    fs::create_dir_all(&args.dir).map_err(|e| Failure::io("cannot be created", &args.dir, &e))?;
    let copy = args.dir.join(&urdf);
    match fs::read_to_string(&copy) {
        // The copy already exists, or is the same file.
        Ok(text) if text == source.text() => {}
        Ok(_) => {
            let text = format!("{}: already exists and differs from {}", copy.display(), source.name());
            return Err(Failure::Other(text + "; choose another folder", Exit::Bad));
        }
        Err(_) => write(&copy, source.text())?,
    }
    for (name, schema) in [("robot.schema.json", SchemaKind::Robot), ("task.schema.json", SchemaKind::Task)] {
        write(&args.dir.join(name), &schema_text(schema))?;
    }
    write(&robot, &robot_toml)?;
    let task = args.dir.join("first-task.toml");
    if !task.exists() {
        write(&task, &task_toml)?;
    }
    let (task, dir) = (task.display(), args.dir.display());
    let fill = if args.assume {
        format!("Values marked [A] in {} are assumed: results rest on them.\n", robot.display())
    } else {
        format!("Write the missing values into {}; `opspace check {dir}` lists them all.\n", robot.display())
    };
    let name = robot.parent().and_then(|dir| dir.file_name()).unwrap_or_default().to_string_lossy();
    print(&format!(
        "{}\n{}\n{task}\n{motion}\n{fill}Next:\n  opspace check {task}\n  opspace run {task}\n  \
         opspace report runs/first-task-{name}-position\n  opspace model {dir}\n",
        robot.display(),
        copy.display(),
    ))?;
    Ok(Exit::Done)
}
